"""One module, one node: a node takes its module's name only if no other living node has it.

Of two nodes that start at the same time, each sees that the other wants the name before either has it: the
one with the smaller instance id gets it. A node that starts later sees that the name is taken.
"""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING

from labos.errors import NameTaken
from labos.node.protocol import Keys

if TYPE_CHECKING:
    from labos.ports import Bus, Handle


async def claim(
    bus: Bus, keys: Keys, module: str, instance: str, *, settle_s: float, grace_s: float
) -> Handle:
    """Take the name, and hold it until the returned handle is closed. Look for other nodes for ``settle_s``
    seconds before taking it, and for the same time afterwards. Wait ``grace_s`` seconds for another node that
    is going away. Raises NameTaken."""
    others = _Others(instance)
    watches = [
        await bus.watch_alive(keys.alive(module, "*"), others.note_alive),
        await bus.watch_alive(keys.name(module, "*", "*"), others.note_name),
    ]
    held: list[Handle] = [await bus.declare_alive(keys.name(module, instance, "wants"))]
    try:
        await asyncio.sleep(settle_s)
        await others.go_away(grace_s)
        held.append(await bus.declare_alive(keys.name(module, instance, "has")))
        # Another node may have taken it at the same moment, before either could know.
        await asyncio.sleep(settle_s)
        if others.has_earlier_claim():
            raise _make_name_taken_error(module)
    except TimeoutError:
        _close_handles(held)
        raise _make_name_taken_error(module) from None
    except BaseException:
        _close_handles(held)
        raise
    finally:
        _close_handles(watches)
    held.pop(0).close()
    return held[0]


class _Others:
    """Other nodes of the same name, by their liveliness. A node that froze or lost its connection a moment
    ago still counts as living."""

    def __init__(self, instance: str) -> None:
        self._instance = instance
        self._stages: dict[str, set[str]] = {}
        self._changed = asyncio.Event()

    def note_alive(self, key: str, living: bool) -> None:
        self._note(key.rpartition("/")[2], "answers", living)

    def note_name(self, key: str, living: bool) -> None:
        instance, stage = key.split("/")[-2:]
        self._note(instance, stage, living)

    def come_first(self) -> bool:
        """Whether another node has the name, or wants it and takes precedence."""
        return any(
            stages - {"wants"} or ("wants" in stages and instance < self._instance)
            for instance, stages in self._stages.items()
        )

    def has_earlier_claim(self) -> bool:
        """Whether a node that takes precedence also has the name."""
        return any(
            stages - {"wants"} and instance < self._instance for instance, stages in self._stages.items()
        )

    async def go_away(self, limit_s: float) -> None:
        """Wait until no other node takes precedence. Raises TimeoutError."""
        async with asyncio.timeout(limit_s):
            while self.come_first():
                self._changed.clear()
                await self._changed.wait()

    def _note(self, instance: str, stage: str, living: bool) -> None:
        if instance == self._instance:
            return
        stages = self._stages.setdefault(instance, set())
        (stages.add if living else stages.discard)(stage)
        self._changed.set()


def _close_handles(handles: list[Handle]) -> None:
    for handle in handles:
        handle.close()


def _make_name_taken_error(module: str) -> NameTaken:
    return NameTaken(
        f"Another node already answers as {module!r}.",
        remedy="Stop it first, or give this one another name in the workcell.",
    )

"""One module, one node: a node takes its name only when no other living node bears it."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING

from labos.errors import NameTaken
from labos.node.protocol import Keys

if TYPE_CHECKING:
    from labos.ports import Bus


async def claim(bus: Bus, keys: Keys, module: str, *, settle_s: float, grace_s: float) -> None:
    """Look for ``settle_s`` for another node of this name; wait ``grace_s`` for one that is seen to
    go away. Raises NameTaken."""
    others: set[str] = set()
    alone = asyncio.Event()

    def note(key: str, living: bool) -> None:
        (others.add if living else others.discard)(key)
        if not others:
            alone.set()

    watch = await bus.watch_alive(keys.alive(module, "*"), note)
    try:
        await asyncio.sleep(settle_s)
        if others:
            # One that froze or lost its line a moment ago still looks alive.
            alone.clear()
            await asyncio.wait_for(alone.wait(), grace_s)
    except TimeoutError:
        pass
    finally:
        watch.close()
    if others:
        raise NameTaken(
            f"Another node already answers as {module!r}.",
            remedy="Stop it first, or give this one another name in the workcell.",
        )

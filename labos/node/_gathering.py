"""Starts of actions that the device carries out at once: none of them begins before all have arrived.

All labware in the device takes part, even if the start for it has not arrived. So if one start does not
arrive in time, or may not begin, none begins: all are void, and the lab requests new attempts.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Any

import msgspec

from labos.node.journal import Journal
from labos.node.protocol import JointStart

GATHER_S = 3.0
"""The wait for the other starts of a joint action, in seconds. It is shorter than the kernel's wait for an
answer."""


class _Group(msgspec.Struct):
    """The starts that have arrived, by action. ``decided`` is the reason why none of them begins. It is empty
    if they begin, and pending while this is open."""

    names: tuple[str, ...]
    decided: asyncio.Future[str]
    starts: dict[str, JointStart] = {}


class Gathering:
    """The starts of one node that wait for other starts."""

    def __init__(self, journal: Journal) -> None:
        self._journal = journal
        self._groups: dict[tuple[str, ...], _Group] = {}

    async def gather(
        self, start: JointStart, why_not: Callable[[], str], begin: Callable[[list[JointStart]], Any]
    ) -> str:
        """Wait for the other starts. When all have arrived, and ``why_not`` gives no reason against it,
        ``begin`` is called once for all of them. Returns why none of them begins; empty if they do."""
        group = self._groups.get(start.together)
        if group is None:
            decided = asyncio.get_running_loop().create_future()
            group = self._groups[start.together] = _Group(start.together, decided)
        group.starts[start.action] = start
        if group.starts.keys() >= set(group.names):
            why = why_not() or self._find_late(group)
            if why:
                self._give_up(group, why)
            else:
                self._decide(group, "")
                begin([group.starts[name] for name in group.names])
        try:
            return await asyncio.wait_for(asyncio.shield(group.decided), GATHER_S)
        except TimeoutError:
            if not group.decided.done():
                missing = ", ".join(name for name in group.names if name not in group.starts)
                self._give_up(
                    group, f"The start of {missing}, which is carried out together with it, did not arrive."
                )
            return group.decided.result()

    def break_up(self, action: str, why: str) -> None:
        """An action may not begin, so none of the actions begins that were to be carried out together with
        it."""
        for group in [group for group in self._groups.values() if action in group.names]:
            self._give_up(group, f"It is carried out together with {action}, which cannot start: {why}")

    def _find_late(self, group: _Group) -> str:
        """Why a waiting start may not begin any more; empty if all may begin."""
        memory = self._journal.memory
        for start in group.starts.values():
            known = memory.find(start.action, start.attempt) or memory.is_void(start.action, start.attempt)
            if known or memory.is_forgotten(start.position):
                return f"{start.action} may no longer start."
        return ""

    def _give_up(self, group: _Group, why: str) -> None:
        for start in group.starts.values():
            self._journal.forbid_attempts(start.action, start.attempt, start.position)
        self._decide(group, why)

    def _decide(self, group: _Group, why: str) -> None:
        del self._groups[group.names]
        group.decided.set_result(why)

"""Starts that the device carries out together: none of them begins before all have come.

What is in the device takes part, whether its start has come or not. So if one does not come in time, or may
not begin, none of them begins: each is void, and the lab requests what it wants anew.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Any

import msgspec

from labos.node.journal import Journal
from labos.node.protocol import JointStart

GATHER_S = 3.0
"""So long the starts of actions are waited for that are carried out together. It is less than the kernel
waits for an answer."""


class _Group(msgspec.Struct):
    """The starts that have come, by action, and why none of them begins (None: that is open; empty: they
    do)."""

    names: tuple[str, ...]
    decided: asyncio.Future[str]
    starts: dict[str, JointStart] = {}


class Gathering:
    """The starts of one node that wait for others."""

    def __init__(self, journal: Journal, *, wait_s: float = GATHER_S) -> None:
        self._journal, self._wait_s = journal, wait_s
        self._groups: dict[tuple[str, ...], _Group] = {}

    async def gather(
        self, start: JointStart, why_not: Callable[[], str], begin: Callable[[list[JointStart]], Any]
    ) -> str:
        """Wait for the other starts. When they are complete, and nothing is against it (``why_not``),
        ``begin`` is called once for all of them, at once. Returns why none of them begins; empty if they
        do."""
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
            return await asyncio.wait_for(asyncio.shield(group.decided), self._wait_s)
        except TimeoutError:
            if not group.decided.done():
                missing = ", ".join(name for name in group.names if name not in group.starts)
                self._give_up(
                    group, f"No start has come of {missing}, which is carried out together with it."
                )
            return group.decided.result()

    def break_up(self, action: str, why: str) -> None:
        """An action may not begin, so that none does that was to be carried out together with it."""
        for group in [group for group in self._groups.values() if action in group.names]:
            self._give_up(group, f"It is carried out together with {action}, and that is not: {why}")

    def _find_late(self, group: _Group) -> str:
        """Why a start may not begin any more that was waiting; empty if all may."""
        journal = self._journal
        for start in group.starts.values():
            known = journal.find(start.action, start.attempt) or journal.is_void(start.action, start.attempt)
            if known or journal.is_forgotten(start.position):
                return f"{start.action} may not begin any more."
        return ""

    def _give_up(self, group: _Group, why: str) -> None:
        for start in group.starts.values():
            self._journal.forbid_attempts(start.action, start.attempt, start.position)
        self._decide(group, why)

    def _decide(self, group: _Group, why: str) -> None:
        del self._groups[group.names]
        group.decided.set_result(why)


__all__ = ["GATHER_S", "Gathering"]

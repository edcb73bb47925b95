"""Checks the whole chain of the log in the background, while the lab works.

A kernel's start checks the part of the log that it folds, after the snapshot. The part before is checked
here, at low speed, by a thread with a connection of its own: it uses the processor for at most a tenth of the
time, and for less than a millisecond at once.
"""

from __future__ import annotations

import asyncio
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from typing import Any

import structlog

from labos.errors import LabosError

SHARE = 0.1
"""The largest part of the time in which the thread works."""

LEAST_PAUSE_S = 0.001

NoteProgress = Callable[[int, int], None]
Check = Callable[[NoteProgress], Any]
"""A check of the whole log. It reports its progress from time to time (records, of how many), and returns the
damage that it found, a value with ``position`` and ``reason``, or None."""

_log = structlog.get_logger(__name__)


class _Stopped(Exception):
    """The lab is closing."""


class LogCheck:
    """One check, from ``start`` to its end. ``on_damage(position, reason)`` is called in the loop's thread.
    ``checked`` of ``total`` records have been checked so far; ``done``: the check has ended, and ``damage``
    is the damage that it found, in words."""

    def __init__(self, check: Check, on_damage: Callable[[int, str], None]) -> None:
        self._check, self._on_damage = check, on_damage
        self._loop = asyncio.get_running_loop()
        self._ending = threading.Event()
        self._worked_s = 0.0
        self._thread = threading.Thread(target=self._work, name="labos-log-check", daemon=True)
        self.checked = self.total = 0
        self.done = False
        self.damage = ""

    def start(self) -> None:
        """Begin. Returns at once."""
        self._thread.start()

    async def close(self) -> None:
        """Stop the check. A thread that waits for a frozen database is not waited for."""
        self._ending.set()
        if self._thread.is_alive():
            await self._loop.run_in_executor(None, self._thread.join, 1.0)

    def make_view(self) -> dict[str, Any]:
        """The progress, for people and programs."""
        return {"checked": self.checked, "of": self.total, "done": self.done, "damage": self.damage}

    async def wait(self) -> None:
        """Wait until the check has ended."""
        await self._loop.run_in_executor(None, self._thread.join)

    # -- in the thread -----------------------------------------------------------------------

    def _work(self) -> None:
        try:
            found = self._check(self._note_progress)
        except _Stopped:
            return
        except LabosError as error:  # the database is away: the next start checks again
            _log.warning("log_check_ended_early", records=self.checked, why=str(error))
            return
        self.done = True
        if found is None:
            _log.info("log_checked", records=self.checked)
            return
        self.damage = f"Position {found.position}: {found.reason}."
        _log.error("log_damaged", position=found.position, why=found.reason)
        with suppress(RuntimeError):  # the loop is closed: the next start checks again
            self._loop.call_soon_threadsafe(self._on_damage, found.position, found.reason)

    def _note_progress(self, checked: int, total: int) -> None:
        self.checked, self.total = checked, total
        worked_s = time.thread_time()
        pause_s = max((worked_s - self._worked_s) * (1 / SHARE - 1), LEAST_PAUSE_S)
        self._worked_s = worked_s
        if self._ending.wait(pause_s):
            raise _Stopped

"""Measures how long a node's event loop is blocked, and by which code. A late heartbeat means that the loop
was blocked. It counts if the driver's own code was running, or had called the running code. Time in which the
thread had no processor does not count, if the system reports it (Linux). A delay also does not count if
another thread, which looks every few milliseconds, has not seen the loop at work.
"""

from __future__ import annotations

import asyncio
import sys
import threading
import time
import traceback
from pathlib import Path
from types import FrameType

BEAT_S = 0.01
LIMIT_S = 0.05
"""The longest time for which a callback may block the loop."""

_SCHEDSTAT = Path("/proc/thread-self/schedstat")


class LoopWatch:
    """Watches the loop in which it is started, and writes a line to ``report`` for each block."""

    def __init__(self, report: Path, driver: str) -> None:
        """``driver`` is the driver's module, or its package."""
        self._report, self._driver = report, driver
        self._last = self._waited = 0.0
        self._thread = 0
        self._held_by = ""

    def start(self) -> None:
        """Start watching."""
        self._thread = threading.get_ident()
        self._last, self._waited = time.monotonic(), _read_wait_s()
        threading.Thread(target=self._sample, name="loop watch", daemon=True).start()
        asyncio.get_running_loop().call_later(BEAT_S, self._beat)

    def _beat(self) -> None:
        now, waited = time.monotonic(), _read_wait_s()
        held_s = now - self._last - BEAT_S - (waited - self._waited)
        if held_s > LIMIT_S and self._held_by:
            with self._report.open("a", encoding="utf-8") as report:
                report.write(f"{held_s:.3f}\t{self._held_by}\n")
        # Writing the line takes time too, which must not be counted.
        self._last, self._waited, self._held_by = time.monotonic(), _read_wait_s(), ""
        asyncio.get_running_loop().call_later(BEAT_S, self._beat)

    def _sample(self) -> None:
        """Record the running code while a heartbeat is overdue."""
        while True:
            time.sleep(BEAT_S)
            if time.monotonic() - self._last < 3 * BEAT_S or self._held_by:
                continue
            frame = sys._current_frames().get(self._thread)
            if frame is None:
                continue
            if not self._is_driver_code(frame):
                continue
            # Without the text of the code lines, which would be read from disk.
            stack = traceback.StackSummary.extract(traceback.walk_stack(frame), lookup_lines=False)
            calls = [call for call in reversed(stack) if f"asyncio{_SEP}" not in call.filename][-3:]
            if Path(stack[0].filename).name == "selectors.py":
                continue  # it waits for an event
            self._held_by = " > ".join(f"{Path(c.filename).name}:{c.lineno} {c.name}" for c in calls)

    def _is_driver_code(self, frame: FrameType | None) -> bool:
        """Whether a frame, or one of its callers, is of the driver's code."""
        while frame is not None:
            name = str(frame.f_globals.get("__name__", ""))
            if name == self._driver or name.startswith(f"{self._driver}."):
                return True
            frame = frame.f_back
        return False


_SEP = "\\" if sys.platform == "win32" else "/"


def _read_wait_s() -> float:
    """How long this thread has been ready to run without a processor."""
    try:
        return int(_SCHEDSTAT.read_text().split()[1]) / 1e9
    except (OSError, IndexError, ValueError):
        return 0.0

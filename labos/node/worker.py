"""A thread for calls that block: devices and disks.

One thread, so that a device is never called twice at once and a file is written in order. It is
a daemon: a driver that never returns must not keep the process from ending.
"""

from __future__ import annotations

import asyncio
import queue
import threading
from collections.abc import Callable
from typing import Any


class Worker:
    """Calls functions one after the other in a thread of its own."""

    def __init__(self, name: str) -> None:
        self._name = name
        self._jobs: queue.SimpleQueue[Callable[[], None] | None] = queue.SimpleQueue()
        self._thread: threading.Thread | None = None

    async def __call__(self, function: Callable[[], Any]) -> Any:
        """The function's result, or what it raised."""
        loop = asyncio.get_running_loop()
        done: asyncio.Future[Any] = loop.create_future()

        def settle(put: Callable[[Any], None], value: Any) -> None:
            if not done.cancelled():
                put(value)

        def job() -> None:
            settled: tuple[Callable[[Any], None], Any]
            try:
                settled = (done.set_result, function())
            except StopIteration as error:
                settled = (done.set_exception, RuntimeError(f"StopIteration: {error}"))
            except Exception as error:
                settled = (done.set_exception, error)
            except BaseException as error:
                # What would end the thread, or the process, ends the call only.
                settled = (done.set_exception, RuntimeError(f"{type(error).__name__}: {error}"))
            try:
                loop.call_soon_threadsafe(settle, *settled)
            except RuntimeError:
                pass  # The loop has been closed while it worked.

        if self._thread is None:
            self._thread = threading.Thread(target=self._work, name=self._name, daemon=True)
            self._thread.start()
        self._jobs.put(job)
        return await done

    def close(self) -> None:
        """Let the thread end after what it was given."""
        self._jobs.put(None)

    def _work(self) -> None:
        while (job := self._jobs.get()) is not None:
            job()

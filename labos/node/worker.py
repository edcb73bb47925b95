"""A thread for calls that block: devices and disks.

It is one thread, so that a device is never called twice at once and a file is written in order. It is a
daemon thread, so that a driver that never returns does not keep the process from ending.
"""

from __future__ import annotations

import asyncio
import queue
import threading
from collections.abc import Callable
from typing import Any


class Worker:
    """Calls functions one after the other in its own thread."""

    def __init__(self, name: str) -> None:
        self._name = name
        self._jobs: queue.SimpleQueue[Callable[[], None] | None] = queue.SimpleQueue()
        self._thread: threading.Thread | None = None

    async def __call__(self, function: Callable[[], Any]) -> Any:
        """Returns the function's result, or raises its exception."""
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
                # An exception that would end the thread or the process ends only the call.
                settled = (done.set_exception, RuntimeError(f"{type(error).__name__}: {error}"))
            try:
                loop.call_soon_threadsafe(settle, *settled)
            except RuntimeError:
                pass  # the loop has been closed during the call

        if self._thread is None:
            self._thread = threading.Thread(target=self._work, name=self._name, daemon=True)
            self._thread.start()
        self._jobs.put(job)
        return await done

    def close(self) -> None:
        """Let the thread end after the calls that it has got."""
        self._jobs.put(None)

    def _work(self) -> None:
        while (job := self._jobs.get()) is not None:
            job()

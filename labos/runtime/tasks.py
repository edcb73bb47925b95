"""Background tasks: an error in one is reported."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Coroutine, Hashable
from functools import partial
from typing import Any

import structlog

from labos.ports import Handle
from labos.runtime.kernel import Kernel
from labos.runtime.kernel_log import Listener

_log = structlog.get_logger(__name__)


class Tasks:
    """The tasks of one part of the kernel."""

    def __init__(self) -> None:
        self._running: set[asyncio.Task[None]] = set()
        self._named: dict[Hashable, asyncio.Task[None]] = {}

    def spawn(self, work: Coroutine[Any, Any, None]) -> asyncio.Task[None]:
        task = asyncio.get_running_loop().create_task(work)
        self._running.add(task)
        task.add_done_callback(self._on_end)
        return task

    def spawn_once(self, name: Hashable, work: Callable[[], Coroutine[Any, Any, None]]) -> None:
        """Begin work, unless work of this name has not ended."""
        running = self._named.get(name)
        if running is None or running.done():
            task = self._named[name] = self.spawn(work())
            task.add_done_callback(partial(self._forget, name))

    def cancel(self) -> None:
        """Work of every name may begin again at once."""
        self._named.clear()
        for task in list(self._running):
            task.cancel()

    async def end(self) -> None:
        """Cancel all work, and wait until it has ended (but not for the task that asks for it)."""
        running = self._running - {asyncio.current_task()}
        self.cancel()
        if running:
            await asyncio.wait(running)

    def _on_end(self, task: asyncio.Task[None]) -> None:
        self._running.discard(task)
        error = None if task.cancelled() else task.exception()
        if error is not None:
            _log.error("task_failed", exc_info=error)

    def _forget(self, name: Hashable, task: asyncio.Task[None]) -> None:
        if self._named.get(name) is task:
            del self._named[name]


class KernelPart(Listener):
    """A part of the kernel's process: between its start and its close it listens to the kernel, has
    declarations on the bus (``_handles``), and works in tasks of its own."""

    def __init__(self, kernel: Kernel) -> None:
        self._kernel = kernel
        self._handles: list[Handle] = []
        self._tasks = Tasks()

    async def start(self) -> None:
        self._kernel.listeners.append(self)

    async def close(self) -> None:
        if self in self._kernel.listeners:
            self._kernel.listeners.remove(self)
        for handle in self._handles:
            handle.close()
        await self._tasks.end()

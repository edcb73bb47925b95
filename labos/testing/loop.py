"""A deterministic world of processes: virtual time, and processes that can be killed.

Everything runs on one asyncio loop whose clock jumps to the next timer instead of waiting. Code belongs to
the process in whose context it was started. After a process was killed, none of its code has an effect, not
even its ``finally`` blocks, because its ports are closed.
"""

from __future__ import annotations

import asyncio
import contextvars
import selectors
from collections.abc import Callable, Coroutine
from typing import Any

BASE_NS = 1_800_000_000 * 1_000_000_000
"""The start of virtual wall time (UTC ns)."""


class Killed(BaseException):
    """The process died at this line."""


class Stalled(Exception):
    """Something still waits, but nothing more can happen."""


class Process:
    """A simulated operating-system process."""

    def __init__(self, name: str, clock: VirtualClock | None = None) -> None:
        self.name = name
        self.clock = clock
        """The clock of its machine."""
        self.alive = True
        self.frozen = False
        self.powerless = False
        """Whether it died in a power cut of its machine, so that unsynced data are lost."""
        self.tasks: set[asyncio.Task[Any]] = set()
        self._after_thaw: list[Callable[[], object]] = []
        self.on_death: list[Callable[[], object]] = []

    def kill(self, *, powerless: bool = False) -> None:
        """Kill the process: none of its code runs any more."""
        if self.alive:
            self.alive = False
            self.powerless = powerless
            for notice in self.on_death:
                notice()

    def freeze(self) -> None:
        """Freeze the process. It keeps its memory, and its timers expire, but all calls wait until
        ``thaw``."""
        self.frozen = True

    def thaw(self) -> None:
        self.frozen = False
        waiting, self._after_thaw = self._after_thaw, []
        for run in waiting:
            run()

    def call_after_thaw(self, run: Callable[[], object]) -> None:
        self._after_thaw.append(run)


PROCESS: contextvars.ContextVar[Process | None] = contextvars.ContextVar("process", default=None)


class _Selector(selectors.SelectSelector):
    """A selector that advances virtual time instead of waiting."""

    def __init__(self) -> None:
        super().__init__()
        self.now = 0.0

    def select(self, timeout: float | None = None) -> list[Any]:
        if timeout is None:
            raise Stalled("nothing is left to happen")
        if timeout > 0:
            self.now += timeout
        return []


class VirtualLoop(asyncio.SelectorEventLoop):
    """An event loop in virtual time that knows processes."""

    def __init__(self) -> None:
        self._virtual = _Selector()
        super().__init__(self._virtual)
        self.set_task_factory(_task_factory)  # type: ignore[arg-type]
        self.set_exception_handler(_ignore_the_dead)

    def time(self) -> float:
        return self._virtual.now

    def call_soon(  # type: ignore[override]
        self, callback: Any, *args: Any, context: contextvars.Context | None = None
    ) -> asyncio.Handle:
        process = _process_of(context)
        if process is not None:
            return super().call_soon(_run_guarded, self, process, context, callback, args, context=context)
        return super().call_soon(callback, *args, context=context)

    def call_at(  # type: ignore[override]
        self, when: float, callback: Any, *args: Any, context: contextvars.Context | None = None
    ) -> asyncio.TimerHandle:
        process = _process_of(context)
        if process is not None:
            return super().call_at(
                when, _run_guarded, self, process, context, callback, args, context=context
            )
        return super().call_at(when, callback, *args, context=context)

    def start(self, process: Process, work: Coroutine[Any, Any, Any]) -> asyncio.Task[Any]:
        """Run a coroutine as part of a process."""
        return self.create_task(work, context=context_of(process))


def context_of(process: Process | None) -> contextvars.Context:
    """The context for the code of a process, or for code of no process."""
    context = contextvars.copy_context()
    context.run(PROCESS.set, process)
    return context


def _process_of(context: contextvars.Context | None) -> Process | None:
    return PROCESS.get() if context is None else context.get(PROCESS)


def _run_guarded(
    loop: VirtualLoop,
    process: Process,
    context: contextvars.Context | None,
    callback: Any,
    args: tuple[Any, ...],
) -> None:
    if not process.alive:
        return
    if process.frozen:
        same = contextvars.copy_context() if context is None else context
        process.call_after_thaw(lambda: loop.call_soon(callback, *args, context=same))
        return
    try:
        callback(*args)
    except Killed:
        process.kill()


def _task_factory(
    loop: asyncio.AbstractEventLoop, work: Coroutine[Any, Any, Any], **options: Any
) -> asyncio.Task[Any]:
    task: asyncio.Task[Any] = asyncio.Task(work, loop=loop, **options)
    task._log_destroy_pending = False  # type: ignore[attr-defined]
    process = _process_of(options.get("context"))
    if process is not None:
        # Kept until the world ends: a collected coroutine would run its finally blocks.
        process.tasks.add(task)
    return task


def _ignore_the_dead(loop: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
    error = context.get("exception")
    if isinstance(error, Killed):
        return
    loop.default_exception_handler(context)


class VirtualClock:
    """The clock port in virtual time: one for each machine. ``jump_ns`` is the error of its wall clock, which
    does not affect waiting."""

    def __init__(self, loop: VirtualLoop) -> None:
        self._loop = loop
        self.jump_ns = 0

    def set(self, off_s: float) -> None:
        """Make the wall clock jump: afterwards it is ``off_s`` fast."""
        self.jump_ns = int(off_s * 1e9)

    def now_ns(self) -> int:
        return BASE_NS + round(self._loop.time() * 1e9) + self.jump_ns

    def monotonic(self) -> float:
        return self._loop.time()


class CountedIds:
    """Ids that are the same in every simulation of a seed."""

    def __init__(self, prefix: str) -> None:
        self._prefix = prefix
        self._count = 0

    def new(self) -> str:
        self._count += 1
        return f"{self._prefix}-{self._count:06d}"

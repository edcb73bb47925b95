"""Calls of the client in threads, for programs that work with asyncio."""

from __future__ import annotations

import asyncio
import contextlib
import contextvars
import inspect
import itertools
import threading
from collections.abc import AsyncIterator, Callable, Coroutine, Iterator
from contextlib import AbstractContextManager, asynccontextmanager
from functools import wraps
from typing import Any, Concatenate, ParamSpec, TypeVar, cast

from labos.client._answers import LabUnreachable
from labos.client._calls import GIVEN_UP

P = ParamSpec("P")
T = TypeVar("T")
U = TypeVar("U")

MOST_CALLS, MOST_WAITS = 16, 256
"""The largest number of calls with a quick answer, and of calls that may wait for long, at the same time;
others queue."""


class Threads:
    """Runs calls, each in a thread of its own, up to a limit: a call that waits does not delay the others. A
    cancelled call is abandoned at once; its thread ends after its present request, and sends no other."""

    def __init__(self) -> None:
        self._calls, self._waits = asyncio.Semaphore(MOST_CALLS), asyncio.Semaphore(MOST_WAITS)
        self._running: dict[asyncio.Future[Any], threading.Event] = {}

    def give_up(self) -> None:
        """No caller waits any more for the calls in progress: each of them is abandoned."""
        for done, given_up in self._running.items():
            given_up.set()
            if not done.done():
                done.set_exception(LabUnreachable("The client was closed while it waited for the lab."))

    async def call(self, function: Callable[P, T], /, *args: P.args, **options: P.kwargs) -> T:
        """The result of a call with a quick answer."""
        async with self._calls:
            return await self._in_thread(lambda: function(*args, **options))

    async def wait(self, function: Callable[P, T], /, *args: P.args, **options: P.kwargs) -> T:
        """The result of a call that may wait."""
        async with self._waits:
            return await self._in_thread(lambda: function(*args, **options))

    async def iterate(self, iterator: Iterator[T]) -> AsyncIterator[T]:
        """The items, as they come."""
        while page := await self.wait(_take_next, iterator):
            yield page[0]

    async def iterate_pages(self, pages: Iterator[list[T]]) -> AsyncIterator[T]:
        """The items of pages, as they come."""
        async for page in self.iterate(pages):
            for item in page:
                yield item

    @asynccontextmanager
    async def block_of(
        self, manager: AbstractContextManager[T], twin: Callable[[T, Threads], U]
    ) -> AsyncIterator[U]:
        """A block whose beginning and end are calls; it yields the twin of the synchronous block's value."""
        found = await self.wait(manager.__enter__)
        try:
            yield twin(found, self)
        except BaseException as error:
            if not await self.wait(manager.__exit__, type(error), error, error.__traceback__):
                raise
        else:
            await self.wait(manager.__exit__, None, None, None)

    async def _in_thread(self, work: Callable[[], T]) -> T:
        loop = asyncio.get_running_loop()
        done: asyncio.Future[T] = loop.create_future()
        given_up = self._running[done] = threading.Event()
        context = contextvars.copy_context()
        context.run(GIVEN_UP.set, given_up)

        def settle(value: T | None, error: BaseException | None) -> None:
            if done.done():
                return
            if error is not None:
                done.set_exception(error)
            else:
                done.set_result(cast(T, value))

        def carry_out() -> None:
            value, raised = None, None
            try:
                value = context.run(work)
            except BaseException as error:  # the waiting caller raises it
                raised = error
            with contextlib.suppress(RuntimeError):  # the loop is closed: no caller waits
                loop.call_soon_threadsafe(settle, value, raised)

        threading.Thread(target=carry_out, name="lab-call", daemon=True).start()
        try:
            return await done
        except asyncio.CancelledError:
            given_up.set()
            raise
        finally:
            del self._running[done]


def _take_next(iterator: Iterator[T]) -> list[T]:
    """The next item; an empty list if there is none."""
    return list(itertools.islice(iterator, 1))


class Twin:
    """Calls ``sync``, whose calls wait, in threads."""

    sync: Any

    def __init__(self, sync: Any, threads: Threads) -> None:
        self.sync, self.threads = sync, threads


Method = Callable[Concatenate[Any, P], T]
AsyncMethod = Callable[Concatenate[Any, P], Coroutine[Any, Any, T]]


def ask(method: Method[P, T], *, waits: bool = False) -> AsyncMethod[P, T]:
    """The asynchronous twin of a method with a quick answer, or of one that ``waits``."""

    @wraps(method)
    async def work(twin: Twin, *args: P.args, **options: P.kwargs) -> T:
        call = twin.threads.wait if waits else twin.threads.call
        return await call(method, twin.sync, *args, **options)

    return work


def ask_and_wait(method: Method[P, T]) -> AsyncMethod[P, T]:
    """The asynchronous twin of a method that may wait."""
    return ask(method, waits=True)


def ask_in_turn(method: Method[P, T]) -> AsyncMethod[P, T]:
    """The same for an experiment's method with a key: the order of the keys is the order of the calls, not
    the order in which threads begin."""
    signature = inspect.signature(method)

    @wraps(method)
    async def work(twin: Twin, *args: P.args, **options: P.kwargs) -> T:
        _, about, *_ = signature.bind(twin.sync, *args, **options).arguments.values()
        key = twin.sync._record.take(method.__name__, about, options.get("key", ""))
        return await twin.threads.wait(method, twin.sync, *args, **{**options, "key": key})

    return work


def ask_one_by_one(method: Method[P, Iterator[T]]) -> Callable[Concatenate[Any, P], AsyncIterator[T]]:
    """The asynchronous twin of an iterator; it yields each item as it comes."""

    @wraps(method)
    def work(twin: Twin, *args: P.args, **options: P.kwargs) -> AsyncIterator[T]:
        return twin.threads.iterate(method(twin.sync, *args, **options))

    return work

"""The one thread that writes the log.

Batches queue up while a commit is under way and go to disk together in the next one (natural
group commit). A batch that somebody waits for never waits for others to come; only one that nobody
waits for is held back a moment (``PatientWriter``). After a failed commit everything queued is
dropped: the kernel reads the log again before it writes anything more.
"""

from __future__ import annotations

import asyncio
import queue
import threading
from collections.abc import Callable, Sequence
from typing import Any, Protocol, TypeVar

from labos.core.envelope import Record
from labos.errors import StoreError, StoreUnavailable
from labos.ports import EventStore, Head

T = TypeVar("T")

HOLD_S = 0.02
"""How long a batch that may wait does so: longer than a quick action takes, too short to see."""


class Writer(Protocol):
    """Writes batches in order and calls back on the event loop."""

    def begin(
        self, head: Head, on_durable: Callable[[int], None], on_failure: Callable[[StoreError], None]
    ) -> None:
        """Write behind ``head`` from now on. ``on_durable(position)`` after each commit."""

    def submit(self, records: Sequence[Record]) -> None: ...

    async def call(self, function: Callable[[EventStore], T]) -> T:
        """Use the store in between commits."""

    async def close(self) -> None: ...


class PatientWriter:
    """Passes batches on to a writer. One that ``may_wait`` stays back for a moment, so that it
    can go to disk with the next one; whatever else is asked of the writer sends it off first."""

    def __init__(self, writer: Writer, *, hold_s: float = HOLD_S) -> None:
        self._writer = writer
        self._hold_s = hold_s
        self._held: list[Record] = []
        self._alarm: asyncio.TimerHandle | None = None

    def begin(
        self, head: Head, on_durable: Callable[[int], None], on_failure: Callable[[StoreError], None]
    ) -> None:
        self.flush()
        self._writer.begin(head, on_durable, on_failure)

    def submit(self, records: Sequence[Record], *, may_wait: bool = False) -> None:
        self._held.extend(records)
        if not may_wait:
            self.flush()
        elif self._alarm is None:
            self._alarm = asyncio.get_running_loop().call_later(self._hold_s, self.flush)

    def flush(self) -> None:
        """Somebody waits for what was submitted."""
        if self._alarm is not None:
            self._alarm.cancel()
            self._alarm = None
        if self._held:
            records, self._held = self._held, []
            self._writer.submit(records)

    async def call(self, function: Callable[[EventStore], T]) -> T:
        self.flush()
        return await self._writer.call(function)

    async def close(self) -> None:
        self.flush()
        await self._writer.close()


class ThreadWriter:
    """The writer over a real store."""

    def __init__(self, store: EventStore, *, largest_batch: int = 2000) -> None:
        self._store = store
        self._largest = largest_batch
        self._jobs: queue.SimpleQueue[Any] = queue.SimpleQueue()
        self._loop = asyncio.get_running_loop()
        self._head: Head | None = None
        self._on_durable: Callable[[int], None] = lambda _: None
        self._on_failure: Callable[[StoreError], None] = lambda _: None
        self._thread = threading.Thread(target=self._work, name="labos-writer", daemon=True)
        self._thread.start()

    def begin(
        self, head: Head, on_durable: Callable[[int], None], on_failure: Callable[[StoreError], None]
    ) -> None:
        def start(_: EventStore) -> None:
            self._head, self._on_durable, self._on_failure = head, on_durable, on_failure

        self._jobs.put((start, None))

    def submit(self, records: Sequence[Record]) -> None:
        self._jobs.put(records)

    async def call(self, function: Callable[[EventStore], T]) -> T:
        future: asyncio.Future[T] = self._loop.create_future()
        self._jobs.put((function, future))
        return await future

    async def close(self) -> None:
        self._jobs.put(None)
        await self._loop.run_in_executor(None, self._thread.join)

    # -- in the thread -----------------------------------------------------------------------

    def _work(self) -> None:
        while True:
            job = self._jobs.get()
            if job is None:
                return
            batch: list[Record] = []
            last = None
            while job is not None:
                if isinstance(job, tuple):
                    last = job
                    break
                batch.extend(job)
                if len(batch) >= self._largest:
                    break
                try:
                    job = self._jobs.get_nowait()
                except queue.Empty:
                    break
            if batch:
                self._commit(batch)
            if last is not None:
                self._serve(*last)
            if job is None:
                return

    def _commit(self, batch: list[Record]) -> None:
        if self._head is None:
            return  # dropped: an earlier commit failed
        try:
            self._head = self._store.append(self._head, batch)
        except StoreError as error:
            self._head = None
            self._tell(self._on_failure, error)
        except Exception as error:
            self._head = None
            self._tell(self._on_failure, StoreUnavailable(f"The store failed unexpectedly: {error!r}."))
        else:
            self._tell(self._on_durable, self._head.position)

    def _serve(self, function: Callable[[EventStore], Any], future: asyncio.Future[Any] | None) -> None:
        try:
            result = function(self._store)
        except Exception as error:
            if future is not None:
                self._tell(_fail, future, error)
        else:
            if future is not None:
                self._tell(_answer, future, result)

    def _tell(self, function: Callable[..., None], *args: Any) -> None:
        try:
            self._loop.call_soon_threadsafe(function, *args)
        except RuntimeError:  # the loop is closed: nobody waits any more
            pass


def _answer(future: asyncio.Future[Any], result: Any) -> None:
    if not future.done():
        future.set_result(result)


def _fail(future: asyncio.Future[Any], error: BaseException) -> None:
    if not future.done():
        future.set_exception(error)

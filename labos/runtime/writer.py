"""The one thread that writes the log.

Batches queue up while a commit is in progress and go to disk together in the next one (natural group commit).
If a caller waits for a batch, the batch never waits for later ones; only a batch without a waiting caller is
held back for a moment (``PatientWriter``). After a failed commit all queued batches are dropped: the kernel
reads the log again before it writes anything more.
"""

from __future__ import annotations

import asyncio
import math
import queue
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import Any, Protocol, TypeVar

import msgspec

from labos.core.envelope import Record
from labos.errors import CommitInDoubt, StoreError, StoreUnavailable
from labos.ports import EventStore, Head
from labos.runtime.silence import SilenceTimer

T = TypeVar("T")

HOLD_S = 0.02
"""How long a batch that may wait is held back: longer than a quick action takes, too short to be noticed."""

SILENCE_S = 10.0
"""A request to a database without an answer for so long is abandoned, unless another limit is set."""

LARGEST_BATCH = 2000
"""The number of records from which a commit takes no further batch."""

LEAVE_S = 5.0
"""How long a thread may take to end after its pending call was interrupted."""


class Writer(Protocol):
    """Writes batches in order and calls back on the event loop."""

    def begin(
        self, head: Head, on_durable: Callable[[int], None], on_failure: Callable[[StoreError], None]
    ) -> None:
        """Write after ``head`` from now on. ``on_durable(position)`` is called after each commit."""

    def submit(self, records: Sequence[Record]) -> None: ...

    async def call(self, function: Callable[[EventStore], T]) -> T:
        """Use the store in between commits."""

    async def close(self) -> None: ...


class PatientWriter:
    """Passes batches on to a writer. A batch that ``may_wait`` is held back for a moment, so that it can be
    written together with the next one; any other request to the writer sends it at once."""

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
        """A caller waits for the submitted batches."""
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


class AnsweringStore(EventStore, Protocol):
    """A store whose calls can be interrupted."""

    name: str
    answered: int
    """Increases while a long reading of the log makes progress."""

    def hang_up(self) -> None:
        """Interrupt the database calls of all threads; they raise StoreUnavailable."""


class _Batch(msgspec.Struct, frozen=True):
    records: Sequence[Record]
    turn: int


class _Call(msgspec.Struct, frozen=True):
    function: Callable[[EventStore], Any]
    future: asyncio.Future[Any] | None


_Job = _Batch | _Call | None
"""None ends the thread."""


class ThreadWriter:
    """The writer over a real store. A call without an answer for ``silence_s`` is abandoned: the waiting
    caller gets an error at once, and the thread's pending call is interrupted.

    ``turn`` counts the starts and abandonments: jobs of an earlier turn are neither written nor reported.
    ``on_commit`` is called with the duration of each commit, in seconds.
    """

    def __init__(self, store: AnsweringStore, *, silence_s: float = SILENCE_S) -> None:
        self._store = store
        self._silence_s = silence_s
        self._jobs: queue.SimpleQueue[_Job] = queue.SimpleQueue()
        self._loop = asyncio.get_running_loop()
        self._head: Head | None = None
        self._turn = 0
        self._trusted = False
        self._given = self._done = 0
        self._calls: set[asyncio.Future[Any]] = set()
        self._on_durable: Callable[[int], None] = lambda _: None
        self._on_failure: Callable[[StoreError], None] = lambda _: None
        self.on_commit: Callable[[float], None] = lambda _: None
        self._silence = SilenceTimer(silence_s, self._sign, self._give_up)
        self._thread = threading.Thread(target=self._work, name="labos-writer", daemon=True)
        self._thread.start()

    def begin(
        self, head: Head, on_durable: Callable[[int], None], on_failure: Callable[[StoreError], None]
    ) -> None:
        self._turn += 1
        self._trusted = True
        self._on_durable, self._on_failure = on_durable, on_failure

        def start(_: EventStore) -> None:
            self._head = head

        self._put(_Call(start, None))

    def submit(self, records: Sequence[Record]) -> None:
        self._put(_Batch(records, self._turn))

    async def call(self, function: Callable[[EventStore], T]) -> T:
        future: asyncio.Future[T] = self._loop.create_future()
        self._calls.add(future)
        self._put(_Call(function, future))
        try:
            return await future
        finally:
            self._calls.discard(future)

    async def close(self) -> None:
        """Write the submitted batches. A thread whose call cannot be interrupted is not waited for."""
        self._jobs.put(None)
        patience_s = None if math.isinf(self._silence_s) else self._silence_s + LEAVE_S
        await self._loop.run_in_executor(None, self._thread.join, patience_s)
        self._silence.stop()

    def _put(self, job: _Batch | _Call) -> None:
        self._given += 1
        self._jobs.put(job)
        self._silence.watch()

    # -- silence -----------------------------------------------------------------------------

    def _sign(self) -> tuple[int, int] | None:
        """A value that changes whenever the store has answered; None if there is no open request."""
        return (self._done, self._store.answered) if self._done < self._given else None

    def _give_up(self) -> None:
        error = StoreUnavailable(
            f"The {self._store.name} has not answered for {self._silence_s:g} s: its last requests "
            "may be on disk or not.",
            remedy="Check that it runs and can be reached. When the lab answers again, check what was done "
            "before you repeat a request.",
        )
        for future in self._calls:
            settle(future, None, error)
        self._report_failure(error, self._turn)
        self._store.hang_up()

    def _report_failure(self, error: StoreError, turn: int) -> None:
        if turn == self._turn and self._trusted:
            self._turn += 1
            self._trusted = False
            self._on_failure(error)

    def _note_durable(self, position: int, turn: int, took_s: float) -> None:
        self.on_commit(took_s)
        if turn == self._turn:
            self._on_durable(position)

    # -- in the thread -----------------------------------------------------------------------

    def _work(self) -> None:
        job = self._jobs.get()
        while job is not None:
            if isinstance(job, _Call):
                self._serve(job.function, job.future)
                self._done += 1
                job = self._jobs.get()
            else:
                job = self._write(job)

    def _write(self, first: _Batch) -> _Job:
        """Commit a batch together with those that queued up behind it; returns the next job."""
        records, taken = list(first.records), 1
        while len(records) < LARGEST_BATCH:
            try:
                job = self._jobs.get_nowait()
            except queue.Empty:
                break
            if not isinstance(job, _Batch) or job.turn != first.turn:
                self._commit(records, first.turn)
                self._done += taken
                return job
            records.extend(job.records)
            taken += 1
        self._commit(records, first.turn)
        self._done += taken
        return self._jobs.get()

    def _commit(self, records: list[Record], turn: int) -> None:
        if self._head is None or turn != self._turn:
            return  # dropped: an earlier commit failed, or was abandoned
        began = time.monotonic()
        try:
            self._head = self._store.append(self._head, records)
        except StoreError as error:
            self._head = None
            self._call_in_loop(self._report_failure, error, turn)
        except Exception as error:
            self._head = None
            why = StoreUnavailable(f"The store failed unexpectedly: {error!r}.")
            self._call_in_loop(self._report_failure, why, turn)
        else:
            self._call_in_loop(self._note_durable, self._head.position, turn, time.monotonic() - began)

    def _serve(self, function: Callable[[EventStore], Any], future: asyncio.Future[Any] | None) -> None:
        if future is not None and future.done():
            return  # no caller waits for it any more
        result, failure = None, None
        try:
            result = function(self._store)
        except Exception as error:
            failure = error
        if future is not None:
            self._call_in_loop(settle, future, result, failure)

    def _call_in_loop(self, function: Callable[..., None], *args: Any) -> None:
        with suppress(RuntimeError):  # the loop is closed: no caller waits any more
            self._loop.call_soon_threadsafe(function, *args)


def settle(future: asyncio.Future[Any], result: Any, error: BaseException | None = None) -> None:
    """Give a result or an error to a caller, if it still waits."""
    if future.done():
        return
    if error is None:
        future.set_result(result)
    else:
        future.set_exception(error)


def make_in_doubt_error(error: StoreUnavailable) -> CommitInDoubt:
    """The error for callers who wait for a commit during which the store failed."""
    remedy = f"{error.remedy} Check with `labos log` before you repeat the request.".strip()
    return CommitInDoubt(error.message, remedy=remedy)

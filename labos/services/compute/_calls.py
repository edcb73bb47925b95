"""A computation and its attempts: if its worker dies, another one tries again."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from concurrent.futures import CancelledError, Executor, Future, ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from typing import Any

import msgspec

from labos.errors import BadInput, LabosError
from labos.services.compute._places import open_place
from labos.services.compute._sent import ComputesOnce, MemoryRecord, PlaceUnavailable, SendingRecord
from labos.services.compute._work import Measured, digest_code, digest_value, encode, make_name, measure

MOST_WAITING = 64
"""At most so many computations are in progress at once; the others wait."""

_DEATHS = frozenset({"BrokenProcessPool", "KilledWorker", "WorkerLost", "ManagerLost", "CancelledError"})
"""The names of the errors by which the places report that a worker died during a computation."""


class Attempts(msgspec.Struct, frozen=True):
    """How often a computation is tried again: ``after_death`` of its worker, and ``after_error`` of the
    function itself."""

    after_death: int = 2
    after_error: int = 0


class Computed(msgspec.Struct, frozen=True):
    """A computation that has ended, with the facts for the log."""

    function: str
    code: str
    arguments: str
    where: str
    attempts: int
    measured: Measured


class ComputeFailed(LabosError):
    """A computation gave no result."""

    def __init__(
        self,
        function: str,
        where: str,
        attempts: int,
        error: BaseException,
        *,
        code: str = "",
        arguments: str = "",
    ) -> None:
        times = "once" if attempts == 1 else f"{attempts} times"
        super().__init__(
            f"{function} was tried {times} ({where}) and failed: {type(error).__name__}: {error}."
        )
        self.function, self.where, self.attempts, self.error = function, where, attempts, error
        self.code, self.arguments = code, arguments


class Computing:
    """Computes functions at places, which are opened at their first use. May be used by many threads."""

    def __init__(self, places: Mapping[str, Any] | None = None, attempts: Attempts | None = None) -> None:
        self._configured = dict(places or {})
        self._attempts = attempts or Attempts()
        self._open: dict[str, Executor] = {}
        self._lock = threading.Lock()
        self._waiting = ThreadPoolExecutor(MOST_WAITING, thread_name_prefix="computing")

    def submit(
        self,
        function: Callable[..., Any],
        args: tuple[Any, ...] = (),
        named: Mapping[str, Any] | None = None,
        *,
        where: str = "pool",
        then: Callable[[Computed], Any] = lambda computed: computed.measured.value,
        failed: Callable[[ComputeFailed], None] = lambda error: None,
        unavailable: Callable[[], None] = lambda: None,
        sent: Callable[[int], SendingRecord] = lambda attempt: MemoryRecord(),
    ) -> Future[Any]:
        """Begin a computation. Its future has the result of ``then``; it raises ComputeFailed after a call of
        ``failed``, and PlaceUnavailable after a call of ``unavailable``. ``sent`` returns the log's record of
        an attempt, for a place that checks this record before it sends again. Raises NotFound, BadInput."""
        self._find_executor(where)  # an error about the place is raised at once
        given = dict(named or {})
        arguments = digest_value({"args": list(args), "named": given})

        def compute() -> Any:
            try:
                computed = self._compute(function, args, given, where, arguments, sent)
            except PlaceUnavailable:
                unavailable()
                raise
            except ComputeFailed as error:
                failed(error)
                raise
            return then(computed)

        return self._waiting.submit(compute)

    def close(self, *, drop: bool = False, wait: bool = True) -> None:
        """Close the places when all computations have ended. With ``drop``, computations that have not begun
        are dropped."""
        self._waiting.shutdown(wait, cancel_futures=drop)
        with self._lock:
            opened, self._open = list(self._open.values()), {}
        for executor in opened:
            executor.shutdown(wait)

    def _compute(
        self,
        function: Callable[..., Any],
        args: tuple[Any, ...],
        named: dict[str, Any],
        where: str,
        arguments: str,
        sent: Callable[[int], SendingRecord],
    ) -> Computed:
        name, deaths, errors = make_name(function), 0, 0
        while True:
            executor = self._find_executor(where)
            try:
                if isinstance(executor, ComputesOnce):
                    attempt = sent(deaths + errors + 1)
                    measured = executor.compute_once(attempt, measure, (function, args, named), {})
                else:
                    measured = executor.submit(measure, function, args, named).result()
                encode(measured.value)  # a value that cannot be encoded cannot be a result
            except PlaceUnavailable:
                raise
            except (Exception, CancelledError) as error:
                if _is_death(error):
                    self._forget(where, executor, error)
                    deaths += 1
                    again = deaths <= self._attempts.after_death
                else:
                    errors += 1
                    again = errors <= self._attempts.after_error and not isinstance(error, BadInput)
                if not again:
                    raise ComputeFailed(
                        name, where, deaths + errors, error, code=digest_code(function), arguments=arguments
                    ) from error
            else:
                return Computed(name, digest_code(function), arguments, where, deaths + errors + 1, measured)

    def _find_executor(self, where: str) -> Executor:
        with self._lock:
            if where not in self._open:
                self._open[where] = open_place(where, self._configured.get(where))
            return self._open[where]

    def _forget(self, where: str, executor: Executor, error: BaseException) -> None:
        """A pool accepts nothing more after one of its workers died: the next attempt opens another pool."""
        if not isinstance(error, BrokenProcessPool):
            return
        with self._lock:
            if self._open.get(where) is executor:
                del self._open[where]
        executor.shutdown(wait=False)


def _is_death(error: BaseException) -> bool:
    return any(kind.__name__ in _DEATHS for kind in type(error).__mro__)

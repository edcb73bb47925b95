"""Computes from the log the answer to a request that was carried out before this process knew of it.

The first event of a request contains its mark. So the log shows where it was carried out, and the state
before it is folded again. In this state the handler is called once more; its kernel does not decide, but
returns the events of that time.
"""

from __future__ import annotations

import asyncio
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import structlog
from starlette.responses import Response

from labos.clock import Clock, Uuid7Ids
from labos.core.decide import Command, Rejection, decide
from labos.core.envelope import Record
from labos.core.fold import evolve
from labos.core.ids import ModuleName
from labos.core.model import Description
from labos.core.registry import Event
from labos.core.state import LabState
from labos.errors import AlreadyDone, LabosError, StoreError
from labos.http.feed import Feed
from labos.planning.scheduler import Scheduler
from labos.ports import BlobStore, Bus
from labos.runtime.followed import FoldedLab
from labos.runtime.kernel_log import Listener
from labos.runtime.log_check import LogCheck
from labos.runtime.registry import Registry
from labos.services.log import Log, decode_event, fold_to

if TYPE_CHECKING:
    from labos.http.operation import AdmittedRequest, Api, Operation
    from labos.http.parts import Parts

FURTHER = 5_000
"""The next command of a request is searched for within so many records after the previous one."""

_log = structlog.get_logger(__name__)
_turn = asyncio.Semaphore(1)


class _NotInTheLog(Exception):
    """The answer depends on facts that are not in the log."""


class _StoppedClock:
    """A clock that stands still at the time of a record."""

    def __init__(self, at_ns: int) -> None:
        self._at_ns = at_ns

    def now_ns(self) -> int:
        return self._at_ns

    def monotonic(self) -> float:
        return 0.0


class RecordedKernel(FoldedLab):
    """A kernel in the ``state`` before a request, whose events are among ``records``: those that contain its
    ``mark``, and the events that they caused. It decides nothing: a command returns its events of that
    time."""

    def __init__(self, state: LabState, records: Sequence[Record], mark: str) -> None:
        self.state, self._records, self._mark = state, records, mark
        self.clock: Clock = _StoppedClock(records[0].head.recorded_at)
        self.ids = Uuid7Ids()
        self.listeners: list[Listener] = []
        self.failed: asyncio.Future[LabosError] = asyncio.get_running_loop().create_future()
        self.suspended = ""
        self.scheduler = Scheduler()

    async def scrub(self) -> str:
        """This was done when the request was carried out; nothing to do."""
        return ""

    def submit(self, command: Command, actor: str, causation: str = "") -> list[Event] | Rejection:
        """The events of the command. If the command is rejected now, it was rejected then too, as the state
        is the same."""
        decision = decide(self.state, command, actor)
        if isinstance(decision, Rejection):
            return decision
        if decision == []:
            return []
        return list(self.fold_next())

    def fold_next(self) -> Iterator[Event]:
        """The events of the request's next command; the state continues to the last of them."""
        cause = ""
        for record in self._records:
            head = record.head
            if head.position <= self.state.position:
                continue
            if cause and head.causation != cause:
                return
            event = decode_event(record)
            evolve(self.state, event, head.position, head.recorded_at)
            if not cause and not head.causation.startswith(self._mark):
                continue  # an event of another request in between
            cause = cause or head.id
            yield event
        if not cause:
            raise _NotInTheLog("a command has no events")


class _RecordedParts:
    """The parts of a service that answers from the log: no node is asked, and nothing is changed."""

    supervised = None
    log_check: LogCheck | None = None

    def __init__(self, parts: Parts, kernel: RecordedKernel) -> None:
        self.kernel, self.clock = kernel, kernel.clock
        self.store: Log = parts.store
        self.blobs: BlobStore = parts.blobs
        self.descriptions: Mapping[str, Description] = parts.descriptions
        self.broken_drivers: Mapping[str, str] = parts.broken_drivers
        self.simulated = parts.simulated

    @property
    def bus(self) -> Bus:
        raise _NotInTheLog("nodes were asked")

    @property
    def registry(self) -> Registry:
        raise _NotInTheLog("nodes were asked")

    @property
    def metrics(self) -> Any:
        raise _NotInTheLog("metrics were asked for")

    def follow_workcells(self, changed: Sequence[ModuleName] = ()) -> None:
        """This was done when the request was carried out."""


async def answer_from_log(
    api: Api, operation: Operation, asked: AdmittedRequest, mark: str, position: int
) -> Response:
    """The answer to a repeated request at the time when it was carried out; its first event contains ``mark``
    and is at ``position``. Raises AlreadyDone if the log is not enough."""
    from labos.http.operation import Call, respond
    from labos.http.service import LabService

    log = api.service.parts.store

    def read() -> tuple[LabState, list[Record]]:
        return fold_to(log, position - 1), list(log.read(position - 1, position + FURTHER))

    try:
        async with _turn:  # folding a log takes a while
            kernel = RecordedKernel(*await asyncio.to_thread(read), mark)
        if operation.recall is not None:
            return respond(operation, operation.recall(list(kernel.fold_next())))
        parts = _RecordedParts(api.service.parts, kernel)
        call = Call(api, asked.request, asked.who, LabService(parts, Feed()))
        return await operation.call(call, asked.arguments)
    except StoreError:
        raise
    except Exception as error:
        _log.info("answer_not_in_log", path=asked.request.url.path, position=position, error=repr(error))
        raise AlreadyDone(
            f"This request was carried out at position {position}; its answer is no longer stored.",
            remedy=f"See what it did: labos log --after {position - 1}",
        ) from None

"""A lab whose kernel is in another process: its log is followed here, and nothing is decided.

It is used in place of the kernel. Queries read the folded log; a command is checked against the rules, and
then sent to the kernel (``SendOn``). The log is read in a thread beside the event loop and folded in the
event loop, so that no query sees a half folded event.
"""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Callable, Sequence

import structlog

from labos.clock import Clock, Ids
from labos.core.decide import Command, Rejection, decide
from labos.core.envelope import GENESIS, check_chain
from labos.core.fold import evolve
from labos.core.ids import LabId
from labos.core.registry import Event, decode
from labos.core.state import LabState
from labos.errors import LabosError, LogDamaged, StoreError, StoreUnavailable
from labos.planning.scheduler import Scheduler
from labos.ports import EventStore, Head
from labos.runtime.kernel import make_error
from labos.runtime.kernel_log import Listener
from labos.runtime.ledger import Entry, find_hash, load
from labos.runtime.writer import settle

POLL_S = 0.05
"""How often the log is checked for new events, while there are no requests."""

CHUNK = 500
"""Events that are folded without a pause."""

PAGE = 5_000
"""Records that are read together."""

BEHIND_S = 3.0
"""How long a reader waits for the requested position."""

LOST_PAUSE_S = 0.5
"""The pause between two attempts to read a log that cannot be read."""

_log = structlog.get_logger(__name__)


class SendOn(Exception):
    """Only the kernel's process can continue from here."""


class Behind(StoreUnavailable):
    """This process does not know yet the position that the client knows."""


class FoldedLab:
    """Is used in place of a kernel, and decides nothing: it has the ``state`` to which a log was folded."""

    state: LabState

    @property
    def durable(self) -> int:
        """Everything that is known here is on disk."""
        return self.state.position

    @property
    def lab(self) -> LabId:
        return LabId(self.state.lab.id)

    @property
    def epoch(self) -> int:
        return self.state.lab.epoch

    async def flush(self) -> None:
        """Everything that is known here is on disk."""

    async def execute(self, command: Command, actor: str, causation: str = "") -> list[Event]:
        """Raises what a kernel would raise, and the errors of ``submit``."""
        answer = self.submit(command, actor, causation)
        if isinstance(answer, Rejection):
            raise make_error(answer)
        return answer

    def submit(self, command: Command, actor: str, causation: str = "") -> list[Event] | Rejection:
        """The events of a command, or its rejection."""
        raise NotImplementedError


class FollowedKernel(FoldedLab):
    """Follows one log. ``open`` reads it; ``follow`` reads new events. ``plan_with`` makes the scheduler that
    explains why runs wait."""

    def __init__(
        self, store: EventStore, clock: Clock, ids: Ids, plan_with: Callable[[], Scheduler] = Scheduler
    ) -> None:
        self.clock, self.ids = clock, ids
        self.listeners: list[Listener] = []
        self.failed: asyncio.Future[LabosError] = asyncio.get_running_loop().create_future()
        self.suspended = ""
        """The last reason that the kernel has given why it starts nothing."""
        self.state = LabState()
        self._store = store
        self._hash = GENESIS
        self._plan_with = plan_with
        self._scheduler = plan_with(), -1
        self._looking = asyncio.Event()
        self._waiting: list[asyncio.Future[None]] = []
        self._grown = asyncio.Event()
        self._task: asyncio.Task[None] | None = None

    # -- queries of a kernel -----------------------------------------------------------------

    @property
    def scheduler(self) -> Scheduler:
        """A scheduler that explains why runs wait; it starts none."""
        if self._scheduler[1] != self.state.position:
            self._scheduler = self._plan_with(), self.state.position
        return self._scheduler[0]

    # -- commands ----------------------------------------------------------------------------

    async def scrub(self) -> str:
        """The kernel does it."""
        raise SendOn

    def submit(self, command: Command, actor: str, causation: str = "") -> list[Event] | Rejection:
        """The rejection of a command. Raises SendOn if there is none."""
        answer = decide(self.state, command, actor)
        if isinstance(answer, Rejection):
            return answer
        raise SendOn

    # -- the log -----------------------------------------------------------------------------

    async def open(self) -> None:
        """Read the log up to its present end. Raises StoreError."""

        def read() -> tuple[LabState, bytes]:
            state, _ = load(self._store)
            return state, find_hash(self._store, state.position)

        self.state, self._hash = await asyncio.to_thread(read)

    def follow(self) -> None:
        """Read new events until closed."""
        self._task = asyncio.get_running_loop().create_task(self._follow())

    async def close(self) -> None:
        if self._task is not None:
            self._task.cancel()
            await asyncio.wait({self._task})
        self._answer_waiting(
            self._waiting, StoreUnavailable("This process is shutting down.", remedy="Ask again.")
        )

    async def wait_until_known(self, at_least: int = 0) -> None:
        """Wait until everything is known here that was on disk when this was called, and until the position
        ``at_least`` is. Raises StoreUnavailable, and Behind if that takes more than a few seconds."""
        looked: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        self._waiting.append(looked)
        self._looking.set()
        await looked
        try:
            async with asyncio.timeout(BEHIND_S):
                while self.durable < at_least:
                    await self._grown.wait()
        except TimeoutError:
            raise Behind(
                f"This process knows the log up to position {self.durable}, not yet up to {at_least}.",
                remedy="Ask again in a moment; if this does not change, its copy of the database is not up "
                "to date.",
            ) from None

    async def _follow(self) -> None:
        logged = ""
        while True:
            with contextlib.suppress(TimeoutError):
                await asyncio.wait_for(self._looking.wait(), POLL_S)
            self._looking.clear()
            asked, self._waiting = self._waiting, []
            try:
                await self._catch_up()
            except StoreError as error:
                if str(error) != logged:
                    _log.warning("log_not_read", why=str(error))
                logged = str(error)
                self._answer_waiting(asked, error)
                await asyncio.sleep(LOST_PAUSE_S)
            except Exception as error:  # the next attempt may succeed, and no request may wait without end
                _log.exception("log_not_followed")
                self._answer_waiting(asked, StoreUnavailable(f"The log could not be followed: {error!r}."))
                await asyncio.sleep(LOST_PAUSE_S)
            else:
                logged = ""
                self._answer_waiting(asked)

    @staticmethod
    def _answer_waiting(asked: Sequence[asyncio.Future[None]], error: LabosError | None = None) -> None:
        for future in asked:
            settle(future, None, error)

    async def _catch_up(self) -> None:
        head = await asyncio.to_thread(self._store.head)
        while head.position > self.durable:
            try:
                entries = await asyncio.to_thread(self._read, self.durable, self._hash, head)
            except LogDamaged:
                if await asyncio.to_thread(self._is_same_log):
                    raise
                await self._restart()
                return
            await self._fold(entries)
        if head.position < self.durable or (head.position == self.durable and head.hash != self._hash):
            await self._restart()

    def _read(self, after: int, before: bytes, head: Head) -> list[Entry]:
        """A page of new records, each checked against the one before. Raises LogDamaged."""
        records = self._store.read(after, min(head.position, after + PAGE))
        entries = [
            Entry(record, decode(record.head.type, record.head.schema, record.payload))
            for record in check_chain(records, before, after, "See labos verify.")
        ]
        if not entries:
            raise StoreUnavailable("The head of the log is after its last record.")
        return entries

    async def _fold(self, entries: Sequence[Entry]) -> None:
        for begin in range(0, len(entries), CHUNK):
            chunk = entries[begin : begin + CHUNK]
            for entry in chunk:
                head = entry.record.head
                evolve(self.state, entry.event, head.position, head.recorded_at)
            self._hash = chunk[-1].record.hash
            for listener in self.listeners:
                listener.on_committed(chunk)
            self._grown.set()  # wakes everybody who waits now
            self._grown.clear()
            await asyncio.sleep(0)

    def _is_same_log(self) -> bool:
        """Whether the log still has the records that were read from it."""
        return find_hash(self._store, self.durable) == self._hash

    async def _restart(self) -> None:
        """The log was replaced by another one: a backup was restored."""
        _log.warning("log_is_another", position=self.durable)
        await self.open()
        for listener in self.listeners:
            listener.on_reopened()

"""Makes real logs: real decisions, folded and sealed, at times that a test chooses."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any

from labos.core.branches import main_steps
from labos.core.canonical import digest
from labos.core.decide import LABOS, Command, Rejection, carry_out
from labos.core.decide.actions import AcceptAction, FinishAction, StartStep
from labos.core.decide.lab import ApplyWorkcell, CreateLab, DeclareStation, StartKernel
from labos.core.decide.nodes import JoinNode
from labos.core.decide.runs import SubmitRun
from labos.core.envelope import GENESIS, Envelope, Record, seal
from labos.core.ids import ActionId, LabId, RunId
from labos.core.registry import Event, encode
from labos.core.runs import PENDING
from labos.core.state import LabState
from labos.ports import Head
from labos.runtime.ledger import Entry, Ledger, snapshot
from labos.store import FolderBlobs, open_store
from tests.simulation import mixes

START_NS = 1_750_000_000_000_000_000
"""2025-06-15T15:06:40Z."""
SECOND = 1_000_000_000


class Clock:
    """Stands until it is told."""

    def __init__(self) -> None:
        self.now = START_NS

    def now_ns(self) -> int:
        return self.now

    def monotonic(self) -> float:
        return self.now / 1e9


class Ids:
    def __init__(self) -> None:
        self.count = 0

    def new(self) -> str:
        self.count += 1
        return f"id-{self.count:08d}"


class Logbook:
    """A lab on paper; ``now`` is in seconds after the start."""

    def __init__(self, *, pace: float = 1.0) -> None:
        self.clock, ids = Clock(), Ids()
        self.ledger = Ledger(LabState(), Head(LabId("lab-1"), 0, GENESIS, 1), self.clock, ids)
        self.records: list[Record] = []
        self.entries: list[Entry] = []
        self._actions = 0
        self.do(CreateLab(LabId("lab-1"), "paper", pace), "labos")
        self.do(StartKernel(1, "0.1.0"), "labos")

    @property
    def state(self) -> LabState:
        return self.ledger.state

    @property
    def position(self) -> int:
        return self.ledger.head.position

    def at(self, seconds: float) -> None:
        """Set the clock."""
        self.clock.now = START_NS + round(seconds * SECOND)

    def do(self, command: Command, actor: str = "ada") -> list[Event]:
        begin = len(self.entries)

        def write(event: Event) -> Event:
            cause = self.entries[begin].record.head.id if len(self.entries) > begin else ""
            self._keep(self.ledger.write(event, actor, cause))
            return self.entries[-1].event

        events = carry_out(self.state, command, write, LABOS)
        assert not isinstance(events, Rejection), events
        return events

    def write(self, events: Sequence[Event], actor: str = "labos") -> None:
        for event in events:
            self._keep(self.ledger.write(event, actor))

    def _keep(self, entry: Entry) -> None:
        self.entries.append(entry)
        self.records.append(entry.record)

    def furnish(self) -> None:
        """The RPL workcell, all nodes idle, stocked."""
        cell = mixes.CELL.workcell
        self.do(ApplyWorkcell(cell))
        contents: dict[Any, list[str]] = {station.name: [] for station in cell.places}
        for item in mixes.CELL.bench.stock:
            contents[item.station] += [item.labware] * item.count
        for name, kinds in contents.items():
            self.do(DeclareStation(name, tuple(kinds)))
        for module in cell.modules:
            self.do(JoinNode(module.name, "j", "i", module.driver, "1", "", "IDLE", True), module.name)

    def submit(self, workflow: str, user: str = "ada", **more: Any) -> str:
        plan = mixes.PLANS[workflow].plan
        self.do(SubmitRun(plan, user, mixes.PAYLOADS[workflow], **more), user)
        return f"R{self.state.runs.named}"

    def start(self, run: str, step: int) -> ActionId:
        self._actions += 1
        action = ActionId(f"a{self._actions}")
        self.do(StartStep(RunId(run), step, action, self.clock.now), "labos")
        self.do(AcceptAction(action, 1, self.clock.now), "node")
        return action

    def finish(
        self, action: ActionId, *, succeeded: bool = True, effects: Any = "all", error: str = ""
    ) -> None:
        module = self.state.actions.open[action].module
        self.do(FinishAction(action, 1, succeeded, effects, None, error), module)

    def step(self, run: str, step: int, *, until: float) -> None:
        """One step from now until then."""
        action = self.start(run, step)
        self.at(until)
        self.finish(action)

    def carry_through(self, run: str, *, seconds: float = 1.0, steps: int | None = None) -> None:
        """All steps of a chain that are left, or so many, one after the other."""
        now = (self.clock.now - START_NS) / SECOND
        active = self.state.runs.get(run)
        assert active is not None
        total = len(main_steps(self.state.runs.plan_of(active)))
        first = active.statuses.index(PENDING) if active.has_started else 0
        for index in range(first, total if steps is None else first + steps):
            now += seconds
            self.step(run, index, until=now)

    def save(self, home: Path, *, with_snapshot: bool = False) -> str:
        """Write the log to the home's own SQLite file; returns its URL."""
        return save(self.records, home, snapshot_of=self.ledger if with_snapshot else None)


def save(records: Sequence[Record], home: Path, *, snapshot_of: Ledger | None = None) -> str:
    """Write records to ``home/labos.db`` as a kernel would; it has ended in order afterwards."""
    home.mkdir(exist_ok=True)
    blobs = FolderBlobs(home / "blobs")
    for content in mixes.FILES:
        blobs.put(content)
    url = f"sqlite:///{home / 'labos.db'}"
    store = open_store(url, home=home)
    try:
        head = store.claim(LabId(records[0].head.lab), "test", 30.0)
        for first in range(0, len(records), 5000):
            head = store.append(head, records[first : first + 5000])
        if snapshot_of is not None:
            store.save_snapshot(*snapshot(snapshot_of.state, snapshot_of.head))
        store.release(head.epoch)
    finally:
        store.close()
    return url


def seal_records(told: Sequence[tuple[float, str, Event]]) -> list[Record]:
    """Records of events as they are given, (seconds, actor, event): nothing is decided or folded."""
    records: list[Record] = []
    previous = GENESIS
    for position, (seconds, actor, event) in enumerate(told, 1):
        payload = encode(event)
        head = Envelope(
            lab="lab-1",
            position=position,
            id=f"id-{position}",
            stream=event.stream(),
            version=position,
            type=event.TYPE,
            schema=event.SCHEMA,
            recorded_at=START_NS + round(seconds * SECOND),
            actor=actor,
            correlation="",
            causation="",
            digest=digest(payload),
        )
        record = seal(previous, head, payload)
        previous = record.hash
        records.append(record)
    return records


@cache
def two_users() -> Logbook:
    """A short day: ada's PCR runs to its end, bo's gets half-way, an experiment parks a plate."""
    book = Logbook(pace=10.0)
    book.furnish()
    book.at(100)
    first, second = book.submit("pcr", "ada"), book.submit("pcr", "bo")
    book.at(110)
    book.carry_through(first, seconds=10)
    book.at(300)
    book.carry_through(second, seconds=10, steps=5)
    book.at(400)
    return book

"""kill -9 at random instants: kernel, nodes, router, database server, and several at once.

Eight runs (four PCRs and a colour picker, which is a process of its own) on real processes. Afterwards every
run has completed, bench and log agree in every plate, no hand closed once too often, and no node's journal
knows what the log does not. Seeds, kinds and instants are printed, and the line that does one again.
"""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import pytest

from labos.client import LabClient
from labos.core.ids import local
from labos.core.state import LabState
from labos.errors import StoreError
from labos.node.world import World
from labos.services.truth import list_differences
from labos.settings import free_port
from labos.spec import find_spec
from labos.store import SqlEventStore, open_store
from tests.support.carried import find_carried_wrong
from tests.support.cells import rpl_with
from tests.support.instants import AT_WORK, NODES, Instant, Ordeal, draw
from tests.support.lab_process import labos
from tests.support.postgres import PostgresServer
from tests.system import test_kills as kills

APP = Path(__file__).parents[2] / "specs" / "apps" / "first_color_picker.py"
SEEDS = os.environ.get("LABOS_KILL_SEEDS", "1 2 3 4 5").split()
AGAIN = "LABOS_KILL_SEEDS={seed} pytest tests/system/test_random_kills.py -s -m full -k {database}"
INSTANTS = 10
NEEDED = {*NODES, "ot2_cp_gamma"}
PATIENCE_S = 240.0


def words_of(pid: int) -> list[str]:
    """The words by which a process was called."""
    return Path(f"/proc/{pid}/cmdline").read_text().replace("\0", " ").split()


class Work(NamedTuple):
    """So many PCRs of two users, and a colour picker that mixes so often."""

    pcrs: int
    mixes: int
    speed: int

    @property
    def runs(self) -> int:
        """The colour picker also fetches a plate, and throws it away."""
        return self.pcrs + self.mixes + 2


ALL = Work(4, 2, 600)
LITTLE = Work(1, 1, 3000)


class Lab(kills.Lab):
    """A lab of which any process may be killed."""

    def __init__(
        self, home: Path, database: str, ordeal: Ordeal, server: PostgresServer | None, work: Work
    ) -> None:
        super().__init__(home, database, "")
        self.server, self.ordeal, self.work = server, ordeal, work
        self.seen = LabState()
        """The state when its person looked last."""
        self._reader: SqlEventStore | None = None
        self.bus: subprocess.Popen[bytes] | None = None
        self.app: subprocess.Popen[bytes] | None = None
        self.struck: Counter[str] = Counter()
        self.added = 0
        """PCRs beside its work, so that each instant comes while something is left to do."""
        self.workcell = str(rpl_with(NEEDED, home.parent / "rpl.yaml"))
        self.options = ["--speed", str(work.speed), *(["--detach-nodes"] if ordeal.detached else [])]
        self.endpoint = f"tcp/127.0.0.1:{free_port()}"
        if ordeal.own_bus:
            self.options += ["--bus", self.endpoint]
            self.start_bus()

    def start_bus(self) -> None:
        argv = [sys.executable, "-m", "labos", "bus", "--listen", self.endpoint]
        with (self.home / "bus.log").open("ab") as log:
            self.bus = subprocess.Popen(argv, stdin=subprocess.DEVNULL, stdout=log, stderr=log)

    def nodes(self) -> dict[str, int]:
        """The living nodes of this lab, and their processes."""
        found = {}
        for path in (self.home / "nodes").glob("*.json"):
            with contextlib.suppress(OSError, msgspec.MsgspecError):
                note = msgspec.json.decode(path.read_bytes())
                name, pid = note["module"].rpartition("/")[2], int(note["pid"])
                if {name, str(self.home)} <= set(words_of(pid)):
                    found[name] = pid  # and nobody else who got its number since
        return found

    def position(self) -> int:
        """Where the log ends; 0 while nobody can say."""
        try:
            if self._reader is None:
                self._reader = open_store(self.database, create=False, read_only=True)
            return self._reader.head().position
        except StoreError:
            return 0

    def fold_log(self) -> tuple[LabState, list[Any]]:
        self.seen, records = super().fold_log()
        return self.seen, records

    def at_work(self) -> list[str]:
        """The modules that have an action in flight and a living node."""
        state, _ = self.fold_log()
        flying = {local(a.module) for a in state.actions.open.values() if a.status == "accepted"}
        return sorted(flying & self.nodes().keys())

    def is_done(self) -> bool:
        """Whether nothing was left to do when its person looked last."""
        state = self.seen
        alive = state.runs.active or state.runs.queued or state.interventions.open
        return not alive and state.runs.named >= self.runs

    @property
    def runs(self) -> int:
        return self.work.runs + self.added + self.resets

    def victim(self, instant: Instant, world: World) -> str:
        """Which node is hit; waits until it lives."""
        if instant.node != AT_WORK:
            self.wait_for(lambda: instant.node in self.nodes(), world)
            return instant.node
        found: list[str] = []

        def look() -> bool:
            found[:] = self.at_work()
            return bool(found) or self.is_done()

        self.wait_for(look, world)
        return found[0] if found else ""

    def strike(self, instant: Instant, world: World) -> None:
        """Kill what is to be killed, and start again what nobody else starts."""
        kinds = set(instant.kind.split("+"))
        if "everything" in kinds:
            kinds = {
                "kernel",
                "nodes",
                *(["router"] if self.bus else []),
                *(["server"] if self.server else []),
            }
        who = self.victim(instant, world) if "node" in kinds else ""
        pids = [pid for name, pid in self.nodes().items() if "nodes" in kinds or name == who]
        if "kernel" in kinds and self.process is not None:
            pids.append(self.process.pid)
        if "router" in kinds and self.bus is not None:
            pids.append(self.bus.pid)
        for pid in pids:
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)
        if "kernel" in kinds and self.process is not None:
            self.process.wait()
        if "server" in kinds and self.server is not None:
            self.server.restart(immediate=True)
        if "router" in kinds and self.bus is not None:
            self.bus.wait()
            time.sleep(instant.away_s)  # that long it is away
            self.start_bus()
        self.struck[instant.kind] += 1

    def wait_for(self, holds: Callable[[], bool], world: World | None = None) -> None:
        """Keep the lab up until something holds, and be its person if there is a bench to look at."""
        give_up, looked = time.monotonic() + PATIENCE_S, 0.0
        while not holds():
            assert time.monotonic() < give_up, self.last_words()
            assert self.app is None or not self.app.poll(), (self.home / "app.log").read_text()
            self.keep_up()
            if world is not None and time.monotonic() - looked > 0.4:
                looked = time.monotonic()
                self.be_a_person(world)
            time.sleep(0.005)

    def last_words(self) -> str:
        state, _ = self.fold_log()
        alive = [(run.id, run.status) for run in (*state.runs.active.values(), *state.runs.queued.values())]
        asked = [(q.id, q.kind, q.text) for q in state.interventions.open.values()]
        at = {name: module.status for name, module in state.modules.by_name.items()}
        return f"{self.ordeal}\n{alive}\n{asked}\n{at}\n" + (self.home / "up.log").read_text()[-3000:]

    def clean_up(self) -> None:
        if self._reader is not None:
            self._reader.close()
        for process in (self.process, self.bus, self.app):
            if process is not None:
                process.kill()
                process.wait()
        for pid in self.nodes().values():
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)


def submit_pcr(lab: Lab, number: int) -> str:
    pcr, payload = find_spec("workflows", "pcr"), {"seal": {"time": 3.0}}

    def ask(client: LabClient) -> str:
        return client.submit(pcr, payload, user=("ada", "bo")[number % 2], request=f"pcr {number}")

    return str(lab.ask(ask))


def submit(lab: Lab) -> None:
    """Its PCRs, and the colour picker."""
    runs = {submit_pcr(lab, 0)}
    with (lab.home / "app.log").open("ab") as log:
        argv = [sys.executable, str(APP), "--home", str(lab.home), "--user", "cy"]
        argv += ["--rounds", str(lab.work.mixes), "--patience", str(PATIENCE_S)]
        lab.app = subprocess.Popen(argv, stdin=subprocess.DEVNULL, stdout=log, stderr=log)
    runs |= {submit_pcr(lab, number) for number in range(1, lab.work.pcrs)}
    assert len(runs) == lab.work.pcrs


def wait_for_instant(lab: Lab, instant: Instant, world: World) -> None:
    """Until so many events came, while something is left to do: how many come between two looks at the log
    depends on how busy the machine is."""
    due = lab.position() + instant.gap
    lab.wait_for(lambda: lab.position() >= due or lab.is_done(), world)
    if lab.is_done():
        print(f"all was done before {instant}: one more PCR")
        submit_pcr(lab, lab.work.pcrs + lab.added)
        lab.added += 1
        wait_for_instant(lab, instant, world)


def outlive(lab: Lab) -> None:
    """Everything that this lab has to go through, then the end of its work."""
    lab.start()
    try:
        submit(lab)
        world = World(str(lab.home / "world" / "rpl.db"))
        try:
            for instant in lab.ordeal.instants:
                wait_for_instant(lab, instant, world)
                time.sleep(instant.late_ms / 1000)  # the instant itself: it is not known what happens then
                lab.strike(instant, world)
            lab.wait_for(lambda: lab.is_done() and lab.app is not None and lab.app.poll() == 0, world)
            sound(lab, world)
        finally:
            world.close()
        lab.wait_for(lambda: lab.process is not None and lab.process.poll() is None)
        assert lab.stop() == 0
    finally:
        lab.clean_up()


def sound(lab: Lab, world: World) -> None:
    """The bench is as the log says, in every plate; nothing was done twice and nothing is missing."""
    state, records = lab.fold_log()
    assert list_differences(world, state, records) == []
    assert find_carried_wrong(world, records) == []
    kinds = ("run.completed", "run.failed", "run.cancelled")
    ends = Counter(record.head.type for record in records if record.head.type in kinds)
    assert ends == {"run.completed": lab.runs}, lab.questions
    verified = labos("verify", "--journals", "--home", str(lab.home), "--database", lab.database)
    assert verified.returncode == 0, verified.stdout + verified.stderr


@pytest.fixture(params=["sqlite", pytest.param("postgres", marks=pytest.mark.postgres)])
def place(
    request: pytest.FixtureRequest, tmp_path: Path, own_postgres: Callable[[], PostgresServer]
) -> Iterator[tuple[str, PostgresServer | None]]:
    """A database, and its server if it has one."""
    if request.param == "sqlite":
        yield f"sqlite:///{tmp_path}/labos.db", None
        return
    server = own_postgres()
    yield server.create_database("lab"), server


def go_through(
    folder: Path, place: tuple[str, PostgresServer | None], seed: int, count: int, work: Work
) -> None:
    database, server = place
    ordeal = draw(seed, count, server=server is not None)
    name = "postgres" if server is not None else "sqlite"
    print(f"\n{name}, {ordeal}\nonce more: {AGAIN.format(database=name, seed=seed)}")
    began = time.monotonic()
    lab = Lab(folder / "lab", database, ordeal, server, work)
    outlive(lab)
    took = time.monotonic() - began
    told = ", ".join(f"{kind} {times}" for kind, times in sorted(lab.struck.items()))
    print(f"{lab.struck.total()} instants in {took:.0f} s: {told}; asked: {dict(Counter(lab.questions))}")


def test_two_instants(tmp_path: Path) -> None:
    go_through(tmp_path, (f"sqlite:///{tmp_path}/labos.db", None), 1, 2, LITTLE)


@pytest.mark.full
@pytest.mark.timeout(600)
@pytest.mark.parametrize("seed", SEEDS)
def test_ten_instants_in_one_life(
    tmp_path: Path, place: tuple[str, PostgresServer | None], seed: str
) -> None:
    go_through(tmp_path, place, int(seed), INSTANTS, ALL)

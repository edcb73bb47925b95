"""A standby takes the place of a kernel that dies or freezes, on real Postgres with real nodes.

Afterwards the bench and the log agree in every plate, nothing was done twice, every run has ended; a
frozen kernel that wakes up can neither write nor move anything, and leaves the nodes alone.
"""

from __future__ import annotations

import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from labos.bootstrap._standby import SETTLED_S, SURE_S
from labos.core.actions import ActionRequested
from labos.core.lab import KernelStarted
from labos.core.registry import decode
from labos.settings import free_port
from tests.support.lab_process import Up, labos, statuses, until
from tests.support.postgres import PostgresServer

pytestmark = pytest.mark.postgres

SITE = Path(__file__).parents[1] / "support" / "crash_site"
TAKEN_OVER_S = 10.0
FROZEN_S = 30.0

CELL = """
labos: 1
name: rpl
modules:
  - {name: sciclops, model: sciclops}
  - {name: pf400, model: pf400}
stations:
  wc.trash: {kind: waste, capacity: 50}
  wc.parking: {kind: hotel, capacity: 8}
stock:
  sciclops.tower1: {plate96: 12}
"""

AWAY = """
labos: 1
name: away
steps:
  - {name: Get, module: sciclops, action: get_plate, args: {loc: tower1}}
  - {name: Park, module: pf400, action: transfer, args: {source: sciclops.exchange, target: wc.parking}}
  - {name: Discard, module: pf400, action: transfer, args: {source: wc.parking, target: wc.trash}}
"""


class Pair:
    """A bus by itself, a kernel, and another that stands by; nodes outlive both."""

    def __init__(self, folder: Path, database: str, speed: float, *, secure: bool = False) -> None:
        self.home = folder / "lab"
        self.endpoint = f"{'tls' if secure else 'tcp'}/127.0.0.1:{free_port()}"
        self.bus_options = ("--secure", "--home", str(self.home)) if secure else ()
        self.start_bus()
        if secure:
            try:
                until((self.home / "pki" / "members.json").exists, "the bus has an authority")
            except BaseException:
                self.bus.kill()
                raise
        common = ("--database", database, "--bus", self.endpoint, "--detach-nodes")
        self.first = Up(self.home, "--simulate", "--speed", str(speed), *common)
        self.second = Up(self.home, "--standby", *common)

    def start_bus(self) -> None:
        argv = [sys.executable, "-m", "labos", "bus", "--listen", self.endpoint, *self.bus_options]
        self.bus = subprocess.Popen(argv, stdin=subprocess.DEVNULL)

    def start(self, workcell: str) -> None:
        self.first.start(workcell)
        self.second.launch()
        until(lambda: "Standing by" in self.second.read_log(), "the second kernel stands by")

    def runs_ended(self, runs: list[str]) -> None:
        """Every run has reached its end, on the second kernel."""
        with self.second.client() as client:
            assert statuses(client, runs) == ["completed"] * len(runs), self.second.read_log()

    def nodes(self) -> dict[str, int]:
        with self.second.client() as client:
            return {m["name"]: m["process"]["pid"] for m in client.state(waits=False)["modules"]}

    def clean_up(self) -> None:
        if self.first.process is not None and self.first.process.poll() is None:
            self.first.process.send_signal(signal.SIGCONT)
        self.first.clean_up()
        self.second.clean_up()
        self.bus.kill()
        self.bus.wait()


@pytest.fixture
def workcell(tmp_path: Path) -> str:
    path = tmp_path / "rpl.yaml"
    path.write_text(CELL)
    return str(path)


@pytest.fixture
def workflow(tmp_path: Path) -> Path:
    path = tmp_path / "away.yaml"
    path.write_text(AWAY)
    return path


@pytest.fixture
def secure_pair(tmp_path: Path, postgres_url: str) -> Iterator[Pair]:
    made = Pair(tmp_path, postgres_url, 300.0, secure=True)
    yield made
    made.clean_up()


@pytest.fixture
def pair(tmp_path: Path, postgres_url: str) -> Iterator[Pair]:
    made = Pair(tmp_path, postgres_url, 300.0)
    yield made
    made.clean_up()


def await_requests(pair: Pair, actions: int) -> None:
    """Until so many actions were requested."""
    until(lambda: pair.first.types().count("action.requested") >= actions, "the lab is at work")


def measure_take_over(pair: Pair, since: float) -> float:
    """Seconds from ``since`` (wall time) until the second kernel's start was on disk."""

    def start_of_second() -> int:
        events = [
            (decode(r.head.type, r.head.schema, r.payload), r.head.recorded_at)
            for r in pair.first.records()
            if r.head.type == KernelStarted.TYPE
        ]
        return next((at for event, at in events if isinstance(event, KernelStarted) and event.epoch == 2), 0)

    try:
        return until(start_of_second, "the standby takes over", 30.0) / 1e9 - since
    except AssertionError as error:
        raise AssertionError(f"{error}\n{pair.second.read_log()}") from None


def sound(pair: Pair) -> None:
    """The bench and the log agree in everything, no action was asked for twice, nobody had to be asked."""
    assert pair.second.disagreements() == []
    types = pair.second.types()
    assert "intervention.requested" not in types
    assert "action.unknown" not in types
    told: set[tuple[str, int]] = set()
    epoch = 0
    for record in pair.second.records():
        event = decode(record.head.type, record.head.schema, record.payload)
        if isinstance(event, KernelStarted):
            epoch = event.epoch
        if isinstance(event, ActionRequested):
            assert (event.action, event.attempt) not in told
            assert event.epoch == epoch, "nothing is asked for in the name of a kernel that was replaced"
            told.add((event.action, event.attempt))
    assert epoch == 2
    verified = labos("verify", "--journals", "--home", str(pair.home))
    assert verified.returncode == 0, verified.stdout + verified.stderr


def test_a_standby_takes_the_place_of_a_kernel_that_is_killed(
    pair: Pair, workcell: str, workflow: Path
) -> None:
    pair.start(workcell)
    with pair.first.client() as client:
        runs = [client.submit(workflow, user=user) for user in ("ada", "bo")]
        await_requests(pair, 2)
        before = {m["name"]: m["process"]["pid"] for m in client.state(waits=False)["modules"]}
    killed = time.time()
    pair.first.kill()
    took = measure_take_over(pair, killed)
    assert took <= TAKEN_OVER_S
    until(pair.second.is_there, "the second kernel answers")
    pair.runs_ended(runs)
    assert pair.nodes() == before, "its nodes lived on, and are the same"
    assert pair.second.interrupt() == 0, pair.second.read_log()
    sound(pair)
    print(f"taken over {took:.2f} s after the kill")


@pytest.mark.timeout(240)
def test_a_standby_takes_over_on_a_secure_bus(secure_pair: Pair, workcell: str, workflow: Path) -> None:
    """It speaks with the certificate that the lab's kernel has."""
    secure_pair.start(workcell)
    with secure_pair.first.client() as client:
        runs = [client.submit(workflow, user=user) for user in ("ada", "bo")]
        await_requests(secure_pair, 2)
    secure_pair.first.kill()
    until(secure_pair.second.is_there, "the second kernel answers")
    secure_pair.runs_ended(runs)
    assert secure_pair.second.interrupt() == 0, secure_pair.second.read_log()
    sound(secure_pair)


@pytest.mark.full
def test_a_kernel_and_its_bus_die_together(pair: Pair, workcell: str, workflow: Path) -> None:
    """Whoever takes over waits for the bus: it has the lab then, and nobody else would take it back."""
    pair.start(workcell)
    with pair.first.client() as client:
        runs = [client.submit(workflow, user=user) for user in ("ada", "bo")]
        await_requests(pair, 2)
    pair.bus.kill()
    pair.first.kill()
    pair.bus.wait()
    until(lambda: "waiting_for_the_bus" in pair.second.read_log(), "the standby has taken over")
    pair.start_bus()
    until(pair.second.is_there, "the second kernel answers")
    pair.runs_ended(runs)
    assert pair.second.interrupt() == 0, pair.second.read_log()
    sound(pair)


def stays_frozen(pair: Pair, since: float, workflow: Path, runs: list[str]) -> float:
    """The frozen kernel is replaced; it wakes up later, in the midst of new work, and ends by itself."""
    took = measure_take_over(pair, since)
    assert took <= TAKEN_OVER_S
    until(pair.second.is_there, "the second kernel answers")
    with pair.second.client() as client:
        before = pair.nodes()
        until(lambda: time.time() - since >= FROZEN_S - 1, "the first one stays frozen for long")
        runs += [client.submit(workflow, user=user) for user in ("ada", "bo", "ada")]
        assert pair.first.process is not None
        pair.first.process.send_signal(signal.SIGCONT)
        assert pair.first.process.wait(60) == 1
    whole = (pair.home / "up.log").read_text()  # both write there: what it said may be far from the end
    assert re.search(r"Another kernel\b.* has taken over|obeys the kernel of epoch 2", whole)
    pair.runs_ended(runs)
    assert pair.nodes() == before, "whoever was replaced leaves the nodes alone"
    assert pair.second.is_there(), "the lab is still found where it is now"
    return took


def strike(pair: Pair, workcell: str, workflow: Path, by: str, crash: str) -> tuple[list[str], float]:
    """The first kernel is killed or frozen at a point; four runs, and when it was (wall time, s)."""
    mark = pair.home / "crashed"
    pair.first.environment = {
        "PYTHONPATH": str(SITE),
        "LABOS_CRASH_AT": crash,
        "LABOS_CRASH_MARK": str(mark),
        "LABOS_CRASH_BY": by,
    }
    # The set-up counts as visits of commits: none of it is to be in the way.
    pair.home.mkdir(parents=True)
    mark.touch()
    pair.start(workcell)
    with pair.first.client() as client:
        client.take_out("sciclops", "no step starts before its visits count", by="ada")
        runs = [client.submit(workflow, user=user, request=user) for user in ("ada", "bo", "cy", "di")]
        mark.unlink()
        client.put_back("sciclops", by="ada")
        until(mark.exists, "the point is reached")
        return runs, mark.stat().st_mtime


POINTS = ("before_commit", "in_commit", "in_pipeline", "in_copy", "after_commit", "before_send", "after_send")


@pytest.mark.full
@pytest.mark.timeout(240)
@pytest.mark.parametrize("visit", [5, 9])
@pytest.mark.parametrize("point", POINTS)
@pytest.mark.parametrize("by", ["SIGKILL", "SIGSTOP"])
def test_at_each_point_of_the_protocol(
    pair: Pair, workcell: str, workflow: Path, by: str, point: str, visit: int
) -> None:
    runs, since = strike(pair, workcell, workflow, by, f"kernel.{point}:{visit}")
    if by == "SIGSTOP":
        took = stays_frozen(pair, since, workflow, runs)
    else:
        took = measure_take_over(pair, since)
        assert took <= TAKEN_OVER_S
        until(pair.second.is_there, "the second kernel answers")
        pair.runs_ended(runs)
    assert pair.second.interrupt() == 0, pair.second.read_log()
    sound(pair)
    print(f"{by} at {point}:{visit}: taken over {took:.2f} s after")


@pytest.mark.full
@pytest.mark.parametrize("again", range(5))
@pytest.mark.parametrize("point", ["in_commit", "in_pipeline", "in_copy"])
def test_frozen_with_the_head_row_locked(
    pair: Pair, workcell: str, workflow: Path, point: str, again: int
) -> None:
    """It never wakes up again; whoever claims cannot wait for the row until its session is ended."""
    runs, since = strike(pair, workcell, workflow, "SIGSTOP", f"kernel.{point}:{again + 10}")
    took = measure_take_over(pair, since)
    assert took <= TAKEN_OVER_S
    until(pair.second.is_there, "the second kernel answers")
    pair.runs_ended(runs)
    pair.first.kill()
    assert pair.second.interrupt() == 0, pair.second.read_log()
    sound(pair)
    print(f"SIGSTOP at {point}:{again + 10}: taken over {took:.2f} s after")


@pytest.mark.full
@pytest.mark.timeout(240)
@pytest.mark.parametrize("away_s", [0.0, 8.0])
def test_a_database_that_was_away_costs_no_kernel(
    tmp_path: Path, own_postgres: Callable[[], PostgresServer], workcell: str, workflow: Path, away_s: float
) -> None:
    """The sessions of both are gone, and the lease may be over: the one that lives has it again before the
    other is sure."""
    server = own_postgres()
    pair = Pair(tmp_path, server.create_database("lab"), 300.0)
    try:
        pair.start(workcell)
        with pair.first.client() as client:
            runs = [client.submit(workflow, user=user) for user in ("ada", "bo")]
            await_requests(pair, 2)
            server.stop(immediate=True)
            time.sleep(away_s)
            server.start()
            assert statuses(client, runs) == ["completed"] * 2, pair.first.read_log()
            time.sleep(SETTLED_S)  # so long the standby looks again and again
            assert client.health()["epoch"] == 1
        assert pair.second.process is not None
        assert pair.second.process.poll() is None, "it still stands by"
        assert pair.first.interrupt() == 0, pair.first.read_log()
        time.sleep(2 * SURE_S)
        assert pair.second.process.poll() is None
        assert not pair.second.is_there(), "a lab that was closed in order stays closed"
    finally:
        pair.clean_up()

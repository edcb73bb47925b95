"""Processes that freeze (SIGSTOP) and come back, and a router that is out of reach for a while.

Afterwards the bench and the log agree in every plate, nothing happened twice, and the runs have ended.
"""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from itertools import pairwise
from pathlib import Path

import pytest

from labos.client import LabClient
from labos.core.ids import LabId
from labos.core.state import LabState
from labos.errors import LabosError
from labos.node.world import World
from labos.runtime.ledger import fold
from labos.services.truth import list_differences
from labos.settings import free_port
from labos.store import open_store
from tests.support.cable import Cable
from tests.support.cells import PCR
from tests.support.lab_process import Up, labos, statuses, until
from tests.support.postgres import PostgresServer
from tests.system.test_kills import KERNEL_POINTS, NODE_POINTS, Lab, submit_twice

CELL = """\
labos: 1
name: corner
modules:
  - {name: pf400, model: pf400}
  - {name: sealer, model: A4S_sealer}
stations:
  wc.a: {kind: nest}
  wc.b: {kind: nest}
stock:
  wc.a: {plate96: 1}
"""

STEP = "  - {{name: s{n}, module: pf400, action: transfer, args: {{source: {a}, target: {b}}}}}\n"
ROUND = ("wc.a", "wc.b", "sealer.default", "wc.a")
ROUNDS = 4
LONG_S = 30.0
"""Longer than the heartbeat is waited for, than the kernel's lease, and than the bus' own leases."""


class Corner(Up):
    """A lab whose nodes are started by hand, and reach the router over a cable. With ``own_bus`` the
    router is a process of its own."""

    def __init__(self, folder: Path, *options: str, own_bus: bool = False, speed: float = 200.0) -> None:
        port = free_port("127.0.0.1")
        super().__init__(
            folder / "lab", "--simulate", "--speed", f"{speed:g}", "--quiet", "--no-nodes", *options
        )
        self.router: subprocess.Popen[bytes] | None = None
        if own_bus:
            endpoint = f"tcp/127.0.0.1:{port}"
            self.options = (*self.options, "--bus", endpoint)
            self.router = subprocess.Popen(
                [sys.executable, "-m", "labos", "bus", "--listen", endpoint],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
            )
        else:
            self.options = (*self.options, "--bus-port", str(port))
        self.cable = Cable(port)
        self.nodes: dict[str, subprocess.Popen[bytes]] = {}
        (folder / "corner.yaml").write_text(CELL)
        steps, places = "", [*ROUND[:-1]] * ROUNDS + ["wc.a"]
        for number, (source, target) in enumerate(pairwise(places)):
            steps += STEP.format(n=number, a=source, b=target)
        self.moves = len(places) - 1
        self.workflow = folder / "round.yaml"
        self.workflow.write_text(f"labos: 1\nname: round\nworkcell: corner\nsteps:\n{steps}")

    def begin(self) -> None:
        self.start(str(self.workflow.with_name("corner.yaml")))
        for name in ("pf400", "sealer"):
            argv = [sys.executable, "-m", "labos", "node", "start", "--name", name, "--workcell", "corner"]
            argv += ["--simulate", "--home", str(self.home), "--connect", f"tcp/127.0.0.1:{self.cable.port}"]
            with (self.home / f"{name}.log").open("ab") as log:
                self.nodes[name] = subprocess.Popen(argv, stdout=log, stderr=log, stdin=subprocess.DEVNULL)

    def clean_up(self) -> None:
        for process in (*self.nodes.values(), self.process, self.router):
            if process is None:
                continue
            with contextlib.suppress(OSError):
                process.send_signal(signal.SIGCONT)
                process.kill()
            process.wait()
        self.cable.cut()

    def count_moved(self) -> int:
        """How many motions the log says have ended."""
        return self.types().count("labware.moved")

    def faults(self) -> list[str]:
        """Where bench and log differ, and what was carried too often or not at all."""
        state, records = LabState(), self.records()
        fold(state, records)
        world = World(str(self.home / "world" / "corner.db"))
        try:
            found = list_differences(world, state, records)
            grips = len(world.motions("grip"))
        finally:
            world.close()
        return found if grips == self.moves else [*found, f"{grips} grips for {self.moves} moves"]


@contextlib.contextmanager
def freeze(process: subprocess.Popen[bytes] | None) -> Iterator[None]:
    assert process is not None
    process.send_signal(signal.SIGSTOP)
    until(
        lambda: Path(f"/proc/{process.pid}/stat").read_text().rpartition(") ")[2][0] == "T", "it stands still"
    )
    try:
        yield
    finally:
        process.send_signal(signal.SIGCONT)


@pytest.fixture
def new_corner(tmp_path: Path) -> Iterator[Callable[..., Corner]]:
    labs: list[Corner] = []

    def make(*options: str, own_bus: bool = False) -> Corner:
        labs.append(Corner(tmp_path, *options, own_bus=own_bus))
        return labs[-1]

    yield make
    for lab in labs:
        lab.clean_up()


@pytest.fixture
def corner(new_corner: Callable[..., Corner]) -> Corner:
    return new_corner()


def outlive(lab: Corner, still_s: float) -> None:
    """A router out of reach, a frozen node and a frozen kernel, one after the other, under one run."""
    lab.begin()
    with LabClient(home=lab.home) as client:
        run = client.submit(lab.workflow, user="ada")
        until(lambda: lab.count_moved() >= 1, "the run is on its way")
        lab.cable.cut()
        time.sleep(still_s)
        lab.cable.mend()
        until(lambda: lab.count_moved() >= 4, "it goes on when the router is back")
        with freeze(lab.nodes["pf400"]):
            time.sleep(still_s)
        until(lambda: lab.count_moved() >= 7, "it goes on with its node")
        with freeze(lab.process):
            time.sleep(still_s)
        assert statuses(client, [run]) == ["completed"]
    assert lab.interrupt() == 0, lab.read_log()
    assert lab.faults() == []
    assert "action.unknown" not in lab.types()
    assert "module.taken_out" not in lab.types()


def test_what_stands_still_for_a_moment_costs_that_moment(corner: Corner) -> None:
    outlive(corner, 1.0)


@pytest.mark.full
@pytest.mark.timeout(300)
def test_what_stands_still_for_half_a_minute_costs_that_and_no_more(corner: Corner) -> None:
    outlive(corner, LONG_S)


def check_ended_well(lab: Corner, client: LabClient, run: str) -> None:
    assert statuses(client, [run]) == ["completed"]
    assert lab.interrupt() == 0, lab.read_log()
    assert lab.faults() == []
    assert "action.unknown" not in lab.types()
    assert "module.taken_out" not in lab.types()


def arm(client: LabClient) -> str:
    """What the lab says of the arm's node."""
    modules = client.state()["modules"]
    return str(next(m["status"] for m in modules if m["name"].endswith("pf400")))


@pytest.mark.full
@pytest.mark.timeout(300)
def test_a_router_that_freezes_costs_that_time(new_corner: Callable[..., Corner]) -> None:
    """Nobody is reset and nobody refused, as when a cable is cut: whatever is sent is just not carried."""
    lab = new_corner(own_bus=True)
    lab.begin()
    with LabClient(home=lab.home) as client:
        run = client.submit(lab.workflow, user="ada")
        until(lambda: lab.count_moved() >= 1, "the run is on its way")
        with freeze(lab.router):
            until(lambda: arm(client) == "GONE", "the arm's node is missed")
            standing = lab.count_moved()
            time.sleep(LONG_S)
            assert arm(client) == "GONE"
            assert lab.count_moved() == standing
        until(lambda: arm(client) != "GONE", "the node is back")
        check_ended_well(lab, client, run)


@pytest.mark.full
@pytest.mark.postgres
@pytest.mark.timeout(300)
def test_a_node_that_freezes_under_a_lab_on_postgres(
    new_corner: Callable[..., Corner], postgres_url: str
) -> None:
    lab = new_corner("--database", postgres_url)
    lab.begin()
    with LabClient(home=lab.home) as client:
        run = client.submit(lab.workflow, user="ada")
        until(lambda: lab.count_moved() >= 1, "the run is on its way")
        with freeze(lab.nodes["pf400"]):
            time.sleep(LONG_S)
        until(lambda: lab.count_moved() >= 4, "it goes on with its node")
        check_ended_well(lab, client, run)


def test_a_kernel_that_stood_still_does_not_blame_its_database(new_corner: Callable[..., Corner]) -> None:
    lab = new_corner("--on-database-loss", "stop", "--database-silence", "1")
    lab.begin()
    with LabClient(home=lab.home) as client:
        run = client.submit(lab.workflow, user="ada")
        until(lambda: lab.count_moved() >= 1, "the run is on its way")
        with freeze(lab.process):
            time.sleep(2.5)
        check_ended_well(lab, client, run)


def thaw(mark: Path) -> None:
    """Wait for a process to freeze, and let it go on after half a minute."""
    pid = until(lambda: mark.exists() and mark.read_text(), "something freezes")
    time.sleep(LONG_S)
    os.kill(int(pid), signal.SIGCONT)


POINTS = [f"kernel.{point}:{11 if 'commit' in point else 4}" for point in KERNEL_POINTS] + [
    f"node.{point}:2" for point in NODE_POINTS if not point.startswith("torn")
]


@pytest.mark.full
@pytest.mark.timeout(300)
@pytest.mark.parametrize("point", POINTS)
def test_frozen_at_every_point(tmp_path: Path, point: str) -> None:
    """SIGSTOP for half a minute just there, under two PCRs."""
    lab = Lab(tmp_path / "lab", f"sqlite:///{tmp_path}/labos.db", point)
    lab.environment["LABOS_CRASH_BY"] = "SIGSTOP"
    lab.start()
    try:
        thawing = threading.Thread(target=thaw, args=(lab.mark,), daemon=True)
        thawing.start()
        state, records = lab.see_out(submit_twice(lab))
        assert not thawing.is_alive(), f"{point} was never reached"
        assert lab.questions == []
        assert lab.kills == 0
        world = World(str(lab.home / "world" / "rpl.db"))
        try:
            assert list_differences(world, state, records) == []
        finally:
            world.close()
        ended = [r.head.type for r in records if r.head.type in ("run.completed", "run.failed")]
        assert ended == ["run.completed"] * 2
        assert lab.stop() == 0
    finally:
        if lab.process is not None and lab.process.poll() is None:
            lab.process.kill()
            lab.process.wait()


@pytest.mark.full
@pytest.mark.postgres
@pytest.mark.timeout(300)
def test_a_kernel_frozen_longer_than_its_lease_goes_on_alone(tmp_path: Path, postgres_url: str) -> None:
    """Nobody else has taken the lab meanwhile: its lease has run out, and it may take it again."""
    lab = Up(tmp_path / "lab", "--simulate", "--speed", "800", "--quiet", "--database", postgres_url)
    try:
        lab.start_with(*PCR, "hidex")
        with lab.client() as client:
            runs = [client.submit("pcr", user=user) for user in ("ada", "bo")]
            until(lambda: lab.types().count("labware.moved") >= 2, "the runs are on their way")
            with freeze(lab.process):
                time.sleep(LONG_S)
            assert statuses(client, runs) == ["completed", "completed"]
        assert lab.interrupt() == 0, lab.read_log()
        assert lab.disagreements() == []
    finally:
        lab.clean_up()


def find_refusal(lab: Up) -> str:
    """What a caller hears; empty if the command was taken."""
    try:
        with LabClient(home=lab.home, patience_s=0.5) as client:
            client.take_out("hidex", "nobody can note this", "ada")
            client.put_back("hidex", "ada")
    except LabosError as error:
        return str(error)
    return ""


def start_two_runs(lab: Up, url: str, *options: str) -> list[str]:
    """A lab on this database with two PCRs on their way; returns these."""
    lab.options = ("--simulate", "--speed", "800", "--quiet", "--database", url, *options)
    lab.start_with(*PCR, "hidex")
    with lab.client() as client:
        runs = [client.submit("pcr", user=user) for user in ("ada", "bo")]
    until(lambda: lab.types().count("action.succeeded") >= 3, "the runs are on their way")
    return runs


def check_agreed(lab: Up) -> None:
    """Bench and log agree, and no node did what the log does not know."""
    assert lab.disagreements() == []
    told = labos("verify", "--journals", "--home", str(lab.home))
    assert "contain nothing that the log lacks" in told.stdout, told.stdout + told.stderr


@pytest.fixture
def up(tmp_path: Path) -> Iterator[Up]:
    lab = Up(tmp_path / "lab")
    yield lab
    lab.clean_up()


@pytest.fixture
def server(own_postgres: Callable[[], PostgresServer]) -> PostgresServer:
    return own_postgres()


def unread_at(port: int) -> bool:
    """Whether somebody has sent what the server at a port of this machine does not read."""
    rows = [line.split() for line in Path("/proc/net/tcp").read_text().splitlines()[1:]]
    return any(row[1].endswith(f":{port:04X}") and int(row[4].partition(":")[2], 16) for row in rows)


SILENT_S = 3.0


@pytest.mark.full
@pytest.mark.postgres
@pytest.mark.timeout(300)
@pytest.mark.parametrize("then", ["wait", "stop", "SIGTERM"])
def test_a_database_that_freezes_counts_as_lost(up: Up, server: PostgresServer, then: str) -> None:
    """Its system goes on acknowledging what is sent: no connection ever breaks by itself."""
    url = server.create_database("lab")
    loss = "stop" if then == "stop" else "wait"
    runs = start_two_runs(up, url, "--on-database-loss", loss, "--database-silence", f"{SILENT_S:g}")
    process = up.process
    assert process is not None
    server.freeze()
    if then == "SIGTERM":
        process.terminate()
    else:
        assert find_refusal(up)
    until(lambda: "has not answered for 3 s" in up.read_log(), "the kernel says so")
    if then == "wait":
        time.sleep(2 * SILENT_S)
        assert process.poll() is None
        assert "cannot write its log" in find_refusal(up)
        server.thaw()
    else:
        assert process.wait(60) == 1
        assert "Its log is intact" not in up.read_log()
        server.thaw()
        up.start()
    until(lambda: not find_refusal(up), "the lab takes commands again")
    with up.client() as client:
        assert statuses(client, runs) == ["completed", "completed"]
    assert up.interrupt() == 0, up.read_log()
    check_agreed(up)


@pytest.mark.full
@pytest.mark.postgres
@pytest.mark.timeout(300)
def test_a_commit_whose_answer_never_comes_is_found_and_not_repeated(up: Up, server: PostgresServer) -> None:
    """The network swallows what the server says, of one connection after another: each batch is on disk,
    and the kernel cannot know."""
    line = Cable(server.port)
    url = server.create_database("lab").replace(f":{server.port}/", f":{line.port}/")
    try:
        runs = start_two_runs(up, url, "--on-database-loss", "wait", "--database-silence", f"{SILENT_S:g}")
        for times in range(1, 4):
            line.deaf.clear()
            line.deaf_after = b"COMMIT"
            assert line.deaf.wait(60), "no commit came by"
            line.deaf_after = b""
            until(
                lambda n=times: (up.home / "up.log").read_text().count("commit_failed") >= n,
                "the kernel says so",
            )
            until(lambda: not find_refusal(up), "the lab takes commands again")
        with up.client() as client:
            assert statuses(client, runs) == ["completed", "completed"]
        assert up.interrupt() == 0, up.read_log()
        check_agreed(up)
    finally:
        line.cut()


@pytest.mark.postgres
def test_a_standby_can_be_ended_although_the_database_is_frozen(up: Up, server: PostgresServer) -> None:
    url = server.create_database("lab")
    store = open_store(url)
    store.claim(LabId("lab"), "a kernel that lives", 600.0)
    up.environment = {"PYTHONUNBUFFERED": "1"}
    up.options = ("--simulate", "--standby", "--no-nodes", "--bus", "tcp/127.0.0.1:7447", "--database", url)
    up.launch()
    process = up.process
    assert process is not None
    until(lambda: "Standing by" in up.read_log(), "it stands by")
    server.freeze()
    until(lambda: unread_at(server.port), "it asks a server that does not answer")
    process.terminate()
    assert process.wait(60) == 0, up.read_log()
    assert "The standby has ended." in up.read_log()
    server.thaw()
    store.close()

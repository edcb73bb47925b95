"""A lab over seven hosts: database, kernel, standby, bus, two nodes, API process; the bus is a secure one.

The bench is the same for all of them, as a bench is: its record of motions is a file that the simulated
devices of both nodes' hosts write, and that nothing else knows.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import threading
from contextlib import suppress
from pathlib import Path

from labos.client import LabClient
from labos.core.actions import ActionRequested
from labos.core.envelope import Record
from labos.core.lab import KernelStarted
from labos.core.registry import decode
from labos.core.state import LabState
from labos.errors import LabosError
from labos.node.world import Motion, World
from labos.runtime.ledger import fold
from labos.services.truth import list_differences
from labos.store import open_store
from tests.support.hosts import Host, Hosts
from tests.support.lab_process import until
from tests.support.postgres import PostgresServer

HOSTS = ("db", "k1", "k2", "r", "n1", "n2", "a1")
NODES = {"n1": "pf400", "n2": "sciclops"}

CELL = """
labos: 1
name: rpl
modules:
  - {name: sciclops, model: sciclops}
  - {name: pf400, model: pf400}
stations:
  wc.trash: {kind: waste, capacity: 500}
  wc.parking: {kind: hotel, capacity: 8}
stock:
  sciclops.tower1: {plate96: 20}
  sciclops.tower2: {plate96: 20}
  sciclops.tower3: {plate96: 20}
"""

AWAY = """
labos: 1
name: away
steps:
  - {name: Get, module: sciclops, action: get_plate, args: {loc: TOWER}}
  - {name: Park, module: pf400, action: transfer, args: {source: sciclops.exchange, target: wc.parking}}
  - {name: Discard, module: pf400, action: transfer, args: {source: wc.parking, target: wc.trash}}
"""

MOTIONS = {"grip": 3, "release": 2, "discard": 1}
"""What the devices do in a run: they grip a plate three times, and let go of it three times."""


class DatabaseOn(PostgresServer):
    """A database server on a host, which listens there; from outside it is reached by its socket, whatever is
    cut off."""

    def __init__(self, host: Host, superuser: str = "labos") -> None:
        super().__init__()
        self._host, self.port, self._superuser = host, 5432, superuser

    @property
    def url_there(self) -> str:
        return f"postgresql://labos@{self._host.address}/lab"

    @property
    def url_here(self) -> str:
        return f"postgresql://labos@/lab?host={self.folder}"

    def open(self) -> None:
        self.folder = Path(self._host.folder / "pg")
        self.folder.mkdir()
        shutil.chown(self.folder, "postgres", "postgres")
        self._run("initdb", "-D", self._data, "-A", "trust", "-U", self._superuser, "-E", "UTF8", "--no-sync")
        self.start()

    def make_lab(self) -> None:
        """A database for a lab, which any host may use without a password."""
        with Path(self._data, "pg_hba.conf").open("a") as rules:
            rules.write("host all all 10.77.0.0/24 trust\n")
        self.restart()
        self._run("createdb", "-h", str(self.folder), "-U", self._superuser, "lab")

    def start(self) -> None:
        options = f"-p {self.port} -k {self.folder} -h 0.0.0.0"
        log = str(self.folder) + "/log"
        self._run("pg_ctl", "-w", "-t", "60", "-D", self._data, "-l", log, "-o", options, "start")

    def _run(self, program: str, *arguments: str) -> None:
        words = ("setpriv", "--reuid=postgres", "--regid=postgres", "--clear-groups")
        done = subprocess.run(
            # Not the host's own way of starting: that would take the server along when `pg_ctl` ends.
            [
                *("nsenter", "-t", str(self._host.first), "-n", "-u", "-p", "-m", "--wd=/", "--"),
                *(*words, str(self.binaries / program), *arguments),
            ],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            check=False,
        )
        if done.returncode:
            raise RuntimeError(f"{program} failed on {self._host.name}: {self._host.read_log('pg/log')}")


class Spread:
    """The lab. ``open`` starts all of it."""

    def __init__(self, hosts: Hosts, speed: float) -> None:
        self.hosts, self.speed = hosts, speed
        self.bench = hosts.folder / "bench"
        self.bench.mkdir(mode=0o700)
        self.database = DatabaseOn(hosts["db"])
        self.bus = f"tls/{hosts['r'].address}:7447"
        self.running: dict[str, subprocess.Popen[bytes]] = {}
        self.runs: list[str] = []
        self.restarted: list[str] = []
        self._told: dict[str, tuple[str, ...]] = {}
        self._closing = threading.Event()
        self._manager = threading.Thread(target=self._keep_running, daemon=True)
        self._workflows = [self._workflow(number) for number in (1, 2, 3)]

    def open(self) -> None:
        k1, r = self.hosts["k1"], self.hosts["r"]
        for host in self.hosts:
            (host.folder / "lab").mkdir(mode=0o700)
            (host.folder / "lab" / "world").symlink_to(self.bench)
        cell = k1.folder / "rpl.yaml"
        cell.write_text(CELL)
        self.database.open()
        self.database.make_lab()
        self._labos(k1, "pki", "init", "--home", str(k1.folder / "lab"))
        self._issue("r", "bus", "bus", "--address", r.address)
        self.start("r", "bus", "--listen", self.bus, "--cert", "bus")
        until(lambda: "The bus runs" in r.read_log(), "the bus runs")
        self.start("k1", "up", str(cell), *self.simulating, "--or-standby")
        until(lambda: "kernel" in self._members(), "the kernel has a certificate")
        self._carry_members()
        until(lambda: "The lab " in k1.read_log(), "the kernel runs")
        own = next((k1.folder / "lab" / "pki" / "issued").glob("*/kernel"), None)
        assert own is not None, sorted((k1.folder / "lab" / "pki" / "issued").rglob("*"))
        shutil.copytree(own, self.hosts["k2"].folder / "kernel")
        for name, module in NODES.items():
            self._issue(name, "node", "node", f"rpl/{module}")
        self._issue("a1", "api", "api", "web")
        self._carry_members()
        self.start("k2", "up", *self.simulating, "--or-standby", "--cert", "kernel")
        for name in NODES:
            self.start_node(name)
        self.start("a1", "api", "--process", "web", "--cert", "api", "--http-port", "8721")
        until(lambda: "Standing by" in self.hosts["k2"].read_log(), "the standby stands by")
        until(lambda: "serves the lab" in self.hosts["a1"].read_log(), "the API process serves")
        self._manager.start()

    @property
    def simulating(self) -> tuple[str, ...]:
        return ("--simulate", "--speed", str(self.speed))

    def close(self) -> None:
        """Nothing is started again from now on."""
        self._closing.set()
        self._manager.join()

    def _keep_running(self) -> None:
        """What has ended is started again after 2 s, as systemd does by the units in deploy/."""
        while not self._closing.wait(2.0):
            for name, process in list(self.running.items()):
                if process.poll() is not None:
                    self.restarted.append(name)
                    self.start(name, *self._told[name])

    def start(self, name: str, *words: str) -> None:
        """Start a part of LabOS on its host."""
        host = self.hosts[name]
        self._told[name] = words
        more = ["--home", str(host.folder / "lab")]
        environment = {
            "LABOS_DATABASE_URL": self.database.url_there,
            "PYTHONPATH": str(Path(__file__).parents[2]),
        }
        if words[0] == "up":
            more += ["--bus", self.bus, "--no-nodes", "--secure", "--quiet"]
        elif words[0] == "api":
            more += ["--bus", self.bus]
        self.running[name] = host.start(sys.executable, "-m", "labos", *words, *more, environment=environment)

    def start_node(self, name: str) -> None:
        words = ("node", "start", "--simulate", "--workcell", "rpl", "--name", NODES[name])
        self.start(name, *words, "--connect", self.bus, "--cert", "node")

    def _labos(self, host: Host, *words: str) -> str:
        environment = {"LABOS_DATABASE_URL": self.database.url_there}
        done = host.run(sys.executable, "-m", "labos", *words, env={**os.environ, **environment})
        return done.stdout.strip()

    def _issue(self, to: str, place: str, *words: str) -> None:
        k1 = self.hosts["k1"]
        made = self._labos(k1, "pki", "issue", *words, "--home", str(k1.folder / "lab"))
        shutil.copytree(made, self.hosts[to].folder / place)

    def _members(self) -> str:
        path = self.hosts["k1"].folder / "lab" / "pki" / "members.json"
        return path.read_text() if path.exists() else ""

    def _carry_members(self) -> None:
        place = self.hosts["r"].folder / "bus"
        shutil.copy(self.hosts["k1"].folder / "lab" / "pki" / "members.json", place)

    # -- work ------------------------------------------------------------------------------

    def client(self, patience_s: float = 90.0) -> LabClient:
        """Whoever uses the lab, on the host of the API process."""
        return LabClient("http://127.0.0.1:8721", patience_s=patience_s)

    def submit(self, number: int) -> None:
        """So many runs more; each is asked for under a key, until the lab says that it has it."""

        def ask() -> None:
            with self.client() as client:
                for _ in range(number):
                    count = len(self.runs)
                    workflow = self._workflows[count % len(self._workflows)]
                    self.runs.append(client.submit(workflow, user="ada", request=f"run-{count}"))

        self.hosts["a1"].inside(ask)

    def list_answering(self) -> set[str]:
        """The modules whose nodes answer the kernel, as a user is told on the host of the API process; none
        while the API process or the kernel does not answer."""

        def ask() -> set[str]:
            try:
                with self.client(1.0) as client:
                    found = client.check_nodes([])
            except LabosError:
                return set()
            return {str(one["module"]) for one in found if one["answer"] in ("IDLE", "BUSY")}

        return self.hosts["a1"].inside(ask)

    def count_done(self) -> int:
        """How many runs have ended, as the database has it."""
        return self.types().count("run.completed")

    def finish(self, patience_s: float = 90.0) -> None:
        """Wait until all runs have ended."""
        try:
            until(lambda: self.count_done() >= len(self.runs), "all runs end", patience_s)
        except AssertionError as error:
            raise AssertionError(f"{error}\n{self.describe_all()}") from None

    def describe_all(self) -> str:
        """What everybody said at last, and how the log ends."""
        said = [f"--- {host.name}\n{host.read_log()[-1500:]}" for host in self.hosts]
        tail = []
        with suppress(LabosError):  # there is no log yet
            tail = [f"{r.head.position} {r.head.type} {r.payload[:200]!r}" for r in self.records()[-30:]]
        return "\n".join([*said, *tail])

    def _workflow(self, number: int) -> Path:
        path = self.hosts.folder / f"away{number}.yaml"
        path.write_text(AWAY.replace("TOWER", f"tower{number}"))
        return path

    # -- what is true ------------------------------------------------------------------------

    def records(self) -> list[Record]:
        store = open_store(self.database.url_here, create=False, read_only=True)
        try:
            return list(store.read())
        finally:
            store.close()

    def types(self) -> list[str]:
        return [record.head.type for record in self.records()]

    def epochs(self) -> list[tuple[int, float]]:
        """The kernels of the log: epoch and start (wall time, s)."""
        found = []
        for record in self.records():
            if record.head.type == KernelStarted.TYPE:
                event = decode(record.head.type, record.head.schema, record.payload)
                assert isinstance(event, KernelStarted)
                found.append((event.epoch, record.head.recorded_at / 1e9))
        return found

    def motions(self) -> list[Motion]:
        """What the simulated devices did, by their own account."""
        world = World(str(self.bench / "rpl.db"))
        try:
            return [motion for verb in MOTIONS for motion in world.motions(verb)]
        finally:
            world.close()

    def disagreements(self) -> list[str]:
        state, records = LabState(), self.records()
        fold(state, records)
        world = World(str(self.bench / "rpl.db"))
        try:
            return list_differences(world, state, records)
        finally:
            world.close()

    def has_standby(self) -> list[str]:
        """Who stands by, as the database has it."""
        store = open_store(self.database.url_here, create=False, read_only=True)
        try:
            return store.standbys()
        finally:
            store.close()

    def active(self) -> str:
        """The host of the kernel, as the database has it."""
        store = open_store(self.database.url_here, create=False, read_only=True)
        try:
            return store.find_holder().owner.rpartition(" ")[2]
        finally:
            store.close()

    def find_asked_twice(self) -> list[str]:
        """Attempts that were asked for more than once in the log."""
        told: set[tuple[str, int]] = set()
        twice: list[str] = []
        for record in self.records():
            event = decode(record.head.type, record.head.schema, record.payload)
            if isinstance(event, ActionRequested):
                if (event.action, event.attempt) in told:
                    twice.append(event.action)
                told.add((event.action, event.attempt))
        return twice

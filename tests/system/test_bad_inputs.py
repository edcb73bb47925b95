"""Every bad input, one by one: one clear error, nothing half-done; and waits that say so.

A refusal is one line on standard error that names the place or the thing and the remedy, exit
code 1, no traceback, the log's head and the home's files as they were. What is no fault of the
input but of the bench is a wait: `labos explain` and `labos runs` name the thing and the remedy,
and the run goes on when it is mended.

| bad input | shown by |
| --- | --- |
| broken YAML; unknown module, action, argument, station | ``test_a_bad_workflow…`` |
| wrong type, wrong unit, a value out of range | ``test_a_bad_workflow…`` |
| a station that the arm was never taught (unreachable) | ``test_a_bad_workflow…`` |
| a payload key missing, among others and from an empty payload | ``test_a_bad_workflow…`` |
| a payload key that nothing takes, by CLI, HTTP and client | ``test_a_key_that_nothing_takes…`` |
| a cycle in ``after`` | ``test_a_bad_workflow…`` |
| the same faults, with `labos run` before there is a lab | ``test_commands.py`` |
| every fault of a file, with its column | ``tests/unit/spec/test_spec_workflow.py``, ``…_workcell.py`` |
| two nodes that claim one name | ``test_two_nodes_of_one_name`` |
| a labware type that nobody knows, or that the station does not accept | ``test_labware_of…`` |
| one idempotency key for two things | ``test_one_key_for_two_things`` |
| a run that is cancelled while something is in flight | ``test_cancelling_says_what_is_true`` |
| a node gone before its step | ``test_a_node_that_is_gone_is_waited_for`` |
| an occupied start station | ``test_an_occupied_station_is_waited_for`` |
| an empty stack | ``test_an_empty_stack_is_told_at_once_and_waited_for`` |
| a full output hotel | ``test_a_full_hotel_is_waited_for`` |
| a database of a newer version | ``test_a_database_of_a_newer_version``; ``store/test_migrate.py`` |
| a database or folder that may not be written, a full disk | ``TestBadDisk``; ``store/test_crash.py`` |
| a disk that fills while the log grows | ``tests/integration/store/test_crash.py`` |
| a port in use | ``test_a_port_in_use``; ``test_up.py`` |
| a Postgres that is not there | ``test_a_postgres_that_is_not_there``; ``store/test_migrate.py`` |
| a kernel that was killed just now | ``test_right_after_a_kill_nobody_is_refused`` |
"""

from __future__ import annotations

import json
import shutil
import signal
import socket
import sqlite3
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import closing, suppress
from pathlib import Path

import httpx
import pytest

from labos.errors import BadInput
from labos.settings import find_kernel
from labos.store import find_lease_holder
from tests.support.lab_process import Up, labos, until
from tests.support.postgres import free_port

CELL = """\
labos: 1
name: small
modules:
  - {name: sealer, model: A4S_sealer}
  - {name: pf400, model: pf400}
  - {name: sciclops, model: sciclops}
  - {name: camera_module, model: camera (logitech)}
stations:
  wc.trash: {kind: waste, capacity: 50}
  wc.output: {kind: hotel, capacity: 1, accepts: [plate96]}
locations:
  pf400:
    sciclops.exchange: [222.0, -38.068, 335.876, 325.434, 79.923, 995.062]
    sealer.default: [205.128, -2.814, 264.373, 365.863, 79.144, 411.553]
    wc.trash: [218.457, -2.408, 38.829, 683.518, 89.109, 995.074]
    wc.output: [172.9, -20.337, 262.450, 371.905, 80.523, 640.210]
  sciclops:
    sciclops.exchange: [0, 0, 0, 0]
stock:
  sciclops.tower1: {plate96: 10}
"""


def workflow(*steps: str) -> str:
    """A workflow file; its steps begin in line 4."""
    return "labos: 1\nname: w\nsteps:\n" + "".join(f"  - {{{step}}}\n" for step in steps)


def seal(args: str) -> str:
    return f"name: seal, module: sealer, action: seal, args: {{{args}}}"


def move(source: str, target: str, name: str = "go", more: str = "") -> str:
    where = f"source: {source}, target: {target}"
    return f"name: {name}, module: pf400, action: transfer, args: {{{where}}}{more}"


def get(stack: str) -> str:
    return f"name: get, module: sciclops, action: get_plate, args: {{loc: {stack}}}"


BAD: dict[str, tuple[str, tuple[str, ...], str, str, str]] = {
    # what: (file, payload, line:column, what is wrong, remedy)
    "broken YAML": ("steps: [", (), "1:9", "This is not YAML", "Check indentation"),
    "unknown module": (
        workflow("name: s, module: sealor, action: seal"),
        *((), "4:23", "no module 'sealor' in 'small'", "Did you mean 'sealer'?"),
    ),
    "unknown action": (
        workflow("name: s, module: sealer, action: sael"),
        *((), "4:39", "sealer has no action 'sael'", "Did you mean 'seal'?"),
    ),
    "unknown argument": (workflow(seal("tiem: 3")), (), "4:55", "no argument 'tiem'", "Did you mean 'time'?"),
    "unknown station": (
        workflow(move("sealer.defalt", "wc.trash")),
        *((), "4:64", "no station 'sealer.defalt'", "Did you mean 'sealer.default'?"),
    ),
    "wrong type": (
        workflow(seal("time: soon")),
        (),
        "4:61",
        "must be a number, not 'soon'",
        "Write a number",
    ),
    "wrong unit": (workflow(seal("time: 20 µL")), (), "4:61", "is in s, not in 'µL'", "Write a number from"),
    "out of range": (workflow(seal("time: 1 h")), (), "4:61", "3600 s, more than", "Write a number from"),
    "unreachable": (
        workflow(move("sealer", "camera_module")),
        *(
            (),
            "4:5",
            "pf400 was never taught camera_module.plate_station",
            "Add it under `locations:",
        ),
    ),
    "missing key": (
        workflow(seal("time: payload.seconds")),
        *(
            ("-p", "minutes=3"),
            "4:61",
            "has no 'seconds'",
            "Give the payload 'seconds': --payload sec",
        ),
    ),
    "misspelt key": (
        workflow(seal("time: payload.seconds")),
        *(("-p", "second=3"), "4:61", "has no 'seconds'", "Did you mean 'second'? Give the payload"),
    ),
    "empty payload": (
        workflow(seal("time: payload.seal.time")),
        *(
            (),
            "4:61",
            "has no 'seal.time'",
            "--payload seal.time=VALUE, or all in a file",
        ),
    ),
    "cycle": (
        workflow(
            move("sealer", "wc.output", "a", ", after: [b]"), move("wc.output", "sealer", "b", ", after: [a]")
        ),
        *((), "4:", "'a' waits for itself, through other steps", "Break the circle of `after:`"),
    ),
}


class Lab:
    """One small lab for all that is asked of it; its nodes are started by hand."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.cell = folder / "cell.yaml"
        self.cell.write_text(CELL)
        self.up = Up(folder / "lab", "--simulate", "--speed", "1000", "--no-nodes")
        self.home = ("--home", str(self.up.home))
        self.nodes: dict[str, subprocess.Popen[bytes]] = {}

    def head(self) -> int:
        with self.up.client() as client:
            return int(client.health()["position"])

    def file(self, text: str) -> str:
        path = self.folder / "wf.yaml"
        path.write_text(text)
        return str(path)

    def submit(self, *steps: str) -> str:
        done = labos("submit", self.file(workflow(*steps)), "--user", "ada", *self.home)
        assert done.returncode == 0, done.stderr
        return done.stdout.strip()

    def node(self, name: str) -> None:
        argv = [sys.executable, "-m", "labos", "node", "start", "--name", name, "--workcell", "small"]
        argv += ["--simulate", *self.home]
        self.nodes[name] = subprocess.Popen(argv, stdin=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        until(lambda: self.status(name) == "IDLE", f"{name} is there")

    def stop(self, name: str) -> None:
        node = self.nodes.pop(name)
        node.terminate()
        node.wait(20)
        until(lambda: self.status(name) == "GONE", f"{name} is gone")

    def status(self, name: str) -> str:
        with self.up.client() as client:
            modules = {m["name"]: m["status"] for m in client.state(waits=False)["modules"]}
        return str(modules[f"small/{name}"])

    def expect_wait(self, run: str, why: str, remedy: str) -> None:
        """Both commands name the thing, one the remedy too."""
        told = labos("explain", run, *self.home).stdout
        assert why in told, told
        assert remedy in told, told
        runs = {line.split()[0]: line for line in labos("runs", *self.home).stdout.splitlines()}
        assert f"waits: {why}" in runs[run]

    def expect_done(self, *runs: str) -> None:
        with self.up.client() as client:
            assert [client.wait(run, timeout_s=30).status for run in runs] == ["completed"] * len(runs)

    def close(self) -> None:
        for node in self.nodes.values():
            node.kill()
            node.wait()
        self.up.clean_up()


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Lab]:
    """It has no nodes: only what a test does is written to its log."""
    lab = Lab(tmp_path_factory.mktemp("bad"))
    try:
        lab.up.start(str(lab.cell))
        yield lab
    finally:
        lab.close()


@pytest.fixture(scope="module")
def working(lab: Lab) -> Lab:
    """The same with nodes."""
    for name in ("sciclops", "pf400", "sealer"):
        lab.node(name)
    return lab


def check_refused(done: subprocess.CompletedProcess[str], *words: str) -> None:
    """One line that says it all."""
    assert done.returncode == 1, done
    lines = done.stderr.strip().splitlines()
    assert len(lines) == 1, done.stderr
    assert lines[0].startswith("labos: ")
    for word in words:
        assert word in lines[0]
    assert not done.stdout


def files_of(folder: Path) -> set[str]:
    return {str(path.relative_to(folder)) for path in folder.rglob("*")}


# -- refused at once -------------------------------------------------------------------------------


@pytest.mark.parametrize("what", BAD)
def test_a_bad_workflow_is_refused_in_one_line(lab: Lab, what: str) -> None:
    text, payload, place, wrong, remedy = BAD[what]
    file, before, there = lab.file(text), lab.head(), files_of(lab.up.home)
    check_refused(labos("submit", file, *payload, *lab.home), f"labos: {file}:{place}", wrong, remedy)
    assert lab.head() == before
    assert files_of(lab.up.home) == there


def test_a_key_that_nothing_takes_is_refused_whoever_sends_it(lab: Lab) -> None:
    text = workflow(seal("time: payload.seal.time")).replace(
        "steps:", "parameters: {seal.time: {default: 3}}\nsteps:"
    )
    file, before = lab.file(text), lab.head()
    told = ("payload.seal.tim: The workflow does not use 'seal.tim'", "Did you mean 'seal.time'?")
    check_refused(labos("submit", file, "-p", "seal.tim=3", *lab.home), f"labos: {file}: ", *told)
    check_refused(
        labos("submit", file, "-p", "seal=3", *lab.home),
        "does not use 'seal' of the payload",
        "Did you mean 'seal.time'?",
    )
    with lab.up.client() as client:
        with pytest.raises(BadInput, match=told[0]):
            client.submit(file, {"seal": {"tim": 3}}, user="ada")
        with pytest.raises(BadInput, match=told[0]):
            client.start_experiment("e", "ada", closing=file, payload={"seal": {"tim": 3}})
        url = client._find_base()
    body = {"workflow": {"text": text}, "user": "ada", "payload": {"seal": {"tim": 3}}}
    answer = httpx.post(f"{url}/api/v1/runs", json=body)
    assert answer.status_code == 422
    (detail,) = answer.json()["details"]
    assert (detail["field"], detail["remedy"]) == ("payload.seal.tim", told[1])
    assert lab.head() == before


def test_labware_of_an_unknown_or_unwanted_type_is_not_placed(lab: Lab) -> None:
    before = lab.head()
    unknown = labos("place", "sealer.default", "plate69", *lab.home)
    check_refused(
        unknown, "no labware type 'plate69'", "Did you mean 'plate96'?", "Known: lid96, pcr96, plate96."
    )
    unwanted = labos("place", "wc.output", "pcr96", *lab.home)
    check_refused(unwanted, "wc.output does not accept pcr96; it accepts plate96.")
    nowhere = labos("place", "sealer.defalt", "plate96", *lab.home)
    check_refused(nowhere, "no station 'sealer.defalt'", "Did you mean 'sealer.default'?")
    assert lab.head() == before


def test_one_key_for_two_things(lab: Lab) -> None:
    file, key = lab.file(workflow(seal("time: 1"))), ("--user", "ada", "--request", "k1")
    first = labos("submit", file, *key, *lab.home).stdout.strip()
    before = lab.head()
    assert labos("submit", file, *key, *lab.home).stdout.strip() == first
    lab.file(workflow(seal("time: 2")))
    check_refused(
        labos("submit", file, *key, *lab.home), f"The key 'k1' belongs to {first}", "a key of its own"
    )
    assert lab.head() == before
    told = labos("cancel", first, "--wait", *lab.home)
    assert told.stdout == f"{first} is cancelled.\n"


# -- waits that say so -----------------------------------------------------------------------------


def test_a_node_that_is_gone_is_waited_for(working: Lab) -> None:
    lab = working
    assert labos("place", "sealer.default", "plate96", *lab.home).returncode == 0
    lab.stop("sealer")
    run = lab.submit(seal("time: 1"), move("sealer", "wc.trash"))
    lab.expect_wait(run, "sealer is GONE", "labos node start --name sealer --workcell small")
    lab.node("sealer")
    lab.expect_done(run)


def test_two_nodes_of_one_name(working: Lab, tmp_path: Path) -> None:
    lab = working
    info = find_kernel(lab.up.home)
    assert info is not None
    node = ("node", "start", "--name", "sealer", "--workcell", "small", "--simulate")
    before = lab.head()
    here = labos(*node, *lab.home)
    assert here.returncode == 1
    assert "small.sealer.journal is in use" in here.stderr
    elsewhere = labos(*node, "--home", str(tmp_path / "other"), "--connect", info.bus)
    assert elsewhere.returncode == 1
    assert "Another node already answers as 'small/sealer'. Stop it first" in elsewhere.stderr
    assert "Traceback" not in here.stderr + elsewhere.stderr
    assert lab.status("sealer") == "IDLE"
    assert lab.head() == before


def test_an_occupied_station_is_waited_for(working: Lab) -> None:
    lab = working
    assert labos("place", "sciclops.exchange", "plate96", *lab.home).returncode == 0
    run = lab.submit(get("tower1"), move("sciclops.exchange", "wc.trash"))
    lab.expect_wait(run, "sciclops.exchange is occupied by P", "It continues when a run moves that away")
    lab.expect_done(lab.submit(move("sciclops.exchange", "wc.trash")), run)


def test_an_empty_stack_is_told_at_once_and_waited_for(working: Lab) -> None:
    lab = working
    file = lab.file(workflow(get("tower2"), move("sciclops.exchange", "wc.trash")))
    told = "the stack sciclops.tower2 is empty"
    checked = labos("validate", file, "--workcell", str(lab.cell))
    assert checked.returncode == 0
    assert f"warning: {file}:4:5: " in checked.stdout
    assert "labos load sciclops.tower2 --type TYPE" in checked.stdout
    assert told in checked.stdout
    done = labos("submit", file, "--user", "ada", *lab.home)
    assert f"labos: {file}:4:5: " in done.stderr
    assert "sciclops.tower2 is empty" in done.stderr
    run = done.stdout.strip()
    lab.expect_wait(run, told, "labos load sciclops.tower2 --type TYPE")
    assert labos("place", "sciclops.tower2", "plate96", *lab.home).returncode == 0
    lab.expect_done(run)


def test_a_full_hotel_is_waited_for(working: Lab) -> None:
    lab = working
    assert labos("place", "wc.output", "plate96", *lab.home).returncode == 0
    run = lab.submit(get("tower1"), move("sciclops.exchange", "wc.output", "store"))
    why = "after 'get' the run could not reach its end at present: 'store' needs room at wc.output, where P"
    lab.expect_wait(run, why, "submit one that does")
    lab.expect_done(lab.submit(move("wc.output", "wc.trash")), run)


def test_at_the_end_the_log_is_whole_and_the_bench_agrees(working: Lab) -> None:
    assert "The log is intact" in labos("verify", *working.home).stdout
    assert labos("runs", "--json", *working.home).returncode == 0


def test_cancelling_says_what_is_true(working: Lab) -> None:
    lab = working
    assert labos("place", "sealer.default", "plate96", *lab.home).returncode == 0
    until(lambda: lab.status("sealer") == "IDLE", "the sealer is at rest")
    lab.nodes["sealer"].send_signal(signal.SIGSTOP)
    try:
        # In this process: on a busy machine a command starts slowly, and a frozen node soon counts as gone.
        with lab.up.client() as client:
            run = client.submit(Path(lab.file(workflow(seal("time: 1")))), user="ada")

        def at_work() -> bool:
            with lab.up.client() as client:
                return [step.state for step in client.status(run).steps] == ["in flight"]

        until(at_work, "the sealer was told to seal")
        told = labos("cancel", run, *lab.home).stdout
        assert told == (
            f"{run} is cancelling: it ends as soon as 'seal' on sealer has ended. "
            f"Wait for it: labos runs {run}\n"
        )
    finally:
        lab.nodes["sealer"].send_signal(signal.SIGCONT)
    with lab.up.client() as client:
        assert client.wait(run, timeout_s=30).over


# -- the database ----------------------------------------------------------------------------------


def test_a_postgres_that_is_not_there(tmp_path: Path) -> None:
    port, home = free_port(), tmp_path / "lab"
    url = f"postgresql://labos:secret@127.0.0.1:{port}/lab"
    for command in (("up", "rpl"), ("run", "cp_newplate")):
        done = labos(*command, "--simulate", "--home", str(home), LABOS_DATABASE_URL=url)
        check_refused(done, f"127.0.0.1:{port}/lab is not available", "Check that the server runs")
        assert "secret" not in done.stderr
        assert not home.exists()


@pytest.fixture(scope="module")
def ended(lab: Lab, tmp_path_factory: pytest.TempPathFactory) -> Callable[[Path], Path]:
    """Makes copies of a lab whose kernel has ended in order."""
    home = tmp_path_factory.mktemp("ended") / "lab"
    up = Up(home, "--simulate", "--no-nodes")
    try:
        up.start(str(lab.cell))
        assert up.interrupt() == 0, up.read_log()
    finally:
        up.clean_up()

    def copy(folder: Path) -> Path:
        return Path(shutil.copytree(home, folder))

    return copy


def test_a_database_of_a_newer_version(ended: Callable[[Path], Path], tmp_path: Path) -> None:
    home = ended(tmp_path / "lab")
    with closing(sqlite3.connect(home / "labos.db")) as database:
        database.execute("UPDATE labos_version SET version_num = '9999'")
        database.commit()
    before, there = (home / "labos.db").read_bytes(), files_of(home)
    for command in (("up",), ("run", "cp_newplate", "--simulate")):
        check_refused(
            labos(*command, "--home", str(home)), "written by a newer LabOS (revision 9999", "Upgrade"
        )
    assert (home / "labos.db").read_bytes() == before
    assert files_of(home) - {"labos.db-wal", "labos.db-shm"} == there - {"labos.db-wal", "labos.db-shm"}


class TestBadDisk:
    """A small disk of its own, with a lab on it and another one that is to be made."""

    @pytest.fixture
    def disk(self, tmp_path: Path) -> Iterator[Callable[[str], None]]:
        folder = tmp_path / "disk"
        folder.mkdir()

        def mount(options: str) -> None:
            command = ["mount", "-t", "tmpfs", "-o", options, "tmpfs", str(folder)]
            if subprocess.run(command, capture_output=True, check=False).returncode:
                pytest.skip("this user may not mount a disk")

        mount("size=3m")
        yield mount
        subprocess.run(["umount", "--lazy", str(folder)], check=True)

    def test_that_may_not_be_written(
        self, disk: Callable[[str], None], ended: Callable[[Path], Path], lab: Lab, tmp_path: Path
    ) -> None:
        home, new = ended(tmp_path / "disk" / "lab"), tmp_path / "disk" / "new"
        disk("remount,ro")
        check_refused(
            labos("up", "--home", str(home)), "labos.db", "Read-only file system", "Check that its file"
        )
        made = labos("up", str(lab.cell), "--simulate", "--home", str(new))
        check_refused(made, str(new), "Read-only file system", "written")
        assert not new.exists()
        assert "The log is intact" in labos("verify", "--home", str(home)).stdout
        disk("remount,rw,size=3m")
        self.goes_on(home)

    def test_that_is_full(
        self, disk: Callable[[str], None], ended: Callable[[Path], Path], lab: Lab, tmp_path: Path
    ) -> None:
        folder = tmp_path / "disk"
        home, new, filler = ended(folder / "lab"), folder / "new", folder / "filler"
        with suppress(OSError), filler.open("wb", buffering=0) as file:
            while file.write(bytes(4096)):
                pass
        check_refused(labos("up", "--home", str(home)), str(home), "full", "Free some space")
        made = labos("up", str(lab.cell), "--simulate", "--home", str(new))
        check_refused(made, str(new), "Free some space")
        begun = {path.name: path.stat().st_size for path in new.rglob("*")} if new.exists() else {}
        assert begun.keys() <= {"labos.db", "labos.db-wal", "labos.db-shm"}
        assert not begun.get("labos.db-wal"), f"nothing is half written: {begun}"
        assert "The log is intact" in labos("verify", "--home", str(home)).stdout
        filler.unlink()
        self.goes_on(home)
        self.goes_on(new, str(lab.cell))

    @staticmethod
    def goes_on(home: Path, *new: str) -> None:
        """Mended, the lab starts as if nothing had been; one of a ``new`` workcell, too."""
        up = Up(home, "--no-nodes", *(["--simulate"] if new else [])).start(*new)
        try:
            assert up.interrupt() == 0, up.read_log()
        finally:
            up.clean_up()


def test_a_port_in_use(ended: Callable[[Path], Path], tmp_path: Path) -> None:
    home = ended(tmp_path / "lab")
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = str(taken.getsockname()[1])
        for option in ("--http-port", "--bus-port"):
            check_refused(labos("up", "--no-nodes", "--home", str(home), option, port), port, "in use")
    assert find_kernel(home) is None
    assert "The log is intact" in labos("verify", "--home", str(home)).stdout


def test_right_after_a_kill_nobody_is_refused(ended: Callable[[Path], Path], tmp_path: Path) -> None:
    home = ended(tmp_path / "lab")
    url, up = f"sqlite:///{home}/labos.db", Up(home, "--no-nodes")
    try:
        up.start()
        assert find_lease_holder(url)
        up.kill()
        assert find_lease_holder(url) == ""
        where = ("--home", str(home), "--database", url)  # a copied home names the first one's
        facts = json.loads(labos("db", "status", "--json", *where).stdout)
        assert facts["kernel"] == ""
        epoch = facts["epoch"]
        up.start()
        with up.client() as client:
            assert client.health()["epoch"] == epoch + 1
        assert up.interrupt() == 0
    finally:
        up.clean_up()

"""`labos up --secure`: a lab whose bus speaks TLS and lets everybody speak for himself only."""

from __future__ import annotations

import contextlib
import json
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import msgspec
import pytest

from labos.client import LabClient
from labos.node.protocol import Ask, Keys
from labos.pki import Authority, Credentials, PartyIdentity
from labos.settings import find_kernel, free_port
from tests.support.lab_process import Up, labos, statuses, until
from tests.support.stranger import Stranger
from tests.system.test_standby import AWAY, CELL

pytestmark = pytest.mark.timeout(240)

SCICLOPS, PF400 = "rpl/sciclops", "rpl/pf400"


@pytest.fixture
def cell(tmp_path: Path) -> str:
    path = tmp_path / "rpl.yaml"
    path.write_text(CELL)
    (tmp_path / "away.yaml").write_text(AWAY)
    return str(path)


@pytest.fixture
def lab(tmp_path: Path) -> Iterator[Up]:
    made = Up(tmp_path / "lab", "--simulate", "--speed", "300", "--secure")
    yield made
    made.clean_up()


@pytest.fixture
def stranger() -> Iterator[Stranger]:
    made = Stranger()
    yield made
    made.close()


def authority(lab: Up) -> Authority:
    return Authority(lab.home / "pki")


def status(client: LabClient, module: str) -> str:
    return next(str(m["status"]) for m in client.state(waits=False)["modules"] if m["name"] == module)


def problem(client: LabClient, module: str) -> str:
    modules = client.state(waits=False)["modules"]
    return next(str(m.get("problem") or "") for m in modules if m["name"] == module)


def works(lab: Up, client: LabClient) -> None:
    for module in (SCICLOPS, PF400):
        until(lambda name=module: status(client, name) == "IDLE", f"{module} has joined")  # type: ignore[misc]
    run = client.submit(lab.home.parent / "away.yaml", user="ada")
    assert statuses(client, [run]) == ["completed"], lab.read_log()


def test_a_secure_lab(lab: Up, cell: str, stranger: Stranger, tmp_path: Path) -> None:
    lab.start(cell)
    with lab.client() as client:
        works(lab, client)
        found = find_kernel(lab.home)
        assert found is not None
        endpoint, keys = found.bus, Keys(found.lab)
        assert endpoint.startswith("tls/")
        issuing, own = authority(lab), PartyIdentity("node", PF400, found.lab)
        listed = {entry.identity for entry in issuing.read_members().entries}
        assert listed == {
            PartyIdentity("kernel", "", found.lab),
            PartyIdentity("node", SCICLOPS, found.lab),
            own,
        }
        # Somebody has got hold of a node's key, and plays a kernel of a later epoch.
        stolen = copy(issuing.credentials(own), tmp_path / "stolen")
        stranger("open", "thief", endpoint, str(stolen))
        question = msgspec.json.encode(Ask(keys.lab, 1000, "a1", 1, 1, void=True)).decode()
        assert stranger("get", "thief", keys.operation(SCICLOPS, "action"), question) == []
        assert stranger("get", "thief", keys.setup_of(SCICLOPS), json.dumps({"module": SCICLOPS})) == []
        assert "pf400" in stranger("get", "thief", keys.setup_of(PF400), json.dumps({"module": PF400}))[0]
        assert "another module" in stranger("get", "thief", keys.setup_of(PF400), '{"module":"rpl/x"}')[0]
        with pytest.raises(AssertionError, match="ZError"):
            stranger("open", "without", endpoint.replace("tls/", "tcp/"), "")
        # He is shut out, and the node gets a new key, which it uses by itself.
        issuing.renew(issuing.find("kernel"))
        issuing.revoke(issuing.find(PF400), "its key was copied")
        until(lambda: status(client, PF400) == "GONE", "the revoked certificate does not speak")
        issuing.issue(own)
        works(lab, client)
        assert stranger("get", "thief", keys.setup_of(PF400), json.dumps({"module": PF400})) == []
        # An emergency stop past the kernel takes a certificate.
        door = PartyIdentity("stop", "door", found.lab)
        issuing.issue(door)
        folder = str(issuing.credentials(door).folder)
        stop = ("estop", "--all", "--connect", endpoint, "--json", "--home", str(lab.home))
        until(lambda: labos(*stop, "--cert", folder).returncode == 0, "the bus knows the certificate")
        until(lambda: status(client, PF400) == "ERROR", "it is stopped")
        doctor = json.loads(labos("doctor", "--json", "--home", str(lab.home)).stdout)["findings"]
        assert {one["state"] for one in doctor if one["name"] in ("certificates", "permissions", "bus")} == {
            "ok"
        }
    assert lab.interrupt() == 0
    lab.options = ("--no-nodes",)
    lab.start()
    found = find_kernel(lab.home)
    assert found is not None
    assert found.bus.startswith("tls/"), "it stays secure"
    # Zenoh says nothing of what it refuses: who is connected and not heard is told to the operator.
    issued = issuing.credentials(PartyIdentity("node", SCICLOPS, found.lab))
    stranger("open", "silent", found.bus, str(issued.folder))
    with lab.client() as client:
        until(lambda: "has not announced itself" in problem(client, SCICLOPS), "the operator is told")
    assert lab.interrupt() == 0
    assert lab.disagreements() == []


def test_a_bus_by_itself_and_nodes_of_other_computers(lab: Up, cell: str, tmp_path: Path) -> None:
    """Each has the folder that was issued for it, and nothing else. Who may speak, the kernel tells the
    bus."""
    endpoint = f"tls/127.0.0.1:{free_port()}"
    home = ("--home", str(lab.home))
    issuing = authority(lab)
    issuing.init("test")
    issuing.issue(PartyIdentity("bus"), addresses=["127.0.0.1"])
    bus = copy(issuing.credentials(PartyIdentity("bus")), tmp_path / "bus")
    lab.options = (*lab.options, "--no-nodes", "--bus", endpoint)
    with contextlib.ExitStack() as stack:
        bus_log = tmp_path / "bus.log"
        stack.enter_context(process(bus_log, "bus", "--listen", endpoint, "--cert", str(bus)))
        until(lambda: "The bus runs" in bus_log.read_text(), "the bus runs")
        lab.launch(cell)
        until(lambda: b"kernel" in issuing.members_file.read_bytes(), "the kernel has its own certificate")
        until(lab.is_there, "the lab answers")
        found = find_kernel(lab.home)
        assert found is not None
        for module in (SCICLOPS, PF400):
            issuing.issue(who := PartyIdentity("node", module, found.lab))
            own = copy(issuing.credentials(who), tmp_path / module.partition("/")[2])
            words = ("node", "start", "--simulate", "--workcell", "rpl", "--name", own.name)
            stack.enter_context(
                process(
                    tmp_path / f"{own.name}.log", *words, "--connect", endpoint, "--cert", str(own), *home
                )
            )
        with lab.client() as client:
            works(lab, client)
        elsewhere = ("--home", str(tmp_path / "elsewhere"))
        wrong = labos(*words, "--connect", endpoint, "--cert", str(bus), *elsewhere)
        assert "belongs to the bus, not to the node rpl/pf400" in wrong.stderr
        assert lab.interrupt() == 0


def copy(issued: Credentials, to: Path) -> Path:
    shutil.copytree(issued.folder, to)
    return to


@contextlib.contextmanager
def process(log: Path, *words: str) -> Iterator[None]:
    with log.open("wb") as file:
        argv = [sys.executable, "-m", "labos", *words]
        started = subprocess.Popen(argv, stdin=subprocess.DEVNULL, stdout=file, stderr=file)
    try:
        yield
    finally:
        started.terminate()
        try:
            started.wait(20)
        except subprocess.TimeoutExpired:
            started.kill()
            started.wait()

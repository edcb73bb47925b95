"""``labos doctor``: what is wrong is found, and said with what to do."""

from __future__ import annotations

import json
import os
import socket
from pathlib import Path
from typing import Any

import pytest

from labos.cli.app import main
from labos.core.ids import ModuleName
from labos.core.lengths import Drift
from labos.http.asking import _measure_ahead_s
from labos.pki import Authority, PartyIdentity
from labos.services.doctor import (
    check_certificates,
    check_durations,
    check_nodes,
    check_permissions,
    check_space,
    check_sync,
)
from labos.settings import KernelInfo, Ports, announce, remember_ports
from labos.version import VERSION
from tests.integration.http.signed import lab_with_users
from tests.integration.trust.conftest import Lab
from tests.support.lab_process import Up, labos, until
from tests.unit.services.logbook import two_users


@pytest.fixture
def lab(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Lab:
    monkeypatch.delenv("LABOS_DATABASE_URL", raising=False)
    found = Lab(tmp_path / "lab")
    found.home.mkdir(mode=0o700)
    found.write(two_users().records)
    return found


def findings(lab: Lab, code: int = 0) -> dict[str, dict[str, Any]]:
    said = json.loads(lab.ask("doctor", "--json", code=code))
    assert said["well"] == (code == 0)
    return {one["name"]: one for one in said["findings"]}


def test_a_lab_that_is_well(lab: Lab) -> None:
    found = findings(lab)
    assert {name: one["state"] for name, one in found.items()} == {
        "database": "ok",
        "disk space": "ok",
        "disk sync": "ok",
        "permissions": "ok",
        "kernel": "ok",
        "checkpoints": "warning",
        "backup": "warning",
        "durations": "warning",  # its log was made up, and nothing in it takes as long as planned
    }
    assert "0 faults, 3 warnings" in lab.ask("doctor")
    assert sorted(path.name for path in lab.home.iterdir() if path.name.startswith(".")) == []


def test_certificates_that_end(lab: Lab) -> None:
    lab.ask("pki", "init")
    lab.ask("pki", "issue", "viewer", "wall", "--lab-id", "lab-1", "--days", "900")
    found = findings(lab)
    assert found["certificates"]["state"] == "ok"
    assert found["permissions"]["state"] == "ok"
    authority = Authority(lab.home / "pki")
    key = authority.credentials(PartyIdentity("viewer", "wall", "lab-1")).key
    key.chmod(0o644)
    assert str(key) in findings(lab, code=1)["permissions"]["result"]
    key.chmod(0o600)
    admitted = authority.read_members().admitted
    told = check_certificates(authority, admitted[0].not_after - 30 * 86_400 * 10**9)
    assert [(one.state, "viewer wall ends" in one.result) for one in told] == [("warning", True)]
    told = check_certificates(authority, authority.find_end())
    assert [(one.name.split()[0], one.state) for one in told] == [
        ("certificate", "fault"),
        ("authority", "fault"),
    ]


def test_a_lab_that_is_not_there(tmp_path: Path) -> None:
    found = findings(Lab(tmp_path / "none"), code=1)
    assert found["home"]["state"] == "fault"
    assert found["database"]["remedy"].startswith("labos up creates one")
    assert not (tmp_path / "none").exists()


def test_actions_that_take_longer_than_planned() -> None:
    slow = [Drift(ModuleName(f"rpl/m{n}"), "transfer", 14.0, 10.0) for n in range(7)]
    found = check_durations(slow)
    assert found.state == "warning"
    assert found.result.startswith("rpl/m0.transfer takes 14 s, planned 10 s; ")
    assert "2 more" in found.result
    assert check_durations([]).state == "ok"


@pytest.mark.skipif(os.name == "nt", reason="Windows has no such rights")
def test_what_others_may_read(lab: Lab) -> None:
    (lab.home / "labos.db").chmod(0o644)
    found = findings(lab, code=1)["permissions"]
    assert "Others may read" in found["result"]
    assert found["remedy"] == f"chmod -R go= {lab.home / 'labos.db'}"


def test_a_port_that_another_program_has(lab: Lab) -> None:
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        port = other.getsockname()[1]
        remember_ports(lab.home, Ports(http=port))
        found = findings(lab, code=1)["ports"]
    assert f"Another program listens on {port}" in found["result"]
    assert found["remedy"].endswith("labos up --http-port PORT")


def test_a_kernel_that_was_killed(lab: Lab) -> None:
    announce(
        lab.home,
        KernelInfo(2**22 + 1, "http://127.0.0.1:9", "", "lab-1", f"sqlite:///{lab.home / 'labos.db'}"),
    )
    found = findings(lab)["kernel"]
    assert found["state"] == "warning"
    assert "ended unexpectedly" in found["result"]


def test_a_database_that_cannot_be_reached(lab: Lab) -> None:
    said = lab.ask("doctor", "--database", "postgresql://127.0.0.1:9/none", "--json", code=1)
    found = json.loads(said)["findings"][0]
    assert (found["name"], found["state"]) == ("database", "fault")
    assert found["remedy"]


def test_a_file_that_is_no_database(lab: Lab) -> None:
    (lab.home / "labos.db").write_bytes(b"not a database" * 100)
    assert findings(lab, code=1)["database"]["state"] == "fault"


def test_a_folder_that_cannot_be_written(tmp_path: Path) -> None:
    with pytest.raises(OSError, match="No such file"):
        check_sync(tmp_path / "none")
    assert check_space(tmp_path).result.endswith(f"free on the disk of {tmp_path}.")
    assert check_permissions([tmp_path / "none"]).state == "ok"


def make_answer(answer: str = "IDLE", **checked: Any) -> dict[str, Any]:
    whole = {"labos": VERSION, "clock_ahead_s": 0.01, **checked}
    return {"name": "rpl/sealer", "answer": answer, "why": "it is off.", "checked": whole}


@pytest.mark.parametrize(
    ("one", "state", "said"),
    [
        (make_answer(), "ok", "rpl/sealer answers: IDLE."),
        (make_answer("out"), "warning", "cannot work (out): it is off."),
        (make_answer("silent"), "fault", "cannot work (silent)"),
        ({**make_answer("frozen"), "checked": None}, "fault", "cannot work (frozen)"),
        (make_answer(labos="0.0.9"), "warning", f"is LabOS 0.0.9, the kernel {VERSION}"),
        (make_answer(clock_ahead_s=-1.5), "warning", "computer is 1.5 s behind the kernel's"),
        (make_answer(clock_ahead_s=90.0), "fault", "computer is 90.0 s ahead of the kernel's"),
        (make_answer(clock_ahead_s=None), "ok", "answers"),
    ],
)
def test_what_nodes_answer(one: dict[str, Any], state: str, said: str) -> None:
    found = check_nodes([one], VERSION)[-1]
    assert found.state == state
    assert said in found.result
    assert bool(found.remedy) == (state != "ok")


def test_a_clock_is_compared_with_the_middle_of_question_and_answer() -> None:
    second = 10**9
    assert _measure_ahead_s(13 * second, 10 * second, 12 * second) == 2.0
    assert _measure_ahead_s(0, 10 * second, 12 * second) is None


@pytest.mark.slow
def test_a_running_lab_with_its_nodes(tmp_path: Path) -> None:
    up = Up(tmp_path / "lab", "--simulate", "--speed", "60")
    try:
        up.start("rpl")
        with up.client() as client:
            until(lambda: all(one["answer"] == "IDLE" for one in client.check_nodes()), "all nodes answer")
            ahead = [one["checked"]["clock_ahead_s"] for one in client.check_nodes()]
        said = labos("doctor", "--json", "--home", str(up.home))
        up.interrupt()
    finally:
        up.clean_up()
    assert all(abs(each) < 1 for each in ahead)
    found = {one["name"]: one for one in json.loads(said.stdout)["findings"]}
    assert found["kernel"]["state"] == found["bus"]["state"] == "ok", said.stdout
    assert len([name for name in found if name.startswith("node rpl/")]) == 14
    assert [one for name, one in found.items() if name.startswith(("clock", "version"))] == []


def test_the_owner_of_the_folder_looks_at_a_lab_with_users(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Nobody has signed in, as in a timer of the system."""
    monkeypatch.delenv("LABOS_TOKEN", raising=False)
    with lab_with_users(tmp_path):
        code = main(["doctor", "--json", "--home", str(tmp_path / "lab")])
    assert code == 1, "it has no nodes, which is a fault"
    found = {one["name"]: one for one in json.loads(capsys.readouterr().out)["findings"]}
    assert (found["kernel"]["state"], "log is at" in found["kernel"]["result"]) == ("ok", True), found[
        "kernel"
    ]

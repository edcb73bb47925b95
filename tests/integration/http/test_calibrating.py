"""``labos calibrate`` in a lab that runs: what is recorded, by whom, and what of it can be erased."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from hashlib import sha256
from pathlib import Path
from uuid import uuid4

import pytest

from labos.bootstrap import LabThread, descriptions
from labos.cli.app import main
from labos.client import LabClient
from labos.errors import LabosError
from labos.settings import Settings
from labos.spec import parse_workcell
from tests.integration.http.signed import client_of, lab_with_users, token_of

CELL = """
labos: 1
name: corner
modules:
  - {name: reader, model: Hidex}
"""
REPORT = b"%PDF-1.7 all channels within 1 %"
SECRET = "bo broke the lamp"
Say = Callable[..., str]


@pytest.fixture
def say(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Say:
    def say_(*words: str, home: Path | None = None, fails: bool = False, out: bool = False) -> str:
        if home is not None:
            monkeypatch.setenv("LABOS_HOME", str(home))
        capsys.readouterr()
        code = main(list(words))
        told = capsys.readouterr()
        assert (code != 0) == fails, told
        return told.err if fails and not out else told.out

    return say_


@pytest.fixture
def lab(tmp_path: Path) -> Iterator[LabThread]:
    settings = Settings.make(tmp_path / "lab", simulate=True)
    with LabThread(settings, [parse_workcell(CELL, descriptions())], nodes="none") as running:
        yield running


def test_a_calibration_is_recorded_with_its_report(lab: LabThread, say: Say, tmp_path: Path) -> None:
    report = tmp_path / "report.pdf"
    report.write_bytes(REPORT)
    digest = sha256(REPORT).hexdigest()
    words = ("--what", "volume", "--certificate", "K-1", "--until", "2031-01-01", "--file", str(report))
    told = say("calibrate", "reader", *words, "--user", "ada", home=lab.settings.home)
    assert (
        told.split()
        == (
            f"The calibration of corner/reader (volume) is recorded, valid until 2031-01-01. "
            f"Its report is kept as {digest}."
        ).split()
    )
    again = json.loads(say("calibrate", "reader", "--user", "ada", "--json"))
    assert again == {"module": "corner/reader", "what": "", "certificate": "", "file": "", "until": ""}
    assert "calibrated (volume) by ada, certificate K-1, valid until 2031-01-01" in say("log")
    assert "2031-01-01" in say("nodes").splitlines()[1]
    with LabClient(lab.url) as client:
        (module,) = client.state()["modules"]
        assert [(one["what"], one["file"], one["by"]) for one in module["calibrations"]] == [
            ("", "", "ada"),
            ("volume", digest, "ada"),
        ]
        assert client.file(digest) == REPORT


def test_a_report_that_is_lost_is_found_to_be(lab: LabThread, say: Say, tmp_path: Path) -> None:
    report = tmp_path / "report.pdf"
    report.write_bytes(REPORT)
    say("calibrate", "reader", "--file", str(report), home=lab.settings.home)
    say("verify")
    digest = sha256(REPORT).hexdigest()
    (kept,) = (
        path for path in (lab.settings.home / "blobs").rglob("*") if path.is_file() and digest in str(path)
    )
    kept.unlink()
    assert f"names the blob {digest}, which is missing" in say("verify", fails=True, out=True)


def test_a_report_that_is_not_kept(lab: LabThread, say: Say, tmp_path: Path) -> None:
    home, report = lab.settings.home, tmp_path / "report.pdf"
    assert "cannot be read" in say("calibrate", "reader", "--file", str(report), home=home, fails=True)
    report.write_bytes(b"")
    assert "is empty" in say("calibrate", "reader", "--file", str(report), fails=True)
    report.write_bytes(REPORT)
    wrong = ("--until", "2031-02-30", "--file", str(report))
    assert "'2031-02-30' is not a date. Write it like 2027-05-31." in say(
        "calibrate", "reader", *wrong, fails=True
    )
    assert "no module" in say("calibrate", "washer", "--file", str(report), fails=True)
    with LabClient(lab.url) as client, pytest.raises(LabosError):
        client.file(sha256(REPORT).hexdigest())
    assert "module.calibrated" not in say("log")


def test_what_was_said_about_it_can_be_erased(lab: LabThread, say: Say) -> None:
    home = lab.settings.home
    say("calibrate", "reader", "--certificate", "K-1", "--why", SECRET, "--user", "ada", home=home)
    assert SECRET in say("log")
    assert SECRET in say("sql", "SELECT why FROM calibrations")
    position = next(line.split()[0] for line in say("log").splitlines() if SECRET in line)
    say("erase", position, "--because", "personal", "--user", "ada")
    log = say("log")
    assert SECRET not in log
    assert "certificate K-1: (erased)" in log
    rows = say("sql", "SELECT certificate, why FROM calibrations")
    assert "K-1" in rows
    assert SECRET not in rows
    say("verify")


def test_only_operators_record_and_a_repeated_request_is_one(tmp_path: Path) -> None:
    told = {"what": "volume", "until": "2031-01-01", "report": "YQ=="}
    with lab_with_users(tmp_path) as lab:
        with client_of(lab) as stranger:
            assert stranger.post("/modules/hidex/calibrations", json=told).status_code == 401
        with client_of(lab, token_of(tmp_path, "bob", scope="operator")) as bob:
            refusal = bob.post("/modules/hidex/calibrations", json=told)
            assert refusal.status_code == 403
            assert "operator" in refusal.text
            assert bob.get(f"/files/{sha256(b'a').hexdigest()}").status_code == 404
        key = {"idempotency-key": uuid4().hex}
        with client_of(lab, token_of(tmp_path, "ada", scope="operator")) as ada:
            answers = [ada.post("/modules/hidex/calibrations", json=told, headers=key) for _ in range(2)]
            assert [answer.status_code for answer in answers] == [201, 201]
            assert answers[0].json() == answers[1].json()
            events = ada.get("/events").json()["events"]
            recorded = [event["payload"] for event in events if event["type"] == "module.calibrated"]
        assert [(event["by"], event["what"]) for event in recorded] == [("ada", "volume")]


@pytest.mark.slow
def test_two_calibrations_and_two_measurements_from_end_to_end(say: Say, tmp_path: Path) -> None:
    home = tmp_path / "lab"
    settings = Settings.make(home, speed=5000.0, simulate=True)
    cell = parse_workcell(CELL, descriptions())
    with (
        LabThread(settings, [cell], nodes="processes") as lab,
        LabClient(lab.url) as client,
    ):
        found = []
        for certificate in ("", "K-1", "K-2"):
            if certificate:
                say("calibrate", "reader", "--certificate", certificate, "--until", "2099-12-31", home=home)
            run = client.do("reader", "close_lid", user="ada")
            assert client.wait(run, timeout_s=120).status == "completed"
            found.append(run)
        told = [say("provenance", run, home=home) for run in found]
    assert [("K-1" in text, "K-2" in text) for text in told] == [(False, False), (True, False), (False, True)]

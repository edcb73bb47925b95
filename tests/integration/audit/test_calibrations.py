"""Which calibrations actions, runs, results and wells relied on, from the log alone."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from labos.cli.app import main
from labos.core.ids import ModuleName
from labos.core.modules import ModuleCalibrated
from tests.support.audited import MEASURED, OT2, finish_with
from tests.unit.services.logbook import Logbook

SLIDES = ModuleName("rpl/camera_module")
Ask = Callable[..., str]


def calibrate(book: Logbook, module: ModuleName, what: str, until: str, certificate: str) -> str:
    """Returns its name."""
    book.write([ModuleCalibrated(module, "ada", what, certificate, "", until)], "ada")
    return f"{module}@{book.position}"


class Story:
    """Two runs of one day (2025-06-15) mix on the same OT-2 and are read: between them, its volume is
    calibrated again, and a calibration of the camera has expired the day before both."""

    def __init__(self) -> None:
        self.book = book = Logbook()
        book.furnish()
        self.first = calibrate(book, OT2, "volume", "2025-06-15", "K-1")
        self.stale = calibrate(book, SLIDES, "", "2025-06-14", "K-2")
        self.other = calibrate(book, OT2, "temperature", "", "K-3")
        run = book.submit("cp_newplate", "ada")
        finish_with(book, run, {})
        self.before = book.submit("cp_mixcolor", "ada")
        finish_with(book, self.before, {"Take picture": MEASURED})
        self.between = book.position
        self.second = calibrate(book, OT2, "volume", "2025-12-31", "K-4")
        self.after = book.submit("cp_mixcolor", "ada")
        finish_with(book, self.after, {"Take picture": MEASURED})


@pytest.fixture(scope="module")
def story() -> Story:
    return Story()


@pytest.fixture
def ask(
    story: Story, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> Ask:
    """Runs ``labos`` in the folder of that lab, where no kernel runs."""
    story.book.save(tmp_path / "lab")
    monkeypatch.setenv("LABOS_HOME", str(tmp_path / "lab"))
    monkeypatch.delenv("LABOS_DATABASE_URL", raising=False)

    def ask_(*words: str) -> str:
        assert main(list(words)) == 0, capsys.readouterr()
        return capsys.readouterr().out

    return ask_


def list_relied_on(ask: Ask, *words: str) -> list[str]:
    return list(json.loads(ask("provenance", *words, "--json"))["facts"]["calibrations"])


def list_linked(ask: Ask, *words: str, end: str = "cause", kind: str = "calibration") -> set[str]:
    links: list[dict[str, Any]] = json.loads(ask("provenance", *words, "--json"))["links"]
    return {link[end]["name"] for link in links if link[end]["kind"] == kind}


def test_an_action_relied_on_what_was_in_force_then(ask: Ask, story: Story) -> None:
    assert list_relied_on(ask, f"{story.before}#1") == [story.first, story.other]
    assert list_relied_on(ask, f"{story.after}#1") == [story.other, story.second]


def test_a_run_and_a_result_relied_on_those_of_their_actions(ask: Ask, story: Story) -> None:
    assert list_relied_on(ask, story.before) == [story.first, story.other]
    assert list_relied_on(ask, story.after) == [story.other, story.second]
    assert list_linked(ask, story.before) == {story.first, story.other}
    assert {story.first, story.other} <= list_linked(ask, f"{story.before}#3")
    assert story.second not in list_linked(ask, f"{story.before}#3")


def test_a_plate_and_a_well_are_asked_at_any_moment(ask: Ask, story: Story) -> None:
    assert list_linked(ask, "P1/A1", "--at", str(story.between)) == {story.first, story.other}
    assert list_linked(ask, "P1/A1") == list_linked(ask, "P1") == {story.first, story.other, story.second}


def test_what_has_expired_and_what_nobody_recorded_is_not_there(ask: Ask, story: Story) -> None:
    assert (
        list_relied_on(ask, f"{story.before}#3") == []
    )  # of the camera, whose calibration is of the day before
    told = ask("provenance", f"{story.before}#0")  # of the arm, which was never calibrated
    assert "calibrations" not in told.partition("Links")[0]
    assert story.stale not in list_linked(ask, f"{story.before}#3")


def test_what_hangs_on_a_calibration(ask: Ask, story: Story) -> None:
    def list_hanging(calibration: str, kind: str) -> set[str]:
        return list_linked(ask, f"calibration:{calibration}", "--down", end="effect", kind=kind)

    assert f"result of {story.before} #3" in ask(
        "provenance", f"calibration:{story.first}", "--down", "--only", "result"
    )
    later = ask("provenance", f"calibration:{story.second}", "--down", "--only", "action")
    assert f"({story.after} #1" in later
    assert f"({story.before} " not in later
    assert len(list_hanging(story.second, "result")) == 1
    assert list_hanging(story.stale, "action") == list_hanging(story.stale, "result") == set()


def test_prov_and_sql_name_it(ask: Ask, story: Story) -> None:
    pytest.importorskip("prov")
    told = json.loads(ask("provenance", f"{story.before}#1", "--prov"))
    used = [link for link in told["used"].values() if "calibration" in link["prov:entity"]]
    assert [link["prov:role"] for link in used if "action" in link["prov:activity"]] == ["relied on"] * 2
    rows = ask(
        "sql", "SELECT certificate, what, until, recorded_by FROM calibrations ORDER BY position", "--csv"
    )
    assert rows.splitlines()[1:] == [
        *("K-1,volume,2025-06-15,ada", "K-2,,2025-06-14,ada"),
        *("K-3,temperature,,ada", "K-4,volume,2025-12-31,ada"),
    ]


def test_modules_and_the_doctor_show_the_last_day(ask: Ask) -> None:
    rows = ask("nodes").splitlines()
    assert "calibrated until" in rows[0]
    assert any("ot2_cp_gamma" in row and row.rstrip().endswith("2025-12-31") for row in rows)
    findings = json.loads(ask("doctor", "--json"))["findings"]
    (found,) = (one for one in findings if one["name"] == "calibrations")
    assert found["state"] == "warning"
    assert "camera_module has expired: it was valid until 2025-06-14" in found["result"]
    assert "ot2_cp_gamma (volume) has expired: it was valid until 2025-12-31" in found["result"]

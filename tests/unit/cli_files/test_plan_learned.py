"""``labos plan`` with a lab whose log tells how long steps take."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from labos.core.lengths import ENOUGH
from labos.errors import StoreUnavailable
from tests.unit.cli_files.calls import call
from tests.unit.services.logbook import Logbook

PLAN = ("plan", "pcr", "--workcell", "rpl")


@pytest.fixture(scope="module")
def home(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A lab at pace 2 that has carried PCRs out, each step in 4 s of wall time."""
    book = Logbook(pace=2.0)
    book.furnish()
    for _ in range(ENOUGH):
        book.carry_through(book.submit("pcr"), seconds=4.0)
    folder = tmp_path_factory.mktemp("home")
    book.save(folder)
    return folder


def test_what_a_lab_has_learned_counts(home: Path) -> None:
    told = call(*PLAN, "--home", str(home))
    assert "~8 s" in told
    assert f"Times marked ~ are what {home} has learned (14 of 14 steps): all steps together take" in told
    plan = json.loads(call(*PLAN, "--home", str(home), "--json"))
    steps = [step for step in plan["steps"] if not step["on_cancel"]]
    assert plan["lab"] == str(home)
    assert all(step["learned"] for step in steps)
    assert [step["duration_s"] for step in steps] == pytest.approx([8.0] * len(steps), rel=1e-3)
    assert plan["total_s"] == pytest.approx(8.0 * len(steps), rel=1e-3)
    assert next(step["nominal_s"] for step in steps if step["action"] == "run_program") == 5400.0


def test_a_new_lab_and_no_lab_say_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    book = Logbook()
    book.furnish()
    book.save(tmp_path)
    assert "has too few executions of these steps." in call(*PLAN, "--home", str(tmp_path))
    monkeypatch.chdir(tmp_path)
    assert "The times are from the drivers, not from a lab (--home)." in call(*PLAN)
    plan = json.loads(call(*PLAN, "--json"))
    assert (plan["lab"], plan["steps"][0]["learned"]) == ("", False)


def test_a_lab_that_was_named_must_be_there(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(StoreUnavailable):
        call(*PLAN, "--home", str(tmp_path))
    monkeypatch.setenv("LABOS_URL", "http://127.0.0.1:9")
    assert "not from a lab" in call(*PLAN)

"""Where no kernel runs, what is shown is the last known; runs of an experiment by its id."""

from __future__ import annotations

import json
from pathlib import Path

import msgspec
import pytest
from click.testing import CliRunner

from labos.cli.app import group
from labos.core.experiments import ExperimentStarted
from labos.core.ids import ExperimentId, InterventionId, LabwareId, RunId
from labos.core.interventions import InterventionRequested
from labos.core.lab import StartsPaused, StartsResumed
from labos.core.labware import Sample, SamplesRegistered
from labos.core.runs import RunCancelled, RunCancelling, RunStarted, RunSubmitted
from labos.core.topics import PlannedWork
from labos.errors import NotFound
from labos.store import open_store
from tests.unit.cli_queries.conftest import Ask
from tests.unit.cli_queries.test_queries import append
from tests.unit.services.logbook import two_users


def test_a_paused_experiment_is_shown_as_paused_until_it_goes_on(ask: Ask, home: Path) -> None:
    append(home, ExperimentStarted(ExperimentId("E1"), "colours", "bo"), StartsPaused("E1", "bo", "lunch"))
    assert "paused (lunch)" in ask("experiments").stdout
    append(home, StartsResumed("E1", "bo"))
    assert ask("experiments").stdout.splitlines()[1].split()[3] == "open"


def test_the_runs_of_an_experiment_are_asked_for_by_its_id(ask: Ask, home: Path) -> None:
    append(home, ExperimentStarted(ExperimentId("E1"), "colours", "bo"))
    assert len(ask("runs", "E1").stdout.splitlines()) == 1, "it has none, and others are not shown"
    assert json.loads(ask("runs", "E1", "--json").stdout) == []
    assert "There is no run 'E7'" in ask("runs", "E7", code=1).stdout


SHOW = [
    *("runs", "runs R2", "experiments", "explain R2", "results R1", "files", "nodes", "locations pf400"),
    *("stations", "labware", "labware P1", "samples show P1", "inventory", "interventions", "resolve"),
    *("inbox", "notifications", "handover-report", "log --last 1", "twh"),
]
"""Commands that show what a lab is like, or what happened in it."""


@pytest.mark.parametrize("words", SHOW)
@pytest.mark.usefixtures("ask")
def test_without_a_kernel_it_is_said_how_old_is_what_is_shown(words: str, home: Path) -> None:
    append(home, SamplesRegistered(LabwareId("P1"), "", "d", 1, (Sample("A1", "water"),)))
    shown = CliRunner().invoke(group, words.split())
    assert shown.exit_code == 0, shown.output
    assert "labos: No kernel runs this lab. Its last event was at 2025-06-15" in shown.stderr
    assert shown.stderr.count("\n") == 1
    store = open_store(f"sqlite:///{home / 'labos.db'}", create=False)
    try:
        store.claim(store.head().lab, "test", 30.0)
        assert "No kernel" not in CliRunner().invoke(group, words.split()).stderr, "one lives"
    finally:
        store.close()


@pytest.mark.usefixtures("ask")
def test_nodes_the_inbox_and_locations_are_told_as_they_were_last_known(home: Path) -> None:
    told = CliRunner().invoke(group, ["nodes", "--json"])
    nodes = {node["module"]: node for node in json.loads(told.stdout)}
    assert nodes["rpl/sealer"]["driver"] == "a4s_sealer"
    asked = InterventionRequested(InterventionId("I1"), PlannedWork.KIND, "R2", "Put in foil", ())
    append(home, asked)
    assert "Put in foil" in CliRunner().invoke(group, ["inbox"]).stdout
    assert "sealer.default" in CliRunner().invoke(group, ["locations", "pf400"]).stdout
    nobody = CliRunner().invoke(group, ["locations", "nobody"])
    assert isinstance(nobody.exception, NotFound)


def test_why_a_run_was_cancelled_is_told_wherever_the_run_is(ask: Ask, home: Path) -> None:
    like = next(e.event for e in two_users().entries if isinstance(e.event, RunSubmitted))
    for name in ("R7", "R8"):
        append(home, msgspec.structs.replace(like, run=RunId(name)))
    append(home, RunCancelled(RunId("R7"), "wrong plate"))
    append(home, RunStarted(RunId("R8")), RunCancelling(RunId("R8"), reason="a spill"))
    assert "Why: wrong plate" in ask("runs", "R7").stdout
    assert ask("runs").stdout.count("wrong plate") == 1
    assert "It was cancelled: wrong plate" in ask("explain", "R7").stdout
    assert "cancelled: wrong plate" in ask("log", "--run", "R7").stdout
    assert "it is cancelling: a spill" in ask("explain", "R8").stdout
    append(home, RunCancelled(RunId("R8")))
    assert "It was cancelled: a spill" in ask("explain", "R8").stdout
    assert json.loads(ask("runs", "R8", "--json").stdout)["why"] == "a spill"


def test_an_experiment_is_explained_run_by_run(ask: Ask, home: Path) -> None:
    append(home, ExperimentStarted(ExperimentId("E1"), "colours", "bo"))
    assert "It has no active" in ask("explain", "E1").stdout
    like = next(e.event for e in two_users().entries if isinstance(e.event, RunSubmitted))
    append(home, msgspec.structs.replace(like, run=RunId("R7"), experiment=ExperimentId("E1")))
    told = ask("explain", "E1").stdout
    assert told.startswith("E1 (colours, bo) is open.\nR7 (")
    assert "no kernel runs this lab now" in told
    assert ask("runs", "E1").stdout.splitlines()[1].startswith("R7")
    found = json.loads(ask("explain", "E1", "--json").stdout)
    assert [one["run"]["id"] for one in found["runs"]] == ["R7"]

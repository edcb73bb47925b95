"""The growth assay from start to end, on simulated workcells at scaled time."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from labos.bootstrap import LabThread, descriptions
from labos.client import LabClient
from labos.core.decide.experiments import LoseExperiment
from labos.core.decide.interventions import ResolveIntervention
from labos.core.ids import ExperimentId
from labos.core.registry import decode
from labos.errors import LabosError
from labos.node.world import World
from labos.settings import Settings
from labos.spec import find_spec, load_workcell
from labos_drivers._growth import IC50_MG_PER_L
from labos_drivers.hidex import simulator
from tests.apps.growth import APP, table
from tests.apps.support import cancel_at, says_the_same_again, until_clean
from tests.apps.virtual_lab import VirtualExperiment, VirtualLab
from tests.support.lab_process import until
from tests.unit.test_growth_analysis import TOLERANCE

pytest.importorskip("scipy")
pytest.importorskip("matplotlib")

import growth_analysis
import growth_assay

TRUTH = IC50_MG_PER_L["tetracycline"]
SPEED = 8000.0

MESSAGES_NS = 0.5e9
"""A step ends by the clock of its node; the log knows of it a little later."""


@contextmanager
def lab_of(cell: str, home: Path) -> Iterator[LabThread]:
    workcell = load_workcell(find_spec("workcells", cell), descriptions())
    with LabThread(Settings.make(home, simulate=True, speed=SPEED), [workcell], nodes="processes") as lab:
        yield lab


@pytest.mark.slow
def test_on_bio(tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    """Three plates, as one calls the program: they interleave, the curve is found, and the data is where the
    last line says."""
    with lab_of("bio", tmp_path / "lab") as lab:
        out = tmp_path / "out"
        words = ["--url", lab.url, "--workcell", "bio", "--plates", "3", "--out", str(out)]
        monkeypatch.setattr(sys, "argv", ["growth_assay", *words])
        assert growth_assay.main() == 0
        told = capsys.readouterr().out
        with LabClient(lab.url) as client:
            runs = [client.status(f"R{number}") for number in range(1, 7)]

            def resume() -> str:
                monkeypatch.setattr(sys, "argv", ["growth_assay", *words, "--resume", "E1"])
                assert growth_assay.main() == 0
                return capsys.readouterr().out

            says_the_same_again(client, resume, told)
            kinds = {note["payload"]["kind"] for note in client.events(type="experiment.noted")}
            leaves_the_bench_clean(client, World(str(lab.runtime.settings.world("bio"))))
    assert "growth assay: IC50 0.9" in told or "growth assay: IC50 0.8" in told
    assert told.rstrip().endswith(str(out / "E1" / "index.html"))
    assert "experiment E1 in the lab's log" in told
    assert kinds == {"loop_started", "loop_ended", "local_compute", "publication"}
    folder = out / "E1"
    assert (folder / "growth.png").read_bytes().startswith(b"\x89PNG")
    assert "data:image/png;base64," in (folder / "index.html").read_text()
    data = json.loads((folder / "readings.json").read_text())
    assert data["curve"]["ic50"] == pytest.approx(TRUTH, rel=TOLERANCE)
    made = [run for run in runs if run.workflow == "create_plate"]
    read = {str(run.id): run for run in runs if run.workflow == "read_plate"}
    assert len(made) == len(read) == 3
    ended = {
        run.id: step.ended_at for run in made for step in run.steps if step.key.endswith("Into incubator")
    }
    taken = sorted(
        step.requested_at
        for run in read.values()
        for step in run.steps
        if step.key.endswith("Out of incubator")
    )
    twelve_h = 12 * 3600 * 1e9 / SPEED
    for warm, cold in zip(sorted(ended.values()), taken, strict=True):
        assert cold - warm >= twelve_h - MESSAGES_NS
    assert max(ended.values()) < min(taken), "the plates grew side by side"
    world = World(str(lab.runtime.settings.world("bio")))
    assert (len(world.motions("incubate")), world.crashes()) == (3, [])


def leaves_the_bench_clean(client: LabClient, world: World) -> None:
    """A run that is cancelled while its plate stands in the liquid handler."""
    run = client.submit(APP / "bio" / "create_plate.yaml", {"slot": 9}, user="bo", workcell="bio")
    until(lambda: any(s.key == "Pipette" and s.requested_at for s in client.status(run).steps), "it pipettes")
    client.cancel(run, "bo")
    assert client.wait(run).status == "cancelled"
    assert {place.partition(".")[0] for place in world.list_contents() if not place.startswith("lid:")} == {
        "platecrane"
    }


@pytest.mark.slow
@pytest.mark.parametrize("cell", ["rpl_growth", "bio"])
def test_a_cancelled_assay_leaves_no_plate_on_the_bench(tmp_path: Path, cell: str) -> None:
    """Cancelled while its second plate goes into the incubator, where the first stands."""
    where = cell.partition("_")[0]
    with lab_of(cell, tmp_path / "lab") as lab, LabClient(lab.url) as client:
        raised = cancel_at(
            client,
            lambda: growth_assay.assay(client, "ada", where, tmp_path / "out", plates=2),
            "load_plate",
            count=2,
        )
        assert isinstance(raised, LabosError)
        until_clean(client)
        ends = {run.workflow: run.status for run in map(client.status, run_ids(client))}
        world = World(str(lab.runtime.settings.world(where)))
        places = {place.partition(".")[0] for place in world.list_contents() if not place.startswith("lid:")}
    assert ends["clear_incubator"] == "completed"
    assert places <= {"sciclops", "platecrane"}, "only fresh plates are left"
    assert world.crashes() == []
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_after_its_program_was_killed_plates_leave_the_incubator_if_a_person_says_so() -> None:
    """Only the slots that hold a plate are asked for one."""
    with VirtualLab("rpl_growth", 3) as lab:
        closing = APP / "rpl" / "clear_incubator.yaml"
        experiment = VirtualExperiment(lab, "growth assay", "bo", closing=closing, slots=[1, 2, 3, 4, 5])
        payloads = [{"slot": 2}, {"slot": 5}]
        runs = experiment.submit_all(APP / "rpl" / "create_plate.yaml", payloads)
        lab.wait(lambda: all(lab.is_over(run) for run in runs))
        assert lab.kernel is not None
        state = lab.kernel.state
        lab.execute(LoseExperiment(ExperimentId(experiment.id), "no heartbeat"))
        (asked,) = state.interventions.open.values()
        lab.execute(ResolveIntervention(asked.id, "close", "bo"))
        lab.wait(lambda: not state.experiments.open)
        closed = lab.runs()[-1]
        assert (closed.workflow, closed.succeeded) == ("clear_incubator", True)
        assert [step.key.split("[")[1].partition("]")[0] for step in closed.steps] == ["2", "2", "5", "5"]
        assert not [place for place in lab.world.list_contents() if place.startswith("liconic")]
        assert lab.world.crashes() == []


def run_ids(client: LabClient) -> list[str]:
    return [event["payload"]["run"] for event in client.events(type="run.submitted")]


@pytest.mark.slow
def test_a_reading_that_overflows_is_asked_about_with_its_table(monkeypatch: pytest.MonkeyPatch) -> None:
    """A reader that can see next to nothing; then it is mended, and the plate is read again."""
    monkeypatch.setattr(simulator, "HIGHEST_OD", 0.02)
    with VirtualLab("rpl_growth", 3) as lab:
        experiment = VirtualExperiment(lab, "growth assay", "bo")
        (run,) = experiment.submit_all(APP / "rpl" / "create_plate.yaml", [{"slot": 1}])
        assert lab.kernel is not None
        open_ = lab.kernel.state.interventions.open
        lab.wait(lambda: bool(open_))
        (asked,) = open_.values()
        assert (asked.kind, asked.run) == ("failed_step", run)
        assert "expected len(result.overflow) == 0" in asked.text
        monkeypatch.setattr(simulator, "HIGHEST_OD", 4.0)
        lab.execute(ResolveIntervention(asked.id, "retry", "bo"))
        lab.wait(lambda: lab.is_over(run))
        result = lab.status(run)
    read = [decode(r.head.type, r.head.schema, r.payload) for r in lab.store.records]
    tables = [
        e.result for e in read if type(e).__name__ == "ActionSucceeded" and e.result and "wells" in e.result
    ]  # type: ignore[attr-defined]
    assert [len(table["overflow"]) for table in tables] == [96, 0], "both tables are in the log"
    assert set(tables[0]["wells"].values()) == {None}
    assert result.succeeded
    assert result.result("Read T0")["overflow"] == []


@pytest.mark.full
def test_ten_plates_interleave_on_rpl(tmp_path: Path) -> None:
    with lab_of("rpl_growth", tmp_path / "lab") as lab, LabClient(lab.url) as client:
        found = growth_assay.assay(client, "bo", "rpl", tmp_path / "out", plates=10)
        steps = [step for run in run_ids(client) for step in client.status(run).steps]
        world = World(str(lab.runtime.settings.world("rpl")))
    into = [step.ended_at for step in steps if step.key.endswith("Into incubator")]
    out = [step.requested_at for step in steps if step.key.endswith("Out of incubator")]
    assert (len(into), len(out), max(into) < min(out)) == (10, 10, True), "ten plates grow at once"
    assert world.crashes() == []
    assert (found.plates, found.bad) == (10, [])
    assert found.curve.ic50 == pytest.approx(TRUTH, rel=TOLERANCE)


class Noted:
    """Keeps what an application has told the log."""

    def __init__(self) -> None:
        self.notes: list[tuple[str, str, Mapping[str, Any]]] = []

    def note(self, kind: str, name: str, **facts: Any) -> None:
        self.notes.append((kind, name, facts))


def test_a_plate_with_a_bad_reading_is_left_out_and_told_with_its_table() -> None:
    overflown = table((12.0, 37.0), seed=4)
    overflown["wells"]["D7"], overflown["overflow"] = None, ["D7"]
    experiment = Noted()
    tables = [("R1", table(), table((12.0, 37.0), seed=2)), ("R2", table(seed=3), overflown)]
    good, bad = growth_assay._sorted_out(experiment, tables)  # type: ignore[arg-type]
    assert len(good) == 1
    assert bad == ["R2 at T12: 1 of 96 wells have no value: D7."]
    ((kind, name, facts),) = experiment.notes
    assert (kind, name) == ("condition_checked", "readings can be used")
    assert facts["error"] == "experiment"
    assert facts["tables"]["T12"] == overflown
    assert growth_analysis.fit([good[0][0]], [good[0][1]]).ic50 == pytest.approx(TRUTH, rel=TOLERANCE)


def test_the_workcells_files_are_those_that_the_program_names() -> None:
    for cell in ("rpl", "bio"):
        assert {path.name for path in (APP / cell).glob("*.yaml")} == {
            *(
                "create_plate.yaml",
                "read_plate.yaml",
                "get_plate.yaml",
                "incubate.yaml",
                "take_out.yaml",
                "throw_away.yaml",
                "clear_incubator.yaml",
                "way_out.yaml",
            )
        }

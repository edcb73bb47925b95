"""Flows and transfers of an experiment: what the log says of them, and that they are not done twice."""

from __future__ import annotations

import contextlib
import hashlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import fsspec
import pytest

from labos.bootstrap import LabThread, descriptions
from labos.client import (
    Experiment,
    Flow,
    FlowFailed,
    FlowStep,
    LabClient,
    ReplayMismatch,
    TransferFailed,
)
from labos.client._transfers import show_place
from labos.errors import BadInput
from labos.settings import Settings
from labos.spec import find_spec, load_workcell

CONTENT = b"well,value\nA1,0.5\n"
SHA256 = hashlib.sha256(CONTENT).hexdigest()


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Iterator[LabClient]:
    cell = load_workcell(find_spec("workcells", "rpl"), descriptions())
    settings = Settings.make(tmp_path_factory.mktemp("lab"), speed=5000.0, simulate=True)
    with LabThread(settings, [cell], nodes="none") as running, LabClient(running.url) as found:
        yield found


class Stopped(KeyboardInterrupt):
    """Where a program is interrupted."""


class Line:
    """The functions of a flow, which count how often they are called."""

    def __init__(self, fails: int = 0, *, stops: bool = False) -> None:
        self.calls: list[str] = []
        self.fails, self.stops = fails, stops

    def extract(self, state: dict[str, Any]) -> list[float]:
        self.calls.append("extract")
        return [2.0 * value for value in state["input"]["values"]]

    def fit(self, state: dict[str, Any]) -> float:
        self.calls.append("fit")
        if self.stops:
            raise Stopped
        if self.fails:
            self.fails -= 1
            raise OSError("the cluster is away")
        return sum(state["extract"])

    def flow(self, attempts: int = 3) -> Flow:
        steps = [
            FlowStep("extract", self.extract),
            FlowStep("fit", self.fit, attempts=attempts, wait_s=0.01),
        ]
        return Flow("analyse", steps)


def begin_program(lab: LabClient, work: Any) -> str:
    """Let a program run until it is interrupted; returns its experiment."""
    with contextlib.suppress(Stopped), Experiment(lab, "plates", "ada") as experiment:
        work(experiment)
        raise Stopped
    return experiment.id


def notes(lab: LabClient, experiment: str, kind: str) -> list[dict[str, Any]]:
    found = (event["payload"] for event in lab.events(type="experiment.noted", stream=experiment))
    return [note["facts"] for note in found if note["kind"] == kind]


# -- flows ----------------------------------------------------------------------------------------


def test_a_flow_goes_through_its_steps_and_tries_again(lab: LabClient) -> None:
    line = Line(fails=2)
    with Experiment(lab, "plates", "ada") as experiment:
        result = experiment.run_flow(line.flow(), values=[1.0, 2.0])
    assert (result.status, result.state["extract"], result.state["fit"]) == ("succeeded", [2.0, 4.0], 6.0)
    assert line.calls == ["extract", "fit", "fit", "fit"]
    told = notes(lab, experiment.id, "flow")
    assert [note["state"] for note in told] == ["started", "retrying", "retrying", "succeeded"]
    assert told[1]["error"] == "OSError: the cluster is away"
    assert {note["flow_id"] for note in told} == {"flow analyse#1"}
    assert len(notes(lab, experiment.id, "local_compute")) == 4


def test_a_flow_that_fails_says_at_which_step(lab: LabClient) -> None:
    with Experiment(lab, "plates", "ada") as experiment:
        with pytest.raises(FlowFailed, match="Step 'fit' of the flow 'analyse' failed: OSError: the cluster"):
            experiment.run_flow(Line(fails=2).flow(2), values=[1.0])
        result = experiment.run_flow(Line(fails=1).flow(1), check=False, values=[1.0])
    assert (result.status, result.step, result.state["extract"]) == ("failed", "fit", [2.0])
    assert notes(lab, experiment.id, "flow")[-1]["state"] == "failed"


def test_a_flow_goes_on_at_the_step_at_which_it_was(lab: LabClient) -> None:
    killed, later, last = Line(stops=True), Line(), Line()
    name = begin_program(lab, lambda experiment: experiment.run_flow(killed.flow(), values=[1.0]))
    with contextlib.suppress(Stopped), Experiment(lab, "plates", "ada", resume=name) as experiment:
        result = experiment.run_flow(later.flow(), values=[1.0])
        raise Stopped
    assert (killed.calls, later.calls) == (["extract", "fit"], ["fit"])
    with Experiment(lab, "plates", "ada", resume=name) as experiment:
        assert experiment.run_flow(last.flow(), values=[1.0]) == result
    assert last.calls == []
    with pytest.raises(ReplayMismatch), Experiment(lab, "plates", "ada", resume=name) as experiment:
        experiment.run_flow(Flow("analyse", [FlowStep("fit", last.fit)]), values=[1.0])
    with pytest.raises(ReplayMismatch), Experiment(lab, "plates", "ada", resume=name) as experiment:
        experiment.run_flow(last.flow(), values=[2.0])


def test_a_flow_that_cannot_be_is_refused() -> None:
    step = FlowStep("fit", Line().fit)
    for steps in ([], [step, step], [FlowStep("input", Line().fit)]):
        with pytest.raises(BadInput, match="two steps with the same name"):
            Flow("analyse", steps)
    with pytest.raises(BadInput, match="has no attempts"):
        Flow("analyse", [FlowStep("fit", Line().fit, attempts=0)])


# -- transfers ------------------------------------------------------------------------------------


def test_a_file_is_transferred_with_its_digest(lab: LabClient, tmp_path: Path) -> None:
    (tmp_path / "here.csv").write_bytes(CONTENT)
    with Experiment(lab, "plates", "ada") as experiment:
        done = experiment.transfer(tmp_path / "here.csv", "memory://archive/plates/there.csv")
        kept = experiment.keep_file(CONTENT)
        experiment.transfer({"sha256": kept}, tmp_path / "new folder" / "back.csv")
    assert (done.sha256, done.bytes) == (SHA256, len(CONTENT))
    assert fsspec.filesystem("memory").cat("/archive/plates/there.csv") == CONTENT
    assert [file.name for file in (tmp_path / "new folder").iterdir()] == ["back.csv"]
    first, second = notes(lab, experiment.id, "transfer")
    assert (first["source"], first["target"]) == (
        str(tmp_path / "here.csv"),
        "memory://archive/plates/there.csv",
    )
    assert (first["sha256"], second["source"]) == (SHA256, f"lab:{SHA256}")


def test_what_was_transferred_is_not_transferred_again(lab: LabClient, tmp_path: Path) -> None:
    here, there = tmp_path / "here.csv", tmp_path / "there.csv"
    here.write_bytes(CONTENT)
    name = begin_program(lab, lambda experiment: experiment.transfer(here, there))
    there.unlink()
    here.unlink()
    with Experiment(lab, "plates", "ada", resume=name) as experiment:
        assert experiment.transfer(here, there).sha256 == SHA256
        assert not there.exists()
    elsewhere = tmp_path / "elsewhere.csv"
    with (
        pytest.raises(ReplayMismatch, match="elsewhere"),
        Experiment(lab, "plates", "ada", resume=name) as experiment,
    ):
        experiment.transfer(elsewhere, there)


def test_what_cannot_be_transferred_is_said_and_may_be_tried_again(lab: LabClient, tmp_path: Path) -> None:
    here, there = tmp_path / "here.csv", tmp_path / "there.csv"
    with Experiment(lab, "plates", "ada") as experiment:
        with pytest.raises(TransferFailed, match=r"here\.csv was not transferred"):
            experiment.transfer(here, there)
        with pytest.raises(TransferFailed, match="Protocol not known"):
            experiment.transfer(here, "moon://crater/other.csv")
        here.write_bytes(CONTENT)
        experiment.transfer(here, there)
    assert there.read_bytes() == CONTENT
    (note,) = lab.events(type="experiment.noted", stream=experiment.id)
    assert note["payload"]["key"] == "transfer there.csv#1"


@pytest.mark.parametrize(
    ("place", "is_shown"),
    [
        ("sftp://ada:secret@host:22/a.csv", "sftp://host:22/a.csv"),
        ("https://store/a.csv?X-Signature=abc#part", "https://store/a.csv"),
        ("s3://bucket/a.csv", "s3://bucket/a.csv"),
    ],
)
def test_no_secret_is_written_into_the_log(place: str, is_shown: str) -> None:
    assert show_place(place) == is_shown

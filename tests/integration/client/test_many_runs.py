"""Many runs at once, their results as tables, and progress: against a lab with one reader."""

from __future__ import annotations

import contextlib
import csv
import io
import os
import pty
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import numpy
import pandas
import pytest

from labos.cli.app import main
from labos.client import Experiment, LabClient, RunFailed
from labos.client._batches import MOST_RUNS
from labos.client._results import RunResult
from labos.client._runs import MOST_STREAMS
from labos.errors import BadInput, KeyReused, NotFound
from tests.support.reading import WORKFLOW, open_reading_lab

READ = {"text": WORKFLOW, "name": "read.yaml"}


@pytest.fixture(scope="module")
def home(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("reading") / "lab"


@pytest.fixture(scope="module")
def lab(home: Path) -> Iterator[LabClient]:
    with open_reading_lab(home.parent) as running, LabClient(running.url) as client:
        client.place("hidex.default", "plate96", "ada")
        client.give("P1", "shared", "ada")
        yield client


def test_runs_come_in_the_order_in_which_they_end(lab: LabClient) -> None:
    runs = lab.submit_all(READ, [{"assay": f"A{n}"} for n in range(4)], user="ada")
    results = list(lab.as_completed(reversed(runs), timeout_s=60))
    assert sorted(result.id for result in results) == sorted(runs)
    assert [result.ended_at for result in results] == sorted(result.ended_at for result in results)
    assert all(result.succeeded for result in results)
    again = [result.id for result in lab.as_completed(runs, timeout_s=0)]
    assert again == [result.id for result in results]


def test_one_question_waits_for_all(lab: LabClient, monkeypatch: pytest.MonkeyPatch) -> None:
    lab.control("pause", "lab", "ada")
    runs = lab.submit_all(READ, [{}] * (MOST_STREAMS + 2), user="ada")
    asked = listen_to(lab, monkeypatch)
    ended = lab.as_completed(runs, timeout_s=60)
    lab.cancel(runs[7], "ada")
    assert next(ended).id == runs[7]
    assert len([path for path in asked if path.startswith("/runs/")]) == 2  # to cancel it, and what it gave
    for run in runs:
        if run != runs[7]:
            lab.cancel(run, "ada")
    lab.control("resume", "lab", "ada")
    assert {result.status for result in ended} == {"cancelled"}


def test_a_request_that_is_repeated_is_the_same_runs(lab: LabClient) -> None:
    first = lab.submit_all(READ, [{}], user="ada", request="night")
    assert lab.submit_all(READ, [{}, {"assay": "late"}], user="ada", request="night")[:1] == first
    assert len(list(lab.as_completed(first))) == 1


def test_many_runs_are_one_request_and_one_commit(lab: LabClient, monkeypatch: pytest.MonkeyPatch) -> None:
    asked = listen_to(lab, monkeypatch)
    lab.control("pause", "lab", "ada")
    before = lab.health()["position"]
    runs = lab.submit_all(READ, [{"assay": f"A{n}"} for n in range(MOST_RUNS + 3)], user="ada")
    assert [path for path in asked if path.startswith("/runs")] == ["/runs/batch"] * 2
    found = list(lab.events(before, type="run.submitted"))
    assert [event["stream"] for event in found] == runs
    assert [event["payload"]["payload"]["assay"] for event in found] == [f"A{n}" for n in range(len(runs))]
    causes = {event["causation"] for event in found}
    assert len(causes) <= 4, "each command's first event is the cause of its others"
    for run in runs:
        lab.cancel(run, "ada")
    lab.control("resume", "lab", "ada")


def test_an_error_names_the_payload_and_nothing_is_submitted(lab: LabClient) -> None:
    before = lab.health()["position"]
    with pytest.raises(BadInput, match=r"payloads\[1\]: .*assay"):
        lab.submit_all(READ, [{"assay": "A"}, {"assay": [1]}, {}], user="ada")
    with pytest.raises(BadInput, match=r"payloads\[2\]"):
        lab.submit_all(READ, [{}, {}, {"text": "x" * 60_000}], user="ada")
    assert list(lab.events(before, type="run.submitted")) == []
    assert lab.submit_all(READ, [], user="ada") == []


def test_another_payload_under_a_key_is_refused_before_any_run(lab: LabClient) -> None:
    lab.submit_all(READ, [{}, {"assay": "B"}], user="ada", request="week")
    before = lab.health()["position"]
    with pytest.raises(KeyReused, match=r"payloads\[1\]: The key 'week-1'"):
        lab.submit_all(READ, [{}, {"assay": "C"}, {}], user="ada", request="week")
    assert [event["type"] for event in lab.events(before, type="run.submitted")] == []


def test_each_payload_brings_the_files_that_it_names(lab: LabClient, tmp_path: Path) -> None:
    """The same key is the same run, with whichever others it is asked for."""
    (tmp_path / "read.yaml").write_text(WORKFLOW)
    for name in ("a.txt", "b.txt"):
        (tmp_path / name).write_text(name)
    payloads = [{"assay": "a.txt"}, {"assay": "b.txt"}, {}]
    apart = [
        lab.submit(tmp_path / "read.yaml", payload, user="ada", request=f"files-{number}")
        for number, payload in enumerate(payloads)
    ]
    assert lab.submit_all(tmp_path / "read.yaml", payloads, user="ada", request="files") == apart
    assert lab.submit_all(tmp_path / "read.yaml", payloads[:2], user="ada", request="files") == apart[:2]
    list(lab.as_completed(apart))


def listen_to(lab: LabClient, monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """The paths that the client asks for from now on."""
    asked: list[str] = []
    request = lab._request

    def listen(method: str, path: str, **options: object) -> object:
        asked.append(path)
        return request(method, path, **options)  # type: ignore[arg-type]

    monkeypatch.setattr(lab, "_request", listen)
    return asked


def test_what_never_was_is_not_waited_for(lab: LabClient) -> None:
    with pytest.raises(NotFound, match="R999"):
        list(lab.as_completed(["R999"]))
    assert list(lab.as_completed([])) == []


def test_what_does_not_end_in_time_is_said(lab: LabClient) -> None:
    lab.control("pause", "lab", "ada")
    run = lab.submit(READ, user="ada")
    with pytest.raises(TimeoutError, match="1 run"):
        list(lab.as_completed([run], timeout_s=0.05))
    lab.cancel(run, "ada")
    lab.control("resume", "lab", "ada")


def test_an_experiment_waits_for_its_runs(lab: LabClient) -> None:
    with Experiment(lab, "plates", "ada") as experiment:
        runs = experiment.submit_all(READ, [{}, {}])  # type: ignore[arg-type]
        assert {result.experiment for result in experiment.as_completed(runs)} == {experiment.id}
        lost = lab.submit(READ, user="ada", experiment=experiment.id)
        lab.cancel(lost, "ada")
        with pytest.raises(RunFailed):
            list(experiment.as_completed([lost]))


def test_a_module_may_be_named_with_its_workcell(lab: LabClient) -> None:
    lab.take_out("reading/hidex", "cleaning", "ada")
    assert lab.state(waits=False)["modules"][0]["out_of_service"] is not None
    lab.put_back("reading/hidex", "ada")
    assert lab.actions("reading/hidex")["module"] == "reading/hidex"


def test_what_is_left_out_of_a_change_stays(lab: LabClient) -> None:
    begins = lab.state(waits=False)["now"] + 10**15
    booked = lab.book("hidex", begins, begins + 10**12, "ada", why="course")
    changed = lab.change_booking(booked["id"], "ada", ends_at=begins + 2 * 10**12)
    assert (changed["why"], changed["begins_at"]) == ("course", begins)
    lab.cancel_booking(booked["id"], "ada")


def test_numbers_of_numpy_are_numbers(lab: LabClient) -> None:
    with Experiment(lab, "plates", "ada") as experiment:
        experiment.note("decision", "best", mean=numpy.float64(0.5), wells=numpy.array([1, 2]), of={"A1"})
        with pytest.raises(BadInput, match="type object cannot be sent"):
            experiment.note("decision", "best", of=object())
    (noted,) = lab.events(type="experiment.noted", stream=experiment.id)
    assert noted["payload"]["facts"] == {"mean": 0.5, "wells": [1, 2], "of": ["A1"]}


def test_results_are_a_table(
    lab: LabClient, home: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    result = lab.run(READ, user="ada")
    text = result.to_csv(tmp_path / "wells.csv")
    assert (tmp_path / "wells.csv").read_text() == text
    assert main(["results", result.id, "--csv", "--home", str(home)]) == 0
    assert capsys.readouterr().out == text
    frame = result.to_frame()
    assert len(frame) == 96
    assert frame["time"].dt.tz is not None
    wells = result.result("Read")["wells"]
    assert dict(zip(frame["well"], frame["value"], strict=True)) == wells
    read = pandas.read_csv(io.StringIO(text))
    assert list(read.columns) == list(frame.columns) == next(csv.reader(io.StringIO(text)))


def test_an_empty_table_has_its_columns(lab: LabClient) -> None:
    run = lab.submit(READ, user="ada")
    lab.cancel(run, "ada")
    result = lab.wait(run)
    if not result.readings():
        assert result.to_csv().count("\n") == 1
        assert result.to_frame().empty


def test_a_result_from_nowhere_says_so() -> None:
    with pytest.raises(BadInput, match="did not come from a lab"):
        RunResult("R1", "read", "ada", "completed").to_csv()


PROGRAM = """
import sys
from labos.client import LabClient
with LabClient(sys.argv[1]) as lab:
    print(lab.run({"text": sys.argv[2], "name": "read.yaml"}, user="ada", progress=True).status)
"""


def test_progress_is_shown_in_a_terminal(lab: LabClient) -> None:
    reads, writes = pty.openpty()
    words = [sys.executable, "-c", PROGRAM, lab._url, WORKFLOW]
    process = subprocess.Popen(words, stdout=subprocess.PIPE, stderr=writes, text=True)
    os.close(writes)
    shown = b""
    with contextlib.suppress(OSError):  # the program has ended: nobody has the terminal any more
        while piece := os.read(reads, 4096):
            shown += piece
    os.close(reads)
    assert process.communicate(timeout=60)[0] == "completed\n"
    assert b"3 of 3 steps" in shown
    assert b"read completed" in shown


def test_nothing_is_shown_where_nobody_looks(lab: LabClient) -> None:
    words = [sys.executable, "-c", PROGRAM, lab._url, WORKFLOW]
    done = subprocess.run(words, capture_output=True, text=True, check=True)
    assert (done.stdout, done.stderr) == ("completed\n", "")

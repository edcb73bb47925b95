"""A program that was interrupted and started again: what it asks for a second time comes from the log.

Interrupted here means that its block is left by KeyboardInterrupt, which leaves the experiment as a kill
does; programs that are killed are in tests/system/test_resume.py.
"""

from __future__ import annotations

import asyncio
import contextlib
import time
from collections.abc import Iterator
from typing import Any

import numpy
import pytest

from labos.client import (
    AsyncExperiment,
    AsyncLabClient,
    Experiment,
    LabClient,
    LabUnreachable,
    ReplayMismatch,
    RunFailed,
)
from labos.errors import BadInput, NotFound, Refused
from labos.services.compute import ComputeFailed
from tests.integration.client import computations as work
from tests.support.reading import WORKFLOW, open_reading_lab

READ = {"text": WORKFLOW, "name": "read.yaml"}


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Iterator[LabClient]:
    folder = tmp_path_factory.mktemp("reading")
    with open_reading_lab(folder) as running, LabClient(running.url) as client:
        client.place("hidex.default", "plate96", "ada")
        client.give("P1", "shared", "ada")
        yield client


class Stopped(KeyboardInterrupt):
    """Where a program is interrupted."""


def begin_program(lab: LabClient, work: Any, **options: Any) -> str:
    """Let a program run until it is interrupted; returns its experiment."""
    with contextlib.suppress(Stopped), Experiment(lab, "plates", "ada", **options) as experiment:
        work(experiment)
        raise Stopped
    return experiment.id


def again(lab: LabClient, name: str) -> Experiment:
    return Experiment(lab, "plates", "ada", resume=name)


def events(lab: LabClient, experiment: str, kind: str) -> list[dict[str, Any]]:
    return [event["payload"] for event in lab.events(type=kind, correlation=experiment)]


def read_twice(experiment: Experiment) -> list[Any]:
    """All that an application asks for, in a loop."""
    found: list[Any] = []
    with experiment.loop("assays", rounds=2) as loop:
        for number in range(2):
            noise = experiment.random.random()
            assay = experiment.decide("assay", lambda n=number: (f"A{n}", time.monotonic_ns()))
            result = experiment.run(READ, {"assay": assay[0]})
            square = experiment.compute(work.square, float(number), where="local")
            drawn = float(experiment.numpy_random.random())
            enough = loop.check("enough", number == 1, noise=noise)
            found.append([noise, assay, result, square, drawn, enough])
        loop.report(rounds=2)
    return found


def test_everything_is_answered_from_the_log(lab: LabClient) -> None:
    first: list[Any] = []
    name = begin_program(lab, lambda experiment: first.extend(read_twice(experiment)))
    before = lab.health()["position"]
    with again(lab, name) as experiment:
        assert experiment.id == name
        assert read_twice(experiment) == first
        written = [event["type"] for event in lab.events(before, correlation=name)]
        assert written == ["experiment.resumed"]
        experiment.run(READ, {"assay": "A2"})
    assert len(events(lab, name, "run.submitted")) == 3
    assert [type(first[0][1]), first[0][1][0]] == [list, "A0"]


def test_it_goes_on_in_the_middle_of_a_loop(lab: LabClient) -> None:
    def half(experiment: Experiment) -> None:
        experiment.log_loop_start("assays", rounds=2)
        experiment.random.random()
        experiment.decide("assay", lambda: ("A0", 7))
        experiment.run(READ, {"assay": "A0"})

    name = begin_program(lab, half)
    with again(lab, name) as experiment:
        found = read_twice(experiment)
    assert found[0][1] == ["A0", 7]
    assert len(events(lab, name, "run.submitted")) == 2
    kinds = [note["kind"] for note in events(lab, name, "experiment.noted")]
    assert kinds == [
        "loop_started",
        "decision",
        "local_compute",
        "condition_checked",
        "decision",
        "local_compute",
        "condition_checked",
        "loop_ended",
    ]


def test_another_payload_is_refused_and_both_are_shown(lab: LabClient) -> None:
    name = begin_program(lab, lambda experiment: experiment.run(READ, {"assay": "OD590"}))
    with pytest.raises(ReplayMismatch) as caught, again(lab, name) as experiment:
        experiment.run(READ, {"assay": "OD600"})
    assert caught.value.recorded == {"assay": "OD590"}
    assert caught.value.now == {"assay": "OD600"}
    assert all(word in str(caught.value) for word in (name, "run read#1", "OD590", "OD600"))
    with again(lab, name) as experiment:  # it stayed open
        experiment.run(READ, {"assay": "OD590"})
    assert len(events(lab, name, "run.submitted")) == 1


def test_a_workflow_that_was_changed_is_another_one(lab: LabClient) -> None:
    name = begin_program(lab, lambda experiment: experiment.run(READ))
    changed = {**READ, "text": WORKFLOW.replace("OD590", "OD450")}
    with pytest.raises(ReplayMismatch, match="changed"), again(lab, name) as experiment:
        experiment.run(changed)
    lab.end_experiment(name, "ended", "ada")


def test_a_run_that_is_under_way_is_waited_for(lab: LabClient) -> None:
    lab.control("pause", "lab", "ada")
    name = begin_program(lab, lambda experiment: experiment.submit(READ))
    with again(lab, name) as experiment:
        run = experiment.submit(READ)
        lab.control("resume", "lab", "ada")
        assert [result.succeeded for result in experiment.as_completed([run])] == [True]
    assert len(events(lab, name, "run.submitted")) == 1


def test_a_run_that_failed_fails_again_without_a_run(lab: LabClient) -> None:
    def fail(experiment: Experiment) -> None:
        lab.control("pause", "lab", "ada")
        run = experiment.submit(READ, key="lost")
        lab.cancel(run, "ada")
        lab.control("resume", "lab", "ada")

    name = begin_program(lab, fail)
    with again(lab, name) as experiment, pytest.raises(RunFailed, match="cancelled"):
        experiment.run(READ, key="lost")
    assert len(events(lab, name, "run.submitted")) == 1


def test_a_key_finds_a_call_wherever_it_stands(lab: LabClient) -> None:
    def forwards(experiment: Experiment) -> None:
        for assay in ("A", "B"):
            experiment.submit(READ, {"assay": assay}, key=f"plate {assay}")

    name = begin_program(lab, forwards)
    with again(lab, name) as experiment:
        runs = [experiment.submit(READ, {"assay": assay}, key=f"plate {assay}") for assay in ("B", "A")]
        list(experiment.as_completed(runs))
    submitted = events(lab, name, "run.submitted")
    assert [payload["run"] for payload in submitted] == runs[::-1]


def test_those_of_many_that_were_submitted_are_not_submitted_again(lab: LabClient) -> None:
    """So were they left by an earlier LabOS, which submitted them one by one, if the program was killed."""

    def submit_two(experiment: Experiment) -> None:
        options = {"user": "ada", "experiment": experiment.id}
        for number in range(2):
            request = f"{experiment.id}/runs read#1-{number}"
            lab.submit(READ, {"assay": f"A{number}"}, request=request, **options)

    name = begin_program(lab, submit_two)
    with again(lab, name) as experiment:
        runs = experiment.submit_all(READ, [{"assay": f"A{n}"} for n in range(4)])  # type: ignore[arg-type]
        assert len(list(experiment.as_completed(runs))) == 4
    assert [payload["run"] for payload in events(lab, name, "run.submitted")] == runs


def test_many_that_were_submitted_are_known_again(lab: LabClient) -> None:
    payloads = [{"assay": f"A{n}"} for n in range(3)]
    first: list[str] = []
    name = begin_program(lab, lambda experiment: first.extend(experiment.submit_all(READ, payloads)))
    with again(lab, name) as experiment:
        assert experiment.submit_all(READ, payloads) == first  # type: ignore[arg-type]
        lab.wait(first[-1])
    with pytest.raises(ReplayMismatch, match="A2"), again(lab, name) as experiment:
        experiment.submit_all(READ, [*payloads[:2], {"assay": "other"}])  # type: ignore[arg-type]
    assert [payload["run"] for payload in events(lab, name, "run.submitted")] == first


def test_what_another_process_of_the_program_has_submitted_is_told(lab: LabClient) -> None:
    """A log that has grown since it was read: the lab knows the keys, and the program learns of it."""

    def submit_other(experiment: Experiment) -> None:
        request = f"{experiment.id}/runs read#1-1"
        lab.submit(READ, {"assay": "B"}, user="ada", experiment=experiment.id, request=request)
        with pytest.raises(ReplayMismatch, match="runs read#1"):
            experiment.submit_all(READ, [{"assay": "A"}, {"assay": "C"}])  # type: ignore[arg-type]

    name = begin_program(lab, submit_other)
    (left,) = events(lab, name, "run.submitted")
    assert lab.wait(left["run"]).succeeded
    lab.end_experiment(name, "ended", "ada")


def test_a_computation_with_other_arguments_is_told(lab: LabClient) -> None:
    pairs = [(1, 2), numpy.arange(3.0)]
    name = begin_program(lab, lambda experiment: experiment.compute(len, pairs, where="local"))
    with again(lab, name) as experiment:
        assert experiment.compute(len, [(1, 2), numpy.arange(3.0)], where="local") == 2
    name = begin_program(lab, lambda experiment: experiment.compute(work.square, 2.0, where="local"))
    with pytest.raises(ReplayMismatch, match=r"\(3\.0\)"), again(lab, name) as experiment:
        experiment.compute(work.square, 3.0, where="local")
    lab.end_experiment(name, "ended", "ada")


def test_what_a_computation_returned_or_raised_comes_again(lab: LabClient) -> None:
    def compute(experiment: Experiment) -> list[Any]:
        with pytest.raises(ComputeFailed, match=r"tried once.*ZeroDivisionError: division by zero"):
            experiment.compute(work.divide, 0, where="local")
        large = experiment.compute(work.spectrum, 9000, where="local")
        return [experiment.compute(work.pair, 1, where="local"), large]

    first: list[Any] = []
    name = begin_program(lab, lambda experiment: first.extend(compute(experiment)))
    with again(lab, name) as experiment:
        assert compute(experiment) == first
    assert first[0] == (1, 2)
    assert len(events(lab, name, "experiment.noted")) == 3


def test_a_decision_may_be_large_and_must_be_json(lab: LabClient) -> None:
    name = begin_program(lab, lambda experiment: experiment.decide("grid", lambda: numpy.arange(9000)))
    with again(lab, name) as experiment:
        assert experiment.decide("grid", lambda: 0) == list(range(9000))
        with pytest.raises(BadInput, match="cannot be written"):
            experiment.decide("limit", lambda: float("inf"))
        with pytest.raises(BadInput, match="needs a function"):
            experiment.decide("limit", 3)  # type: ignore[arg-type]


def test_a_program_that_goes_another_way_is_told_and_a_time_may_differ(lab: LabClient) -> None:
    def tell(experiment: Experiment, met: bool) -> None:
        experiment.log_local_compute("fit", seconds=time.monotonic())
        experiment.log_check("enough", met)

    name = begin_program(lab, lambda experiment: tell(experiment, False))
    with pytest.raises(ReplayMismatch, match='"result":false'), again(lab, name) as experiment:
        tell(experiment, True)
    with again(lab, name) as experiment:
        tell(experiment, False)
    assert len(events(lab, name, "experiment.noted")) == 2


def test_what_the_killed_program_told_at_last_holds(lab: LabClient) -> None:
    """Its last word reached the lab after the log was read."""
    name = begin_program(lab, lambda experiment: None)
    with again(lab, name) as experiment:
        lab.note(name, "decision", "next", {"value": 1}, "ada", key="decision next#1")
        assert experiment.decide("next", lambda: 2) == 1
        lab.submit(
            READ, {"assay": "A"}, user="ada", experiment=name, workcell="", request=f"{name}/run read#1"
        )
        with pytest.raises(ReplayMismatch, match='"B"'):
            experiment.run(READ, {"assay": "B"})
        experiment.run(READ, {"assay": "A"}, key="other")
    assert [note["facts"] for note in events(lab, name, "experiment.noted")] == [{"value": 1}]


def test_one_that_has_ended_can_be_read_again_but_does_nothing(lab: LabClient) -> None:
    with Experiment(lab, "plates", "ada") as experiment:
        first = read_twice(experiment)
        kept = experiment.keep_file(b"a table")
    before = lab.health()["position"]
    with again(lab, experiment.id) as ended:
        assert read_twice(ended) == first
        assert ended.keep_file(b"a table") == kept
        with pytest.raises(NotFound, match="not ended"):
            ended.keep_file(b"another table")
        with pytest.raises(Refused, match="is not open"):
            ended.run(READ)
    assert lab.health()["position"] == before


def test_what_cannot_be_resumed_is_said(lab: LabClient) -> None:
    with pytest.raises(NotFound, match="no experiment 'E99'"), again(lab, "E99"):
        pass
    name = begin_program(lab, lambda experiment: None)
    with (
        pytest.raises(Refused, match="is 'plates', not 'growth'"),
        Experiment(lab, "growth", "ada", resume=name),
    ):
        pass
    with pytest.raises(BadInput, match="not started"):
        _ = Experiment(lab, "plates", "ada").random
    lab.end_experiment(name, "ended", "ada")


def test_runs_of_others_in_the_experiment_are_named(lab: LabClient) -> None:
    name = begin_program(lab, lambda experiment: lab.submit(READ, user="ada", experiment=experiment.id))
    with again(lab, name) as experiment:
        (stray,) = events(lab, name, "run.submitted")
        assert lab.warnings == [
            f"{stray['run']} of {name} has no key of its program, so the program would submit it again."
        ]
        lab.wait(stray["run"])
        assert experiment.id == name


def test_an_error_may_leave_it_open(lab: LabClient) -> None:
    with pytest.raises(KeyError), Experiment(lab, "plates", "ada", keep_open=True) as experiment:
        raise KeyError("A1")
    with again(lab, experiment.id):
        pass
    with pytest.raises(KeyError), Experiment(lab, "plates", "ada") as experiment:
        raise KeyError("A1")
    assert events(lab, experiment.id, "experiment.ended")[0]["why"] == "failed: KeyError: 'A1'"


def test_a_loop_that_fails_says_so(lab: LabClient) -> None:
    with (
        contextlib.suppress(KeyError),
        Experiment(lab, "plates", "ada") as experiment,
        experiment.loop("assays") as loop,
    ):
        loop.check("go on", True)
        raise KeyError("A1")
    notes = events(lab, experiment.id, "experiment.noted")
    assert [note["facts"] for note in notes] == [
        {},
        {"loop": "assays", "result": True},
        {"error": "KeyError: 'A1'"},
    ]


def test_with_asyncio_calls_are_known_by_the_order_in_which_they_are_made(lab: LabClient) -> None:
    async def work(resume: str = "") -> tuple[str, list[Any]]:
        async with (
            AsyncLabClient(lab._url) as client,
            AsyncExperiment(client, "plates", "ada", resume=resume) as experiment,
        ):
            found: list[Any] = []
            async with experiment.loop("assays") as loop:
                runs = [experiment.run(READ, {"assay": f"A{n}"}) for n in range(6)]
                found += [result.id for result in await asyncio.gather(*runs)]
                found += await asyncio.gather(
                    *(experiment.decide("draw", lambda: time.monotonic_ns()) for _ in range(3))
                )
                found.append(await loop.check("enough", True))
            if not resume:
                raise Stopped(experiment.id, found)
            return experiment.id, found

    with pytest.raises(Stopped) as stopped:
        asyncio.run(work())
    name, found = stopped.value.args
    assert asyncio.run(work(name)) == (name, found)
    assert len(events(lab, name, "run.submitted")) == 6


def test_what_was_interrupted_says_how_it_goes_on(lab: LabClient) -> None:
    with pytest.raises(Stopped) as stopped, Experiment(lab, "plates", "ada") as experiment:
        raise Stopped
    how = f"{experiment.id} stays open: start the program again with --resume {experiment.id}."
    assert stopped.value.__notes__ == [how]
    with pytest.raises(LabUnreachable) as silent, again(lab, experiment.id):
        raise LabUnreachable("The lab was away for a while.")
    assert silent.value.__notes__ == [how]
    with again(lab, experiment.id):  # it stayed open
        pass
    assert len(events(lab, experiment.id, "experiment.ended")) == 1


def test_a_programs_other_experiments_go_on_with_its_first(lab: LabClient) -> None:
    parts: list[list[str]] = []

    def start_two(first: Experiment) -> None:
        with (
            Experiment(lab, "plates of another", "ada", part_of=first) as second,
            Experiment(lab, "plates of another", "ada", part_of=first) as third,
        ):
            second.note("decision", "mine", well="A1")
            parts.append([second.id, third.id])
            raise Stopped

    name = begin_program(lab, start_two)
    for _ in range(2):
        with contextlib.suppress(Stopped), again(lab, name) as first:
            start_two(first)
    assert parts[0] == parts[1] == parts[2]
    second, third = parts[0]
    assert len({name, second, third}) == 3
    assert len(events(lab, second, "experiment.noted")) == 1
    resumed = [len(events(lab, each, "experiment.resumed")) for each in (name, second, third)]
    assert resumed == [2, 2, 2]
    with again(lab, name) as first, Experiment(lab, "plates of another", "ada", part_of=first):
        pass
    ended = [len(events(lab, each, "experiment.ended")) for each in (name, second, third)]
    assert ended == [1, 1, 0]
    lab.end_experiment(third, "ended", "ada")


def test_a_part_that_was_started_before_the_program_knew_is_the_same(lab: LabClient) -> None:
    with contextlib.suppress(Stopped), Experiment(lab, "plates", "ada") as first:
        key = f"{first.id}/experiment plates of another#1"
        started = lab.start_experiment("plates of another", "ada", request=key)
        raise Stopped
    with again(lab, first.id) as first, Experiment(lab, "plates of another", "ada", part_of=first) as part:
        assert part.id == started

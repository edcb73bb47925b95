"""Runs and experiments: submissions of scientists and their applications."""

from __future__ import annotations

import asyncio
from functools import partial
from itertools import islice

import msgspec

from labos.core.envelope import Record
from labos.core.runs import RUN_ENDS
from labos.core.structs import make_from
from labos.errors import NotFound
from labos.http.batches import submit_batch
from labos.http.bodies import (
    By,
    ExperimentEnd,
    ExperimentNote,
    ExperimentResumption,
    NewExperiment,
    NewFile,
    NewRun,
    NewRuns,
    RunCancel,
    RunPause,
)
from labos.http.limits import LARGEST_BODY
from labos.http.operation import Call, Method, change, read, submit
from labos.http.queries import OfExperiment, OfRun, RunQuery, RunsQuery
from labos.ports import LogQuery
from labos.services.proposals import describe_waiting
from labos.services.runs import StepHistory
from labos.spec.findings import Finding


class RunDetail(msgspec.Struct, frozen=True):
    """A run from the log, with its steps. Times are in UTC nanoseconds, 0 if not yet known. ``status``:
    queued, active, paused, cancelling, leaving, completed, failed or cancelled. ``busy`` are the periods
    (from, to) in which one of its actions was in flight. ``due_at`` is the time by which it should end."""

    id: str
    workflow: str
    workcell: str
    user: str
    experiment: str
    submitted_at: int
    steps: list[StepHistory]
    status: str
    started_at: int
    ended_at: int
    why: str
    paused: bool
    closing: bool
    campaign: str
    busy: list[tuple[int, int]]
    due_at: int


class Runs(msgspec.Struct, frozen=True):
    """A page of runs. ``position`` is the position of the last submission on it; ``more``: there are later
    ones. ``ended_position`` is the position of the earliest end on it (0: none)."""

    runs: list[RunDetail]
    position: int
    more: bool
    ended_position: int


class RunSubmission(msgspec.Struct, frozen=True):
    """The id of the run, and the warnings about the workflow's files. ``approval`` is the reason if it waits
    for an approval."""

    run: str
    warnings: tuple[Finding, ...] = ()
    approval: str = ""


class RunsSubmission(msgspec.Struct, frozen=True):
    """The ids of the runs, in the order of their payloads, and the warnings about the workflow's files.
    ``approvals`` has the reason, one sentence for each run that waits for an approval."""

    runs: list[str]
    warnings: tuple[Finding, ...] = ()
    approvals: tuple[str, ...] = ()


class RunReference(msgspec.Struct, frozen=True):
    run: str


class FileReference(msgspec.Struct, frozen=True):
    sha256: str


class ExperimentReference(msgspec.Struct, frozen=True):
    """``approval`` is the reason if it waits for an approval."""

    experiment: str
    approval: str = ""


class HeartbeatReply(msgspec.Struct, frozen=True):
    """The lab has recorded the heartbeat."""


_TEXT = "labos: 1\nname: seal\nsteps:\n  - {name: seal, module: sealer, action: seal}\n"
_TIMED_TEXT = _TEXT.replace("seal}", "seal, args: {time: payload.time}}")
WORKFLOW = {"text": _TEXT, "name": "seal.yaml"}
TIMED_WORKFLOW = {"text": _TIMED_TEXT, "name": "seal.yaml"}
"""Workflows for examples: without a payload, and with the sealing time as its payload."""

_PAYLOADS = [{"time": 2}, {"time": 4}]
_RUN = {
    "workflow": WORKFLOW,
    "user": "ada",
    "place": [{"station": "sealer.default", "labware": "plate96"}],
}


_of_application = partial(change, tag="experiments", headers=("LabOS-User",))
"""A request of an application about its experiment."""


@read(
    route="GET /runs",
    client=Method("runs", "after"),
    summary="List the runs that have not ended, and the last ended ones",
)
async def list_runs(call: Call, query: RunsQuery) -> Runs:
    """A page of the runs that have not ended, in the order of their submission. While there are `more`, ask
    for the next page with `after` = `position`. With `ended`, also runs that have ended, the latest first;
    for earlier ones ask with `before` = `ended_position`."""
    runs = call.kernel.state.runs
    alive = sorted((*runs.active.values(), *runs.queued.values()), key=lambda run: run.position)
    left = [run for run in alive if run.position > query.after and run.campaign not in call.hidden]
    shown = left[: query.limit]
    await call.kernel.flush()
    over = await _read_ends(call, query) if query.ended else []
    names = [*(record.head.stream for record in over), *(str(run.id) for run in shown)]
    stories = [await call.service.read_story(name) for name in names]
    return Runs(
        runs=[make_from(RunDetail, story) for story in stories if story.campaign not in call.hidden],
        position=shown[-1].position if shown else query.after,
        more=len(left) > len(shown),
        ended_position=over[0].head.position if over else 0,
    )


async def _read_ends(call: Call, query: RunsQuery) -> list[Record]:
    """The last ends of runs before a position, in order."""
    upto = query.before - 1 if query.before else None
    wanted = LogQuery(types=RUN_ENDS, last=query.ended, upto=upto)
    select = call.service.parts.store.select
    return await asyncio.to_thread(lambda: list(islice(select(wanted), query.ended)))


@submit(
    route="POST /runs",
    client=Method("submit", by_hand=True),
    summary="Queue a run of a workflow",
    status=201,
    logs_key=True,
    example=_RUN,
    example_answer={"run": "R1", "warnings": []},
)
async def submit_run(call: Call, body: NewRun) -> RunSubmission:
    run, findings = await call.service.submit(body, call.key)
    return RunSubmission(run, findings, describe_waiting(call.kernel.state, run))


@submit(
    route="POST /runs/batch",
    client=Method("_submit_runs", "workflow, payloads, user", key="given"),
    summary="Queue a run of a workflow for each payload, all of them or none",
    status=201,
    logs_key=True,
    example={"workflow": TIMED_WORKFLOW, "user": "ada", "payloads": _PAYLOADS},
    example_answer={"runs": ["R1", "R2"], "warnings": []},
)
async def submit_runs(call: Call, body: NewRuns) -> RunsSubmission:
    """The runs are queued in one step: all of them, or none. So the first one starts when the lab knows the
    last one."""
    runs, findings = await submit_batch(call.service, body, call.key)
    approvals = (describe_waiting(call.kernel.state, run) for run in runs)
    return RunsSubmission(runs, findings, tuple(filter(None, approvals)))


@read(
    route="GET /runs/{run}",
    client=Method("status", by_hand=True),
    summary="Show a run with its steps, or its end",
)
async def get_run(call: Call, path: OfRun, query: RunQuery) -> RunDetail:
    story = await call.service.read_story(path.run, query.wait)
    if story.campaign in call.hidden:
        raise NotFound(f"There is no run {path.run!r}.", remedy="List them: labos runs")
    return make_from(RunDetail, story)


@change(
    route="POST /runs/{run}/cancel",
    client=Method("cancel", "run, by='somebody'", take=None, repeat=True),
    summary="Cancel a run",
    example={"by": "ada", "why": "wrong plate"},
    example_answer={"run": "R1"},
)
async def cancel_run(call: Call, path: OfRun, body: RunCancel) -> RunReference:
    """The run ends as soon as its actions under way have ended. If its workflow has steps under `on_cancel`,
    they then clear its labware away (the status is `leaving` during that time); otherwise the labware stays
    where it is."""
    call.expect_run_seen(path.run)
    await call.service.change(path.run, "cancel", body.by, stay=body.stay, why=body.why)
    return RunReference(path.run)


@change(
    route="POST /runs/{run}/pause",
    client=Method("pause", "run, by='somebody'", take=None, repeat=True),
    summary="Pause a run: no further step starts",
    example={"by": "ada", "why": "lunch"},
    example_answer={"run": "R1"},
)
async def pause_run(call: Call, path: OfRun, body: RunPause) -> RunReference:
    call.expect_run_seen(path.run)
    await call.service.change(path.run, "pause", body.by, why=body.why)
    return RunReference(path.run)


@change(
    route="POST /runs/{run}/resume",
    client=Method("resume", "run, by='somebody'", take=None, repeat=True),
    summary="Resume a paused run",
    example={"by": "ada"},
    example_answer={"run": "R1"},
)
async def resume_run(call: Call, path: OfRun, body: By) -> RunReference:
    call.expect_run_seen(path.run)
    await call.service.change(path.run, "resume", body.by)
    return RunReference(path.run)


@submit(
    route="POST /experiments",
    client=Method("start_experiment", by_hand=True),
    summary="Start an experiment",
    tag="experiments",
    status=201,
    logs_key=True,
    example={"name": "color picker", "user": "ada", "closing": {"text": _TEXT}},
    example_answer={"experiment": "E1"},
)
async def start_experiment(call: Call, body: NewExperiment) -> ExperimentReference:
    """An application starts. From now on it has to send a note or a heartbeat at least every 30 s; otherwise
    LabOS asks a person. A run of the experiment is refused if it would leave labware anywhere except at the
    `parking` stations, in storage or in a waste station."""
    experiment = await call.service.start_experiment(body, call.key)
    return ExperimentReference(experiment, describe_waiting(call.kernel.state, experiment))


@_of_application(
    route="POST /experiments/{experiment}/resume",
    client=Method("resume_experiment", "experiment, name, user", take=None, repeat=True),
    summary="Resume an experiment",
    example={"name": "color picker"},
    example_answer={"experiment": "E1"},
)
async def resume_experiment(
    call: Call, path: OfExperiment, body: ExperimentResumption
) -> ExperimentReference:
    """The application was started again and continues its experiment. A question whether the experiment
    should be closed, because its application was silent, is withdrawn."""
    await call.service.resume_experiment(path.experiment, body.name, call.user)
    return ExperimentReference(path.experiment)


@_of_application(
    route="POST /experiments/{experiment}/end",
    client=Method("end_experiment", "experiment, why, user", take=None, repeat=True),
    summary="End an experiment",
    example={"why": "ended"},
    example_answer={"experiment": "E1"},
)
async def end_experiment(call: Call, path: OfExperiment, body: ExperimentEnd) -> ExperimentReference:
    """The application has ended. A repeated request has no further effect."""
    await call.service.end_experiment(path.experiment, body.why, call.user)
    return ExperimentReference(path.experiment)


@_of_application(
    route="POST /experiments/{experiment}/notes",
    client=Method("note", "experiment, kind, name, facts, user", take=None),
    summary="Log a note of the application",
    status=201,
    example={"kind": "decision", "name": "next colors", "facts": {"colors": [1, 2, 3]}},
    example_answer={"experiment": "E1"},
)
async def note_experiment(call: Call, path: OfExperiment, body: ExperimentNote) -> ExperimentReference:
    await call.service.note(path.experiment, body.kind, body.name, body.facts, call.user, body.key)
    return ExperimentReference(path.experiment)


@_of_application(
    route="POST /experiments/{experiment}/files",
    client=Method("keep_file", "experiment, content, user", take="sha256", repeat=True),
    summary="Store a file of an experiment",
    status=201,
    problems=("not_found",),
    largest_body=LARGEST_BODY,
    example={"content": "aGVsbG8="},
    example_answer={"sha256": "2cf24dba5fb0a30e26e83b2ac5b9e29e1b161e5c1fa7425e73043362938b9824"},
)
async def keep_file(call: Call, path: OfExperiment, body: NewFile) -> FileReference:
    """Stores a file of an experiment that has not ended, such as the result of a computation.
    `/files/{sha256}` returns it. A repeated request has no further effect."""
    if path.experiment not in call.kernel.state.experiments.open:
        raise NotFound(f"There is no experiment {path.experiment} that has not ended.")
    call.service.check_noting(path.experiment, call.user)
    return FileReference(await asyncio.to_thread(call.service.parts.blobs.put, body.content))


@_of_application(
    route="POST /experiments/{experiment}/heartbeat",
    client=Method("heartbeat", "experiment, user", take=None, repeat=True),
    at_kernel=True,
    summary="Report that the application is running",
    problems=(),
    example_answer={},
)
async def record_heartbeat(call: Call, path: OfExperiment) -> HeartbeatReply:
    """The application is running."""
    call.service.note_heartbeat(path.experiment, call.user)
    return HeartbeatReply()

"""A run, or the runs of an experiment, as an RO-Crate: the actions, users, drivers and labware.

A crate conforms to Process Run Crate 0.5 (https://w3id.org/ro/wfrun/process/0.5): each action of a module is
a ``CreateAction``, its instrument is the driver with its version, and its agent the user who submitted the
run. If all runs follow one workflow and each has carried out something, it also conforms to Workflow Run
Crate and Provenance Run Crate 0.5: the workflow is the main entity, a run is an action, and each of its steps
has a ``ControlAction``. Steps that were not carried out are only in the plan. For an experiment, the
application is this workflow, and runs are its steps.
"""

from __future__ import annotations

import csv
import io
from typing import Any

import msgspec

from labos.audit._crate_experiment import CrateRun, Program, add_experiment, experiment_of
from labos.audit._crate_parts import (
    METADATA,
    VERSION,
    Crate,
    make_link,
    make_local_id,
    safe_name,
    with_offset,
)
from labos.audit._crate_steps import STATUS, Doer, add_action, json_of
from labos.audit.query import ReadConnection
from labos.core.canonical import encode_canonical
from labos.core.lab import KernelStarted
from labos.core.plans import PlanRecorded, PlanStepsRecorded
from labos.errors import BadInput, NotFound
from labos.ports import LogQuery
from labos.services.log import Log
from labos.services.times import iso_time

WFRUN = "https://w3id.org/ro/wfrun"
PROCESS = (f"{WFRUN}/process/0.5", "Process Run Crate", "0.5")
OF_ONE_WORKFLOW = (
    (f"{WFRUN}/workflow/0.5", "Workflow Run Crate", "0.5"),
    (f"{WFRUN}/provenance/0.5", "Provenance Run Crate", "0.5"),
    ("https://w3id.org/workflowhub/workflow-ro-crate/1.0", "Workflow RO-Crate", "1.0"),
)

NO_LICENSE = "No licence was given. Ask the lab before you use its data."

NOT_CARRIED_OUT = ["File", "SoftwareSourceCode", "HowTo"]
"""The type of a workflow of which no step was carried out, because the profiles require tools for a
computational workflow."""

_TABLES = {
    "results.csv": (
        "What was measured, well by well",
        "run step key module labware well sample quantity value text unit at",
        "SELECT {} FROM results WHERE run = ? ORDER BY position, number",
    ),
    "transfers.csv": (
        "What was transferred into and out of wells",
        "run at kind labware well volume_ul liquid lots certain module action",
        "SELECT {} FROM transfers WHERE run = ? ORDER BY position, number",
    ),
}


class Run(msgspec.Struct, frozen=True):
    """A row of the view ``runs``."""

    run: str
    workflow: str
    workcell: str
    user_id: str
    experiment: str
    status: str
    why: str
    plan: str
    pins: Any
    payload: Any
    submitted_at: str
    started_at: str | None
    ended_at: str | None
    submitted_position: int
    ended_position: int | None


def runs_of(asker: ReadConnection, name: str) -> list[Run]:
    """The run of that name, or the runs of the experiment (perhaps none). Raises NotFound."""
    query = f"SELECT {', '.join(Run.__struct_fields__)} FROM runs WHERE {{}} = ? ORDER BY submitted_position"
    rows = asker.fetch(query.format("run"), name) or asker.fetch(query.format("experiment"), name)
    if not rows and experiment_of(asker, name) is None:
        raise NotFound(
            f"There is neither a run nor an experiment {name!r} in this log.",
            remedy="List them: labos runs --all, labos experiments --all",
        )
    return [Run(*row) for row in rows]


def make_crate(
    asker: ReadConnection,
    log: Log,
    name: str,
    now_ns: int,
    license_: str = "",
    program: Program | None = None,
) -> Crate:
    """The crate of a run or an experiment in its present state. ``license_`` is the URL of a licence,
    ``program`` the source of the experiment's application. Raises NotFound, LogDamaged, and BadInput for the
    program of a run."""
    runs = runs_of(asker, name)
    experiment = None if runs and runs[0].run == name else experiment_of(asker, name)
    if experiment is None and program is not None:
        raise BadInput(f"{name} is a run: it has no program.", remedy="Name an experiment, or no --program.")
    crate = Crate()
    about = {"@id": "./"}
    crate.add("CreativeWork", METADATA, about=about, conformsTo=make_link(VERSION))
    names = ", ".join(dict.fromkeys(run.workflow for run in runs))
    if experiment is not None:
        names = names or experiment.name
    kind = "Run" if experiment is None else "Experiment"
    crate.add(
        "Dataset",
        "./",
        name=f"{kind} {name}: {names}",
        description=f"{kind} {name} of the lab {log.head().lab}, carried out by LabOS: its workflow, every "
        f"step with its module, driver and times, labware, lots, results and files.",
        datePublished=iso_time(now_ns),
        license=make_link(_add_license(crate, license_)),
    )
    workflows = {run.run: _add_workflow(crate, log, run) for run in runs}
    done = [_add_run(crate, asker, log, run, workflows[run.run]) for run in runs]
    main = set(workflows.values())
    if experiment is not None:
        crate_runs = [
            CrateRun(
                run.run, workflows[run.run], tuple(_add_kernels(crate, log, run)), run.submitted_position
            )
            for run in runs
        ]
        for workflow in main - {workflows[run.run] for run, acted in zip(runs, done, strict=True) if acted}:
            crate.add_properties(workflow, **{"@type": NOT_CARRIED_OUT})
        main = {add_experiment(crate, log, experiment, crate_runs, program)}
    profiles = [PROCESS]
    if len(main) == 1 and (all(done) if experiment is None else any(done)):
        profiles += OF_ONE_WORKFLOW
        crate.add_properties("./", mainEntity=make_link(*main))
        crate.add_properties(METADATA, conformsTo=make_link(VERSION, OF_ONE_WORKFLOW[-1][0]))
    users = [run.user_id for run in runs] or [
        experiment.user_id for experiment in (experiment,) if experiment
    ]
    crate.add_properties("./", author=make_link(*(make_local_id("user", user) for user in users)))
    for table, (words, columns, query) in _TABLES.items():
        _add_table(crate, asker, runs, table, words, columns.split(), query)
    for id_, title, version in profiles:
        crate.add("CreativeWork", id_, name=title, version=version)
    crate.add_properties("./", conformsTo=make_link(*(id_ for id_, _, _ in profiles)))
    return crate


def _add_license(crate: Crate, url: str) -> str:
    if url:
        return crate.add("CreativeWork", url, name=url, description="The licence of this crate.")
    return crate.add("CreativeWork", "#no-licence", name="No licence", description=NO_LICENSE)


def _add_workflow(crate: Crate, log: Log, run: Run) -> str:
    """Add the submitted workflow file and its plan (the workflow with its payload filled in), or only the
    plan if the workflow was not a file. Returns the id of the one that the run followed."""
    kinds = ["File", "SoftwareSourceCode", "ComputationalWorkflow", "HowTo"]
    source = json_of(run.pins).get("workflow")
    plan = _plan_of(log, run.plan)
    path = f"plans/{run.plan[:12]}.json"
    words = f"Plan of {run.workflow}: the workflow with its payload filled in"
    if not source:
        language = crate.add("ComputerLanguage", "#labos-plan", name="LabOS plan (JSON)")
        return crate.put(
            path,
            plan,
            kind=kinds,
            name=words,
            encodingFormat="application/json",
            programmingLanguage=make_link(language),
            version=run.plan[:12],
        )
    crate.put(path, plan, name=words, encodingFormat="application/json")
    language = crate.add("ComputerLanguage", "#labos-workflow", name="LabOS workflow (YAML)")
    return crate.put_blob(
        f"workflows/{safe_name(run.workflow)}.yaml",
        source,
        None,
        kind=kinds,
        name=run.workflow,
        encodingFormat="application/yaml",
        programmingLanguage=make_link(language),
        version=source[:12],
    )


def _plan_of(log: Log, digest: str) -> bytes:
    """The plan as JSON, from its parts in the log. Raises NotFound."""
    plan: dict[str, Any] = {}
    by: str | None = None
    query = LogQuery(types=(PlanRecorded.TYPE, PlanStepsRecorded.TYPE), mentions=digest)
    for record in log.select(query):
        payload = msgspec.json.decode(record.payload)
        if payload["plan"] != digest or by not in (None, payload["by"]):
            continue  # the same plan is recorded again if it was needed again
        if record.head.type == PlanRecorded.TYPE:
            by = payload["by"]
            plan = {name: payload[name] for name in ("workflow", "workcell", "feeds", "files", "holds")}
            plan["steps"] = []
        else:
            plan["steps"] += payload["steps"]
    if not plan:
        raise NotFound(f"There is no plan {digest} in this log.", remedy="Check it: labos verify")
    return encode_canonical(plan)


def _add_run(crate: Crate, asker: ReadConnection, log: Log, run: Run, workflow: str) -> bool:
    """Add the run and each of its actions; returns whether something was carried out."""
    user = crate.add_user(run.user_id)
    id_ = make_local_id("run", run.run)
    payload = crate.put(
        f"runs/{run.run}/payload.json",
        encode_canonical(json_of(run.payload)),
        name=f"Payload of {run.run}",
        encodingFormat="application/json",
    )
    doer = Doer(run.run, run.plan, user, workflow)
    actions = [
        add_action(crate, asker, doer, row[0])
        for row in asker.fetch(
            "SELECT action FROM actions WHERE run = ? ORDER BY requested_position", run.run
        )
    ]
    status = STATUS.get(run.status, "Active")
    crate.add(
        "CreateAction",
        id_,
        name=f"Run {run.run}: {run.workflow}",
        description=f"The workflow {run.workflow} on the workcell {run.workcell}; it is {run.status}.",
        instrument=make_link(workflow),
        agent=make_link(user),
        startTime=with_offset(run.started_at or run.submitted_at),
        endTime=with_offset(run.ended_at),
        actionStatus=f"http://schema.org/{status}ActionStatus",
        error=(run.why or run.status) if status == "Failed" else None,
        object=make_link(payload, f"plans/{run.plan[:12]}.json", *(each for a in actions for each in a.used)),
        result=make_link(*(each for a in actions for each in a.made)),
    )
    controls = [a.control for a in actions]
    if controls:
        crate.add(
            "OrganizeAction",
            make_local_id("execution", run.run),
            name=f"LabOS carries out {run.run}",
            instrument=make_link(*_add_kernels(crate, log, run)),
            agent=make_link(user),
            startTime=with_offset(run.started_at),
            endTime=with_offset(run.ended_at),
            object=make_link(*controls),
            result=make_link(id_),
        )
    crate.extend("./", "mentions", id_, *(a.id for a in actions))
    return bool(controls)


def _add_kernels(crate: Crate, log: Log, run: Run) -> list[str]:
    """Add each version of LabOS whose kernels carried out the run."""
    kind = (KernelStarted.TYPE,)
    before = log.select(LogQuery(types=kind, upto=run.submitted_position, last=1))
    later = log.select(LogQuery(types=kind, after=run.submitted_position, upto=run.ended_position))
    versions = [msgspec.json.decode(record.payload)["version"] for record in (*before, *later)]
    return [
        crate.add(
            "SoftwareApplication", make_local_id("labos", version), name="LabOS", softwareVersion=version
        )
        for version in dict.fromkeys(versions)
    ]


def _add_table(
    crate: Crate,
    asker: ReadConnection,
    runs: list[Run],
    path: str,
    words: str,
    columns: list[str],
    query: str,
) -> None:
    """Add the rows of a view as CSV, if there are any."""
    rows = [row for run in runs for row in asker.fetch(query.format(", ".join(columns)), run.run)]
    if not rows:
        return
    text = io.StringIO()
    out = csv.writer(text, lineterminator="\n")
    out.writerow(columns)
    # A flag is 0 or 1 in SQLite.
    out.writerows([int(value) if isinstance(value, bool) else value for value in row] for row in rows)
    id_ = crate.put(path, text.getvalue().encode(), name=words, encodingFormat="text/csv")
    if len(runs) == 1:
        crate.extend(make_local_id("run", runs[0].run), "result", id_)

"""An experiment in its crate: the application, its actions between runs, and its publications. The
application is the workflow of the crate, and its steps are runs of workflows. LabOS does not store programs;
the program is in the crate only if the user gives it. ``experiments/E1/course.json`` always has the course of
the application: its runs, computations and decisions in their order.
"""

from __future__ import annotations

from typing import Any

import msgspec

from labos.audit._crate_parts import Crate, make_link, make_local_id, safe_name, with_offset
from labos.audit._crate_steps import STATUS
from labos.audit.cloudevents import encode_cloudevent
from labos.audit.query import ReadConnection
from labos.core.canonical import encode_canonical
from labos.core.experiments import ExperimentNoted
from labos.ports import LogQuery
from labos.services.files import iterate_files
from labos.services.log import Log
from labos.services.times import iso_time

WORKFLOW = ["File", "SoftwareSourceCode", "ComputationalWorkflow", "HowTo"]
COMPUTATIONS = ("local_compute", "compute")


class Program(msgspec.Struct, frozen=True):
    """The application's source from the caller."""

    name: str
    content: bytes


class CrateExperiment(msgspec.Struct, frozen=True):
    """A row of the view ``experiments``."""

    experiment: str
    name: str
    user_id: str
    status: str
    why: str
    started_at: str
    ended_at: str | None
    started_position: int
    ended_position: int | None


class CrateRun(msgspec.Struct, frozen=True):
    """A run of the experiment: its id, the id of its workflow, the LabOS that carried it out, and the time of
    its submission."""

    run: str
    workflow: str
    kernels: tuple[str, ...]
    position: int


def experiment_of(asker: ReadConnection, name: str) -> CrateExperiment | None:
    """The experiment of that name, if there is one."""
    columns = ", ".join(CrateExperiment.__struct_fields__)
    rows = asker.fetch(f"SELECT {columns} FROM experiments WHERE experiment = ?", name)
    return CrateExperiment(*rows[0]) if rows else None


def add_experiment(
    crate: Crate, log: Log, experiment: CrateExperiment, runs: list[CrateRun], program: Program | None
) -> str:
    """Add the application and its course; returns the id of the application, the crate's main entity."""
    name = experiment.experiment
    records = list(log.select(LogQuery(streams=(name,))))
    notes = [
        (record.head, msgspec.json.decode(record.payload))
        for record in records
        if record.head.type == ExperimentNoted.TYPE
    ]
    user = crate.add_user(experiment.user_id)
    folder = f"experiments/{safe_name(name)}"
    course = encode_canonical(_list_course(experiment, runs, notes))
    main = _add_application(crate, experiment, program, course, folder)
    crate.put(
        f"{folder}/events.jsonl",
        b"".join(encode_cloudevent(record) + b"\n" for record in records),
        name=f"Events of {name} itself, as CloudEvents; `hash` is each event's place in the lab's log",
        encodingFormat="application/x-ndjson",
    )
    made = [file for head, note in notes for file in _add_note(crate, experiment, head, note, main, user)]
    action = make_local_id("experiment", name)
    status = STATUS.get({"ended": "completed"}.get(experiment.status, experiment.status), "Active")
    is_failed = experiment.status == "ended" and experiment.why.startswith("failed")
    crate.add(
        "CreateAction",
        action,
        name=f"Experiment {name}: {experiment.name}",
        description=f"The application {experiment.name}; it is {experiment.status}.",
        instrument=make_link(main),
        agent=make_link(user),
        startTime=with_offset(experiment.started_at),
        endTime=with_offset(experiment.ended_at),
        actionStatus=f"http://schema.org/{'Failed' if is_failed else status}ActionStatus",
        error=experiment.why if is_failed else None,
        result=make_link(*made),
    )
    _add_steps(crate, experiment, runs, main, action, user)
    crate.extend("./", "mentions", action)
    return main


def _list_course(
    experiment: CrateExperiment, runs: list[CrateRun], notes: list[tuple[Any, Any]]
) -> dict[str, Any]:
    """The course of the application."""
    steps = [(run.position, {"run": run.run, "workflow": run.workflow}) for run in runs]
    for head, note in notes:
        facts = note.get("facts", {})
        entry = {"kind": note["kind"], "name": note["name"], "facts": facts, "at": iso_time(head.recorded_at)}
        steps.append((head.position, entry))
    return {
        "experiment": experiment.experiment,
        "application": experiment.name,
        "user": experiment.user_id,
        "status": experiment.status,
        "why": experiment.why,
        "course": [{"position": at, **entry} for at, entry in sorted(steps, key=lambda step: step[0])],
    }


def _add_application(
    crate: Crate, experiment: CrateExperiment, program: Program | None, course: bytes, folder: str
) -> str:
    """Add the program, or without it the course, as the workflow."""
    properties = {"name": f"What {experiment.name} did, in order", "encodingFormat": "application/json"}
    path = f"{folder}/course.json"
    if program is None:
        language = crate.add("ComputerLanguage", "#labos-course", name="LabOS course of an experiment (JSON)")
        return crate.put(
            path, course, kind=WORKFLOW, programmingLanguage=make_link(language), version="1", **properties
        )
    crate.put(path, course, **properties)
    language = crate.add(
        "ComputerLanguage",
        "#python",
        name="Python",
        url=make_link(crate.add("WebPage", "https://www.python.org/")),
    )
    return crate.put(
        f"application/{safe_name(program.name)}",
        program.content,
        kind=WORKFLOW,
        name=experiment.name,
        encodingFormat="text/x-python",
        programmingLanguage=make_link(language),
    )


def _add_steps(
    crate: Crate, experiment: CrateExperiment, runs: list[CrateRun], main: str, action: str, user: str
) -> None:
    """Add each run as a step of the application."""
    controls = []
    for number, run in enumerate(runs, 1):
        step = crate.add("HowToStep", f"{main}#{run.run}", name=f"Run {run.run}", position=str(number))
        crate.extend(step, "workExample", run.workflow)
        crate.extend(main, "step", step)
        crate.extend(main, "hasPart", run.workflow)
        controls.append(
            crate.add(
                "ControlAction",
                make_local_id("control-run", run.run),
                name=f"Run {run.run} of {experiment.experiment}",
                instrument=make_link(step),
                object=make_link(make_local_id("run", run.run)),
            )
        )
    kernels = [kernel for run in runs for kernel in run.kernels]
    if controls and kernels:
        crate.add(
            "OrganizeAction",
            make_local_id("execution", experiment.experiment),
            name=f"LabOS carries out {experiment.experiment}",
            instrument=make_link(*kernels),
            agent=make_link(user),
            startTime=with_offset(experiment.started_at),
            endTime=with_offset(experiment.ended_at),
            object=make_link(*controls),
            result=make_link(action),
        )


def _add_note(
    crate: Crate, experiment: CrateExperiment, head: Any, note: dict[str, Any], main: str, user: str
) -> list[str]:
    """Add a computation or a publication; returns its files."""
    facts = note.get("facts", {})
    if note["kind"] in COMPUTATIONS:
        return _add_computation(crate, head, note["name"], facts, main, user)
    if note["kind"] != "publication":
        return []
    files = [
        crate.put_blob(f"published/{safe_name(file)}", digest, size, name=file)
        for file, digest, size in iterate_files(facts)
    ]
    creators = facts.get("creators")
    people = [each for each in creators if isinstance(each, str)] if isinstance(creators, list) else []
    keywords = facts.get("keywords")
    words = [each for each in keywords if isinstance(each, str)] if isinstance(keywords, list) else []
    entry = crate.add(
        "CreativeWork",
        make_local_id("publication", f"{experiment.experiment}@{head.position}"),
        name=str(facts.get("title") or note["name"]),
        description=str(facts.get("about") or "") or None,
        keywords=words,
        datePublished=iso_time(head.recorded_at),
        creator=make_link(*map(crate.add_user, people)),
        hasPart=make_link(*files),
    )
    crate.extend("./", "mentions", entry)
    return files


def _add_computation(
    crate: Crate, head: Any, function: str, facts: dict[str, Any], main: str, user: str
) -> list[str]:
    """Add a computation: the digest of its code, its place, and its result."""
    code = str(facts.get("code", ""))
    tool = crate.add(
        "SoftwareApplication",
        make_local_id("function", f"{function} {code[:12]}".strip()),
        name=function,
        softwareVersion=code[:12] or "unknown",
        description=f"A function; the SHA-256 of its file was {code}." if code else "A function.",
    )
    crate.extend(main, "hasPart", tool)
    made: list[str] = []
    path = f"computed/{head.position}-{safe_name(function)}"
    if isinstance(facts.get("result_file"), str):
        suffix = "json" if facts.get("result_form") == "json" else "pickle"
        made.append(
            crate.put_blob(f"{path}.{suffix}", facts["result_file"], None, name=f"Result of {function}")
        )
    elif "result" in facts:
        content = encode_canonical(facts["result"])
        words = f"Result of {function}"
        made.append(crate.put(f"{path}.json", content, name=words, encodingFormat="application/json"))
    error = facts.get("error")
    end = with_offset(iso_time(head.recorded_at)[:23] + "Z")
    action = crate.add(
        "CreateAction",
        make_local_id("computation", str(head.position)),
        name=f"{function} at event {head.position}",
        description=f"Computed {facts.get('where', '')} on {facts.get('host', 'a computer')}.",
        instrument=make_link(tool),
        agent=make_link(user),
        endTime=end,
        actionStatus=f"http://schema.org/{'Failed' if error else 'Completed'}ActionStatus",
        error=str(error) if error else None,
        result=make_link(*made),
    )
    crate.extend("./", "mentions", action)
    return made

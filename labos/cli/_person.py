"""Short commands with which a person controls runs, questions and modules."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import click

from labos.cli._complete import make_completer
from labos.cli._options import Asker, asker_options, read_result, wait_option, why_option
from labos.cli._out import end_with_json, report_done, wants_json
from labos.core.ids import local
from labos.services.times import parse_until, show_time

if TYPE_CHECKING:
    from labos.client import RunResult


@click.command("cancel")
@click.argument("target", shell_complete=make_completer("run", "experiment", "module", "workcell", "lab"))
@wait_option("Wait until all cancelled runs have ended.", default=False)
@click.option("--stay", is_flag=True, help="Leave labware where it is, even if there are `on_cancel` steps.")
@why_option("The reason, for the log.")
@asker_options
def cancel(target: str, wait: bool, stay: bool, why: str, asker: Asker) -> None:
    """Cancel TARGET: a run, an experiment, or the runs of a module, a workcell or the whole `lab`.

    Actions in progress continue to their end. Then the `on_cancel` steps of the workflow clear the run's
    labware away. Without such steps the labware stays where it is, and the lab asks a person. A cancelled
    experiment accepts no more runs and closes. With a module as TARGET, all active runs that still need it
    are cancelled.

    \b
    labos cancel R3 --wait    wait until it has ended
    labos cancel R3 --stay    move no more labware, even if it is being cleared away
    labos cancel R3 --why "wrong plate"
    labos cancel E2           all its runs; then its closing workflow clears the labware away
    labos cancel E2 --stay    without its closing workflow: all labware stays where it is
    labos cancel rpl          all runs of a workcell, also waiting ones
    """
    with asker.lab() as client:
        done = client.control("cancel", target, asker.user, why=why, stay=stay)
        runs = done["runs"] or ([target] if done["kind"] == "run" else [])
        ends = (client.wait(run) if wait else client.status(run) for run in runs)
        if wants_json():
            results = [{"id": end.id, "status": end.status, "why": end.why} for end in ends]
            facts = {"kind": done["kind"], "target": done["target"], "already": done["already"]}
            end_with_json({**facts, "runs": results})
        if done["already"]:
            is_one = done["kind"] in ("run", "experiment")
            what = "is already being cancelled" if is_one else "has nothing to cancel"
            click.echo(f"{_capitalise_first(_target_name(done))} {what}.{_describe_reason(done)}")
        elif done["kind"] != "run":
            click.echo(f"{_target_name(done)}: {len(runs)} run{'' if len(runs) == 1 else 's'} cancelled.")
        for end in ends:
            click.echo(_describe_end(end, stay=stay))


def _describe_end(result: RunResult, *, stay: bool) -> str:
    """The present status of a cancelled run."""
    if result.over:
        return f"{result.id} is {result.status}."
    flying = [
        f"{step.key!r} on {local(step.module)}"
        for step in result.steps
        if step.state in ("in flight", "unknown")
    ]
    first = f"as soon as {' and '.join(flying)} has ended" if flying else "next"
    ends = "it clears its labware away" if _has_way_out(result) and not stay else "it ends"
    return f"{result.id} is {result.status}: {ends} {first}. Wait for it: labos runs {result.id}"


def _has_way_out(result: RunResult) -> bool:
    return result.status == "leaving" or any(step.key.startswith("on_cancel/") for step in result.steps)


def _target_name(done: dict[str, Any]) -> str:
    """The target in words: ``R3``, ``the lab``, ``the module rpl/pf400``."""
    kind, target = done["kind"], done["target"]
    if kind in ("run", "experiment"):
        return str(target)
    return "the lab" if kind == "lab" else f"the {kind} {target}"


@click.command("pause")
@click.argument("target", shell_complete=make_completer("run", "experiment", "module", "workcell", "lab"))
@why_option()
@asker_options
def pause(target: str, why: str, asker: Asker) -> None:
    """Pause TARGET: a run, an experiment, a module, a workcell, or the whole `lab`. No further step starts
    until you resume it. Actions in progress continue to their end.

    \b
    labos pause R3
    labos pause pf400 --why "listening to its gripper"
    labos pause lab
    """
    _change("pause", target, asker, why)


@click.command("resume")
@click.argument("target", shell_complete=make_completer("run", "experiment", "module", "workcell", "lab"))
@asker_options
def resume(target: str, asker: Asker) -> None:
    """Resume TARGET: a run, an experiment, a module, a workcell, or the whole `lab`.

    \b
    labos resume R3
    labos resume lab
    """
    _change("resume", target, asker)


def _change(verb: str, target: str, asker: Asker, why: str = "") -> None:
    with asker.lab() as client:
        done = client.control(verb, target, asker.user, why=why)
    was = " already" if done["already"] else ""
    state = f"is paused{was}" if verb == "pause" else f"goes on{was}"
    facts = {"kind": done["kind"], "target": done["target"], "paused": verb == "pause"}
    report_done(f"{_capitalise_first(_target_name(done))} {state}.{_describe_reason(done)}", facts)


def _capitalise_first(text: str) -> str:
    return f"{text[:1].upper()}{text[1:]}"


def _describe_reason(done: dict[str, Any]) -> str:
    """The outcome for the given reason, if the target was already in this state."""
    return " Your reason is in the log." if done["noted"] else ""


@click.command("resolve")
@click.argument("intervention", shell_complete=make_completer("intervention"), required=False)
@click.argument("choice", required=False)
@why_option("A note for the log.")
@click.option(
    "--result", metavar="JSON", help="The result of the step, if it was done and later steps read its result."
)
@asker_options
def resolve(intervention: str | None, choice: str | None, why: str, result: str | None, asker: Asker) -> None:
    """Answer a question of the lab with one of its choices. Without arguments, list the questions.

    \b
    labos resolve
    labos resolve I2 done --why "looked at the nest"
    labos resolve I3 done --result '{"od": 0.42}'
    """
    from labos.cli._liveness import open_questions

    if intervention and choice:
        with asker.lab() as client:
            client.resolve(intervention, choice, asker.user, why, read_result(result))
        facts = {"id": intervention, "choice": choice}
        report_done(f"{intervention} is answered: {choice}.", facts)
        return
    questions = open_questions(asker.home)
    end_with_json(questions)
    if not questions:
        click.echo("No question is open.")
    for question in questions:
        click.echo(f"{question['id']}  {question['text']}")
        if question["now"] and question["now"] not in question["text"]:
            click.echo(f"      now {question['now']}")
        for offered in question["choices"]:
            click.echo(f"      labos resolve {question['id']} {offered['name']}   {offered['consequence']}")


@click.command("place")
@click.argument("station", shell_complete=make_completer("station"))
@click.argument("labware")
@asker_options
def place(station: str, labware: str, asker: Asker) -> None:
    """Report that you put labware on an empty STATION. LABWARE is its type.

    \b
    labos place camera_module.plate_station plate96
    """
    from labos.cli._lab import find_stations

    with asker.lab() as client:
        name = client.place(station, labware, asker.user)
        where = find_stations(client, [name]).get(name, station)
    facts = {"labware": name, "type": labware, "station": where}
    report_done(f"{name or labware} stands at {where}.", facts)


@click.command("barcode")
@click.argument("labware", shell_complete=make_completer("labware"))
@click.argument("barcode")
@click.option("--replace", is_flag=True, help="Replace an earlier barcode, because the label was changed.")
@asker_options
def barcode(labware: str, barcode: str, replace: bool, asker: Asker) -> None:
    """Record that LABWARE has BARCODE. If a barcode reader reads another one, the lab asks a person.

    \b
    labos barcode P7 LB000815
    """
    with asker.lab() as client:
        client.barcode(labware, barcode, asker.user, replace=replace)
    report_done(f"{labware} has the barcode {barcode}.", {"labware": labware, "barcode": barcode})


@click.command("out-of-service")
@click.argument("module", shell_complete=make_completer("module"))
@why_option("The reason, for users whose runs wait.", required=True)
@click.option(
    "--until",
    metavar="TIME",
    help="When the module returns to service automatically: 2h, 1d12h, 2026-05-04T10:30.",
)
@asker_options
def out_of_service(module: str, why: str, until: str | None, asker: Asker) -> None:
    """Take MODULE out of service: its current action ends, no new action starts, and runs wait for it.

    \b
    labos out-of-service hidex --why "lamp is being changed" --until 2h
    """
    from labos.cli._query import now_ns

    back_at = parse_until(until, now_ns()) if until else 0
    with asker.lab() as client:
        client.take_out(module, why, asker.user, back_at)
    message = f"{module} is out of service{f' until {show_time(back_at)}' if back_at else ''}."
    report_done(message, {"module": module, "in_service": False, "back_at": back_at})


@click.command("in-service")
@click.argument("module", shell_complete=make_completer("module"))
@asker_options
def in_service(module: str, asker: Asker) -> None:
    """Put MODULE back in service: runs that wait for it continue.

    \b
    labos in-service hidex
    """
    with asker.lab() as client:
        client.put_back(module, asker.user)
    report_done(f"{module} is in service.", {"module": module, "in_service": True})

"""``labos plan``: what a workflow would do, step by step, and how long it would take."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import click
import msgspec

from labos.cli._options import json_option
from labos.cli._out import show_json, show_table
from labos.cli._payload import payload_option, read_payload
from labos.core.effects import Move, Needs, Take, emptied, filled
from labos.core.ids import StationName, local

if TYPE_CHECKING:
    from labos.core.model import Workcell
    from labos.planning.timetable import Slot
    from labos.spec import Compiled


class Step(msgspec.Struct):
    """A step with its nominal times, in seconds from the start of the run."""

    key: str
    module: str
    action: str
    args: dict[str, Any]
    after: list[str]
    stations: list[str]
    duration_s: float
    start_s: float
    end_s: float
    critical: bool
    late_s: float
    retries: int = 0


class Resource(msgspec.Struct):
    """What is used up of a module's resource, of how much it holds when full."""

    module: str
    resource: str
    amount: float
    capacity: float | None


class Outline(msgspec.Struct):
    """A workflow as it would run alone."""

    workflow: str
    workcell: str
    total_s: float
    critical: list[str]
    steps: list[Step]
    busy_s: dict[str, float]
    resources: list[Resource]
    labware_taken: dict[str, int]
    inputs: list[str]
    outputs: list[str]


@click.command("plan")
@click.argument("workflow")
@click.option("--workcell", required=True, metavar="W", help="A workcell file, or a packaged one: rpl.")
@payload_option
@json_option
def command(workflow: str, workcell: str, payloads: tuple[str, ...], as_json: bool) -> None:
    """Show what WORKFLOW (a file, or a packaged one) would do: its steps with the payload filled
    in, their modules, stations and arguments, when each starts, and what is used up.

    The times are the drivers' nominal ones, for a run that has the bench to itself. Steps marked
    with * are critical: together they take as long as the run.

    \b
    labos plan pcr --workcell rpl
    labos plan my.yaml --workcell my_cell.yaml --payload seal.time=4 --json

    Files that are needed on the real bench only may be missing. Exit code 1 if the workflow has
    errors; `labos validate` shows the warnings too.
    """
    from labos.bootstrap import descriptions
    from labos.cli._specs import spec_path
    from labos.spec import compile_workflow, load_workcell

    flow, cell = spec_path("workflows", workflow), spec_path("workcells", workcell)
    known = descriptions()
    loaded = load_workcell(cell, known)
    compiled = compile_workflow(
        flow, read_payload(payloads), loaded.workcell, known, simulate=True, bench=loaded.bench
    )
    outline = outline_of(compiled, loaded.workcell)
    if as_json:
        show_json(outline)
    else:
        _tell(outline)


def outline_of(compiled: Compiled, workcell: Workcell) -> Outline:
    """A compiled workflow with its times."""
    from labos.planning.timetable import consumption, taken, timetable

    plan = compiled.plan
    times = timetable(plan, workcell)
    stations = _stations(compiled, times.slots, workcell)
    steps = [
        Step(
            key=step.key,
            module=local(step.module),
            action=step.action,
            args=step.args,
            after=[plan.steps[index].key for index in step.after],
            stations=stations[index],
            duration_s=step.duration_s,
            start_s=slot.start_s,
            end_s=slot.end_s,
            critical=index in times.critical,
            late_s=slot.late_s,
            retries=step.retry.times if step.retry else 0,
        )
        for index, (step, slot) in enumerate(zip(plan.steps, times.slots, strict=True))
    ]
    full = {module.name: module.levels for module in workcell.modules}
    return Outline(
        workflow=plan.workflow,
        workcell=plan.workcell,
        total_s=times.total_s,
        critical=[plan.steps[index].key for index in times.critical],
        steps=steps,
        busy_s={local(module): busy for module, busy in times.busy_s.items()},
        resources=[
            Resource(local(module), resource, amount, full[module].get(resource))
            for (module, resource), amount in consumption(plan).items()
        ],
        labware_taken={local(stack): count for stack, count in taken(plan).items()},
        inputs=[local(place) for place in compiled.inputs],
        outputs=[local(place) for place in compiled.outputs],
    )


def _stations(compiled: Compiled, slots: tuple[Slot, ...], workcell: Workcell) -> list[list[str]]:
    """The stations of each step: where labware goes, in order; else where it is worked on."""
    steps = compiled.plan.steps
    found: list[list[StationName]] = [[] for _ in steps]
    here = list(compiled.inputs)
    owner = {station.name: station.module for station in workcell.stations}
    for index in sorted(range(len(steps)), key=lambda index: (slots[index].start_s, index)):
        step = steps[index]
        for effect in step.effects:
            if isinstance(effect, Move):
                found[index] = [place for place in (effect.source, effect.via, effect.target) if place]
                here = [place for place in here if place != emptied(effect)]
                here += [filled(effect)] if filled(effect) else []
            elif isinstance(effect, Take):
                found[index] = [effect.stack, effect.target]
                here.append(effect.target)
            elif isinstance(effect, Needs) and not found[index]:
                own = [place for place in here if owner.get(place) == step.module]
                found[index] = [effect.station] if effect.station else own
    return [[local(place) for place in places] for places in found]


def _tell(outline: Outline) -> None:
    from labos.services.describe import short
    from labos.services.times import show_span

    rows = [
        (
            f"{number}{'*' if step.critical else ''}",
            step.key,
            f"{step.module}.{step.action}",
            " → ".join(step.stations),
            ", ".join(f"{name}={short(value, 40)}" for name, value in step.args.items()),
            show_span(step.start_s),
            show_span(step.duration_s),
        )
        for number, step in enumerate(outline.steps)
    ]
    show_table(("", "step", "action", "stations", "arguments", "starts at", "takes"), rows)
    click.echo(
        f"\n{outline.workflow} on {outline.workcell}: {len(outline.steps)} steps, "
        f"{show_span(outline.total_s)} alone on the bench; {len(outline.critical)} are critical (*)."
    )
    for step in outline.steps:
        if step.late_s:
            click.echo(f"{step.key!r} starts {show_span(step.late_s)} later than its window allows.")
    for step in outline.steps:
        if step.retries:
            click.echo(f"{step.key!r} is tried up to {step.retries} times more if it fails.")
    busiest = max(outline.busy_s, key=outline.busy_s.__getitem__)
    click.echo(f"Busiest: {busiest}, {show_span(outline.busy_s[busiest])}.")
    for used in outline.resources:
        of = f" of {used.capacity:g}" if used.capacity is not None else ""
        click.echo(f"Used up: {used.amount:g}{of} {used.resource} of {used.module}.")
    for stack, count in outline.labware_taken.items():
        click.echo(f"Taken: {count} from {stack}.")
    click.echo(f"Labware needed at the start: {', '.join(outline.inputs) or 'none'}.")
    click.echo(f"Labware stands at the end: {', '.join(outline.outputs) or 'nowhere'}.")

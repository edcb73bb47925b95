"""``labos plan``: the steps of a workflow, and how long it would take."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import click
import msgspec

from labos.cli._complete import make_completer
from labos.cli._out import end_with_json, show_lines, show_table
from labos.cli._payload import payload_option, read_payload
from labos.cli._query import Where, log_and_json, open_log
from labos.cli._remote import is_given
from labos.core.effects import Carrying, Claims, Needs
from labos.core.ids import StationName, local
from labos.core.lengths import Lengths
from labos.core.model import MAIN, ON_CANCEL
from labos.core.structs import make_from
from labos.core.watching import list_end_stations
from labos.errors import LabosError
from labos.planning.certificate import Certificate, find_order
from labos.planning.timetable import (
    count_taken,
    find_setups,
    make_timetable,
    sum_consumption,
    with_learned,
    with_setups,
)
from labos.services.describe import shorten_value
from labos.services.history import fold_state_at
from labos.services.times import show_span

if TYPE_CHECKING:
    from labos.core.model import PlanStep, Workcell
    from labos.planning.timetable import Slot
    from labos.spec import Compiled


class OutlineStep(msgspec.Struct):
    """A step with its times, in lab seconds from the start of the run. ``duration_s`` is its usual duration
    in the lab that was asked, if that lab has one (``learned``), else ``nominal_s``. ``rescues`` is the step
    after whose failure it runs, if there is one; ``on_cancel``: it runs after the run was cancelled. Neither
    kind has times. ``looks`` says which module observes which station afterwards, and when. ``choices`` are
    the modules that may do the step, if there are several: the other fields are for ``module``. ``setup_s``
    is the part of ``duration_s`` in which the module is set up for the step."""

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
    nominal_s: float
    learned: bool = False
    retries: int = 0
    reset: bool = False
    timeout_s: float | None = None
    on_error: str = ""
    when: str = ""
    expect: str = ""
    rescues: str = ""
    on_cancel: bool = False
    looks: list[str] = []
    choices: list[str] = []
    setup_s: float = 0.0


class Resource(msgspec.Struct):
    """The amount of a module's resource that is used up, and its capacity."""

    module: str
    resource: str
    amount: float
    capacity: float | None


class ReservedModule(msgspec.Struct):
    """A module that the run holds from the start of one step to the end of another."""

    module: str
    first: str
    last: str


class SetpointUse(msgspec.Struct):
    """A value to which a step sets a module; runs that want another value wait until this run has ended."""

    module: str
    setpoint: str
    value: Any
    step: str


class Outline(msgspec.Struct):
    """A workflow as it would run alone. ``lab`` is the folder or address of the lab that knows the usual
    durations, empty if there is none. ``certificate`` says which of its windows it can keep for all durations
    of its steps up to a tenth above or below the nominal ones."""

    workflow: str
    workcell: str
    total_s: float
    critical: list[str]
    steps: list[OutlineStep]
    busy_s: dict[str, float]
    resources: list[Resource]
    labware_taken: dict[str, int]
    inputs: list[str]
    outputs: list[str]
    holds: list[ReservedModule] = []
    setpoints: list[SetpointUse] = []
    certificate: Certificate | None = None
    lab: str = ""


@click.command("plan")
@click.argument("workflow", shell_complete=make_completer("workflow"))
@click.option(
    "--workcell",
    required=True,
    metavar="W",
    help="A workcell file, or the name of a packaged workcell, such as rpl.",
)
@payload_option
@log_and_json
def command(where: Where, workflow: str, workcell: str, payloads: tuple[str, ...]) -> None:
    """Show what WORKFLOW (a file, or a packaged workflow) would do: its steps with the values of the payload,
    their modules, stations and arguments, start times, and the consumption of resources.

    The times are for a run that is alone on the bench. If there is a lab (--home, LABOS_HOME, ./lab,
    LABOS_URL), the times come from its log: a step has the usual duration of such steps if the log has at
    least three. Such times are marked with ~. All other steps have the duration from their driver. Steps
    marked with * are critical: together they take as long as the run. For each window, the command shows
    whether a run can keep it if steps take up to a tenth longer or shorter than their drivers state.

    \b
    labos plan pcr --workcell rpl
    labos plan my.yaml --workcell my_cell.yaml --payload seal.time=4 --json
    labos plan pcr --workcell rpl --home lab

    Files that only the real bench needs may be missing. All warnings go to standard error. Exit code 1 if
    the workflow has errors.
    """
    from labos.bootstrap import descriptions
    from labos.cli._lab import find_spec_path
    from labos.planning.certified import check_windows
    from labos.spec import compile_workflow, load_workcell, read_workflow
    from labos.spec.uses import read_uses

    flow, cell = find_spec_path("workflows", workflow), find_spec_path("workcells", workcell)
    known = descriptions()
    loaded = load_workcell(cell, known, read_uses([read_workflow(flow)]))
    compiled = compile_workflow(
        flow,
        read_payload(payloads),
        loaded.workcell,
        known,
        simulate=True,
        bench=loaded.bench,
        left_out=loaded.left_out,
    )
    compiled = check_windows(compiled, loaded.workcell)
    show_lines(compiled.findings, "labos: ", err=True)
    lab, lengths, pace = _ask_lab(where)
    outline = outline_of(compiled, loaded.workcell, lengths, pace, lab)
    end_with_json(outline)
    _show_outline(outline)


def _ask_lab(where: Where) -> tuple[str, Lengths, float]:
    """The lab that was asked, the durations that it has learned, and its pace; no name if there is no lab. A
    lab that the command line does not name need not answer. Raises LabosError."""
    named = is_given("home") or is_given("database")
    if not (named or where.lab or where.database or where.home.is_dir()):
        return "", Lengths(), 1.0
    try:
        with open_log(where) as log:
            state = fold_state_at(log)
    except LabosError as error:
        if named:
            raise
        click.echo(f"labos: The lab cannot be asked for the durations of the steps: {error}", err=True)
        return "", Lengths(), 1.0
    return where.lab or where.database or str(where.home), state.lengths, state.lab.pace


def outline_of(
    compiled: Compiled, workcell: Workcell, lengths: Lengths | None = None, pace: float = 1.0, lab: str = ""
) -> Outline:
    """A compiled workflow with its times, with the durations that a lab has learned."""
    from labos.planning.certified import certify_all
    from labos.spec.choices import list_choices

    choices = list_choices(compiled.plans)
    lengths = lengths or Lengths()
    setups = find_setups(compiled.plan, workcell, find_order(compiled.plan))
    plan = with_setups(with_learned(compiled.plan, lengths, pace), setups)
    nominal = compiled.plan.steps
    times = make_timetable(plan, workcell)
    stations = _list_stations(compiled, times.slots, workcell)
    steps = [
        make_from(
            OutlineStep,
            step,
            module=local(step.module),
            after=[plan.steps[index].key for index in step.after],
            stations=stations[index],
            start_s=slot.start_s,
            end_s=slot.end_s,
            critical=index in times.critical,
            late_s=slot.late_s,
            nominal_s=nominal[index].duration_s,
            learned=not step.by_person and lengths.estimate(nominal[index], pace) is not None,
            retries=step.retry.times if step.retry else 0,
            reset=step.retry is not None and step.retry.reset is not None,
            on_error=_on_error(step),
            when=step.when.text if step.when else "",
            expect=step.expect.text if step.expect else "",
            rescues=plan.steps[step.serves].key if step.serves is not None else "",
            on_cancel=step.part == ON_CANCEL,
            looks=_list_looks(step, workcell),
            choices=choices.get(step.key, []),
            setup_s=setups.get(index, 0.0),
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
            for (module, resource), amount in sum_consumption(plan).items()
        ],
        labware_taken={local(stack): count for stack, count in count_taken(plan).items()},
        inputs=[local(place) for place in compiled.inputs],
        outputs=[local(place) for place in compiled.outputs],
        holds=[
            ReservedModule(local(hold.module), plan.steps[hold.first].key, plan.steps[hold.last].key)
            for hold in plan.holds
        ],
        setpoints=[
            SetpointUse(local(step.module), effect.setpoint, effect.value, step.key)
            for step in plan.steps
            for effect in step.effects
            if isinstance(effect, Claims)
        ],
        certificate=certify_all(compiled, workcell),
        lab=lab,
    )


def _on_error(step: PlanStep) -> str:
    """The reaction to the final failure of a step."""
    policy = step.on_error
    if policy is None:
        return "fail"
    return f"run, then {policy.then}" if policy.do == "run" else policy.do


def _list_looks(step: PlanStep, workcell: Workcell) -> list[str]:
    """The modules that observe stations after a step, before its result is accepted."""
    if step.by_person:
        return []
    places = list_end_stations(step.effects)
    return [
        f"{local(station.observer)} at {local(station.name)}"
        + (" (in doubt)" if station.verify == "on_doubt" else "")
        for station in workcell.stations
        if station.watched and station.name in places
    ]


def _list_stations(compiled: Compiled, slots: tuple[Slot, ...], workcell: Workcell) -> list[list[str]]:
    """The stations of each step: those of the labware's path, in order; else the station of the work."""
    steps = compiled.plan.steps
    found: list[list[StationName]] = [[] for _ in steps]
    here = list(compiled.inputs)
    owner = {station.name: station.module for station in workcell.stations}
    for index in sorted(range(len(steps)), key=lambda i: (steps[i].part != MAIN, slots[i].start_s, i)):
        step = steps[index]
        for effect in step.effects:
            if isinstance(effect, Carrying):
                found[index] = list(effect.entered)
                here = [place for place in here if place != effect.emptied]
                here += [effect.filled] if effect.filled else []
            elif isinstance(effect, Needs) and not found[index]:
                own = [place for place in here if owner.get(place) == step.module]
                found[index] = [effect.station] if effect.station else own
    return [[local(place) for place in places] for places in found]


def _show_outline(outline: Outline) -> None:
    from labos.planning.certified import describe_certificate
    from labos.spec.choices import describe_choices

    rows = [
        (
            f"{number}{'*' if step.critical else ''}",
            step.key,
            f"{step.module}{' (any)' if step.choices else ''}.{step.action}",
            " → ".join(step.stations),
            ", ".join(f"{name}={shorten_value(value, 40)}" for name, value in step.args.items()),
            show_span(step.start_s),
            f"{'~' if step.learned else ''}{show_span(step.duration_s)}",
        )
        for number, step in enumerate(outline.steps)
        if not step.rescues and not step.on_cancel
    ]
    show_table(("", "step", "action", "stations", "arguments", "starts at", "takes"), rows)
    click.echo(
        f"\n{outline.workflow} on {outline.workcell}: {len(rows)} steps, "
        f"{show_span(outline.total_s)} alone on the bench; {len(outline.critical)} are critical (*)."
    )
    click.echo(_describe_origin(outline))
    show_lines(describe_choices({step.key: step.choices for step in outline.steps if step.choices}))
    for step in outline.steps:
        if step.late_s:
            click.echo(f"{step.key!r} starts {show_span(step.late_s)} later than its window allows.")
    show_lines(describe_certificate(outline.certificate) if outline.certificate else ())
    for step in outline.steps:
        show_lines(_list_terms(outline, step))
    out = [step for step in outline.steps if step.on_cancel]
    if out:
        ways = [f"{s.key.removeprefix('on_cancel/')!r} ({_describe_place(s)})" for s in out]
        click.echo(f"If the run is cancelled, the necessary steps of: {', '.join(ways)}.")
    for kept in outline.holds:
        click.echo(
            f"Kept from others: {kept.module}, from the start of {kept.first!r} to the end of {kept.last!r}."
        )
    for wanted in outline.setpoints:
        click.echo(f"Set: {wanted.setpoint} of {wanted.module} to {wanted.value}, by {wanted.step!r}.")
    busiest = max(outline.busy_s, key=outline.busy_s.__getitem__)
    click.echo(f"Busiest: {busiest}, {show_span(outline.busy_s[busiest])}.")
    for used in outline.resources:
        of = f" of {used.capacity:g}" if used.capacity is not None else ""
        click.echo(f"Used up: {used.amount:g}{of} {used.resource} of {used.module}.")
    for stack, count in outline.labware_taken.items():
        click.echo(f"Taken: {count} from {stack}.")
    click.echo(f"Labware needed at the start: {', '.join(outline.inputs) or 'none'}.")
    click.echo(f"Labware at the end: {', '.join(outline.outputs) or 'nowhere'}.")


def _describe_origin(outline: Outline) -> str:
    """The origin of the times."""
    shown = [step for step in outline.steps if not step.rescues and not step.on_cancel]
    learned = sum(step.learned for step in shown)
    if not outline.lab:
        return "The times are from the drivers, not from a lab (--home)."
    if not learned:
        return f"Times are those of the drivers: {outline.lab} has too few executions of these steps."
    nominal = sum(step.nominal_s for step in shown)
    usual = sum(step.duration_s for step in shown)
    return (
        f"Times marked ~ are what {outline.lab} has learned ({learned} of {len(shown)} steps): all steps "
        f"together take {show_span(usual)}, and {show_span(nominal)} according to their drivers."
    )


def _describe_place(step: OutlineStep) -> str:
    return " → ".join(step.stations) or f"{step.module}.{step.action}"


def _list_terms(outline: Outline, step: OutlineStep) -> Iterator[str]:
    """The terms of a step besides its times, in sentences."""
    if step.setup_s:
        yield f"{step.module} is set up for {step.key!r} first: {show_span(step.setup_s)} of its time."
    if step.when:
        yield f"{step.key!r} is done only if {step.when}."
    if step.timeout_s is not None:
        yield f"{step.key!r} has an unknown outcome if it has not ended after {show_span(step.timeout_s)}."
    if step.retries:
        before = f", after a reset of {step.module}" if step.reset else ""
        yield f"{step.key!r} is tried up to {step.retries} times more if it fails{before}."
    if step.looks:
        yield f"After {step.key!r} its result is observed: {', '.join(step.looks)}."
    if step.expect:
        yield f"{step.key!r} has the expected result {step.expect}."
    rescue = [s for s in outline.steps if s.rescues == step.key and s.key != f"{step.key}/reset"]
    if rescue:
        what = ", ".join(
            f"{s.key.removeprefix(f'{step.key}/on_error/')!r} ({s.module}.{s.action})" for s in rescue
        )
        then = "goes on" if step.on_error.endswith("go_on") else "fails"
        yield f"If {step.key!r} finally fails: {what}; then the run {then}."
    elif step.on_error == "skip":
        yield f"If {step.key!r} finally fails, the run continues without it."
    elif step.on_error == "ask":
        yield f"If {step.key!r} finally fails, a person is asked."

"""``labos validate``: finds the errors of a workflow before anything moves."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click
import msgspec

from labos.cli._complete import make_completer
from labos.cli._lab import find_spec_path
from labos.cli._out import count_each, end_with_json, show_lines, show_table
from labos.cli._payload import payload_option, read_payload
from labos.cli._query import Where, log_and_json
from labos.client import LabClient
from labos.core.ids import StationName, local
from labos.core.model import MAIN
from labos.errors import LabosError, NoAnswer, Refused, SpecError
from labos.planning.certificate import Certificate
from labos.planning.certified import certify_all, check_windows, describe_certificate
from labos.services.capacity import Capacity, measure_capacity
from labos.settings import find_kernel
from labos.spec import (
    Compiled,
    CompiledWorkcell,
    Finding,
    SpecErrors,
    compile_workcell,
    compile_workflow,
    list_specs,
)
from labos.spec.choices import describe_choices, list_choices
from labos.spec.dialects import detect_kind
from labos.spec.findings import list_findings
from labos.spec.source import read
from labos.spec.uses import read_uses

ONLINE_PATIENCE_S = 2.0
"""How long to wait for a lab that does not answer."""

READY = ("IDLE", "BUSY")


class Verdict(msgspec.Struct):
    """The result of the check of a workflow on a workcell. ``certificate`` says which of its windows a run
    can keep for all durations of its steps."""

    findings: list[Finding]
    inputs: tuple[StationName, ...] = ()
    outputs: tuple[StationName, ...] = ()
    copies: Capacity | None = None
    certificate: Certificate | None = None
    modules: dict[str, str] = {}
    unreachable: list[str] = []

    @property
    def sound(self) -> bool:
        return not self.unreachable and all(f.severity != "error" for f in self.findings)


@click.command("validate", short_help="Check a workflow before anything moves.")
@click.argument("workflow", shell_complete=make_completer("workflow"))
@click.option(
    "--workcell",
    default="",
    metavar="W",
    help="A workcell file, or the name of a packaged workcell, such as rpl. Needed to check a workflow.",
)
@payload_option
@click.option("--simulate", is_flag=True, help="Files that only the real bench needs may be missing.")
@click.option("--online", is_flag=True, help="Also ask each module's node, through the running lab.")
@log_and_json
def command(
    where: Where, workflow: str, workcell: str, payloads: tuple[str, ...], simulate: bool, online: bool
) -> None:
    """Check WORKFLOW (a file, or a packaged one) against a workcell: modules, actions,
    arguments, stations, reach and grip, and labware where each step needs it. Exit code 1 if
    it has errors.

    \b
    labos validate pcr --workcell rpl
    labos validate my.yaml --workcell my_cell.yaml --payload seal.time=3
    labos validate my.yaml --workcell rpl --payload values.yaml --online
    labos validate my_cell.yaml

    Without --workcell, a workcell or labware file is checked by itself. Each finding names file, line and
    column, the problem and the remedy. If modules have coordinates, there are warnings about footprints
    that overlap and stations outside an arm's reach. There is also a warning about each window (`within`)
    that a run alone on the bench can miss if its steps take up to a tenth longer or shorter. With
    `windows: refuse` at the top of the workflow, this is an error.
    """
    if not workcell:
        _check_alone(workflow)
        return
    verdict, compiled = examine(workflow, workcell, read_payload(payloads), simulate)
    if online and compiled is not None:
        _ask(where, compiled, verdict)
    end_with_json({"sound": verdict.sound, **msgspec.to_builtins(verdict)}, int(not verdict.sound))
    _show_verdict(verdict, compiled)
    if not verdict.sound:
        click.get_current_context().exit(1)


def _check_alone(name: str) -> None:
    """Check a workcell or labware file. Raises NotFound, Exit(1); a workflow needs a workcell."""
    from labos.bootstrap import descriptions, shape_of
    from labos.spec.importing import import_spec
    from labos.spec.layout_check import check_layout

    needs = click.UsageError("To check a workflow, add --workcell.")
    if not Path(name).is_file() and name in list_specs("workflows"):
        raise needs
    path = find_spec_path("workcells", name)
    findings: list[Finding] = []
    summary = ""
    try:
        source = read(path, last_wins=True)
        kind, known = detect_kind(source)[0], descriptions()
        if kind == "workflow":
            raise needs
        found = import_spec(source, known)
        findings = list(found.findings)
        if kind == "workcell":
            findings += check_layout(source, compile_workcell(source, known), shape_of)
        summary = f"{found.name}: " + ", ".join(f"{count} {what}" for what, count in found.counts.items())
    except (SpecError, SpecErrors) as error:
        findings = list_findings(error)
    sound = all(finding.severity != "error" for finding in findings)
    end_with_json({"sound": sound, "findings": findings}, int(not sound))
    for finding in findings:
        click.echo(f"{finding.severity}: {finding.as_error()}")
    click.echo(f"{summary}, no errors." if sound else "It cannot be used.")
    if not sound:
        click.get_current_context().exit(1)


def examine(
    workflow: str, workcell: str, payload: dict[str, Any], simulate: bool
) -> tuple[Verdict, Compiled | None]:
    """Compile, dry-run and measure the capacity. Raises NotFound for a missing file."""
    from labos.bootstrap import descriptions, shape_of
    from labos.spec.layout_check import check_layout

    flow_path, cell_path = find_spec_path("workflows", workflow), find_spec_path("workcells", workcell)
    known = descriptions()
    findings: list[Finding] = []
    verdict = Verdict(findings)
    try:
        source = read(cell_path, last_wins=True)
        cell = compile_workcell(source, known, uses=read_uses([read(flow_path, last_wins=True)]))
        findings += [*cell.findings, *check_layout(source, cell, shape_of)]
        compiled = compile_workflow(
            flow_path,
            payload,
            cell.workcell,
            known,
            simulate=simulate,
            bench=cell.bench,
            left_out=cell.left_out,
        )
        verdict.certificate = certify_all(compiled, cell.workcell)
        compiled = check_windows(compiled, cell.workcell)
    except (SpecError, SpecErrors) as error:
        verdict.findings = [*findings, *list_findings(error)]
        return verdict, None
    verdict.findings = [*findings, *compiled.findings]
    verdict.inputs, verdict.outputs = compiled.inputs, compiled.outputs
    verdict.copies = _count_copies(cell, compiled)
    return verdict, compiled


def _count_copies(cell: CompiledWorkcell, compiled: Compiled) -> Capacity | None:
    if any(step.when is not None for step in compiled.plan.steps):
        return None  # the number of copies depends on results
    stock = [(item.station, item.labware, item.count) for item in cell.bench.stock]
    try:
        return measure_capacity(cell.workcell, stock, compiled.plan, compiled.inputs, others=compiled.others)
    except Refused as error:
        return Capacity(0, why=error.message)


def _ask(where: Where, compiled: Compiled, verdict: Verdict) -> None:
    """The present answers of the nodes of all modules that the workflow uses. Raises NoAnswer."""
    kernel = None if where.lab else find_kernel(where.home)
    if kernel is None and not where.lab:
        raise NoAnswer(f"No lab runs in {where.home}.", remedy="Start it: labos up WORKCELL")
    url = where.lab or (kernel.url if kernel is not None else "")
    used = list(dict.fromkeys(step.module for plan in compiled.plans for step in plan.steps))
    try:
        with LabClient(url, patience_s=ONLINE_PATIENCE_S) as client:
            heard = {found["module"]: found for found in client.ask_nodes(used)}
    except (LabosError, KeyError, TypeError) as error:
        raise NoAnswer(f"The lab at {url} gives no answer ({error}).", remedy="Try again.") from None
    for name in used:
        found = heard.get(name, {"answer": "absent"})
        answer, why = found["answer"], found.get("why", "")
        text = f"{answer}: {why}" if why else answer
        verdict.modules[local(name)] = "not in the running lab" if answer == "absent" else text
        if answer not in READY:
            verdict.unreachable.append(local(name))


def _show_verdict(verdict: Verdict, compiled: Compiled | None) -> None:
    for finding in verdict.findings:
        click.echo(f"{finding.severity}: {finding.as_error()}")
    if compiled is None:
        count = sum(finding.severity == "error" for finding in verdict.findings)
        click.echo(f"{count} error{'s' if count != 1 else ''}.")
        return
    plan = compiled.plan
    steps = sum(step.part == MAIN for step in plan.steps)
    click.echo(f"{plan.workflow} on {plan.workcell}: {steps} steps, no errors.")
    show_lines(describe_choices(list_choices(compiled.plans)))
    click.echo(f"Labware needed at the start: {count_each(map(local, verdict.inputs)) or 'none'}.")
    click.echo(f"Labware at the end: {count_each(map(local, verdict.outputs)) or 'nowhere'}.")
    show_lines(describe_certificate(verdict.certificate) if verdict.certificate else ())
    if verdict.copies is not None:
        click.echo(_describe_copies(verdict.copies))
    if verdict.modules:
        show_table(("module", "status"), list(verdict.modules.items()), gap=True)
    if verdict.unreachable:
        click.echo(f"Not ready: {', '.join(verdict.unreachable)}.")


def _describe_copies(copies: Capacity) -> str:
    if copies.capped:
        return f"At least {copies.copies} copies can be active at once."
    if not copies.copies:
        return f"No copy can start with the present stock of the bench: {copies.why.rstrip('.')}."
    noun = "copy" if copies.copies == 1 else "copies"
    return f"{copies.copies} {noun} can be active at once; one more would wait: {copies.why.rstrip('.')}."

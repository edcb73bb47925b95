"""Turns a workflow file, a payload and a workcell into a ``Plan``."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import msgspec

from labos.core.canonical import encode_canonical
from labos.core.ids import StationName
from labos.core.model import Description, Plan, Workcell
from labos.errors import SpecError
from labos.spec.bench import DEFAULT_LABWARE, DEFAULT_LID, BenchFile
from labos.spec.carriers import Carriers
from labos.spec.choices import bind_modules
from labos.spec.defaults import Defaults
from labos.spec.dialects import convert_workflow
from labos.spec.dryrun import DryRun
from labos.spec.files import FileFinder
from labos.spec.findings import Finding, FindingList, Remarks, SpecErrors, list_findings
from labos.spec.layout import Origin, UnrolledRemarks
from labos.spec.models import WhenBroken, WorkflowFile
from labos.spec.paper import Piece
from labos.spec.payloads import refuse_unused
from labos.spec.planner import CompileInputs, StepPlanner
from labos.spec.results import check_results
from labos.spec.source import Source, parse, read
from labos.spec.unroll import Unroller, with_defaults
from labos.spec.validation import expect_valid


class StartingLabware(msgspec.Struct, frozen=True):
    """Labware that a person must have put at a station before a run. ``labware`` is a type that is accepted
    there, with its lid if it needs one. ``variables`` are the required values (``{"sealed": True}``)."""

    station: StationName
    labware: str
    variables: dict[str, Any] = {}


class Compiled(msgspec.Struct, frozen=True):
    """A compiled workflow. It has a plan, the stations where labware must be at its start, and those where it
    is at its end (one entry per piece). It also has the warnings, and the content of pinned files by digest.
    ``brought`` is the labware that a person must have put there before. ``others`` are plans of the same
    steps on other modules, if the workflow has a choice; all other fields are those of ``plan``. ``windows``
    is the workflow's reaction to windows that cannot be kept for all durations, and ``written`` are the
    places of the steps with windows."""

    plan: Plan
    inputs: tuple[StationName, ...] = ()
    outputs: tuple[StationName, ...] = ()
    findings: tuple[Finding, ...] = ()
    files: dict[str, bytes] = {}
    brought: tuple[StartingLabware, ...] = ()
    others: tuple[Plan, ...] = ()
    windows: WhenBroken = "warn"
    written: dict[int, Origin] = {}

    @property
    def plans(self) -> tuple[Plan, ...]:
        """All plans from which a run can choose."""
        return (self.plan, *self.others)


def read_workflow(path: str | Path) -> Source:
    """Read a workflow file. Files it names are looked up beside it. Raises SpecError."""
    return read(path, last_wins=True)


def parse_workflow(text: str, file: str = "") -> Source:
    """Read a workflow given as text. Raises SpecError."""
    return parse(text, file, last_wins=True)


def compile_workflow(
    source: Source | str | Path,
    payload: Mapping[str, Any],
    workcell: Workcell,
    descriptions: Mapping[str, Description],
    *,
    simulate: bool = False,
    files: Mapping[str, bytes] | None = None,
    search: Iterable[Path] = (),
    bench: BenchFile | None = None,
    left_out: Mapping[str, str] | None = None,
) -> Compiled:
    """Compile a workflow.

    ``files`` are contents by the path that arguments name, as a client sends them along; other files are
    looked up beside the workflow and in the folders of ``search``. A file that is nowhere is a warning if
    ``simulate``, else an error. ``bench`` has the contents of the stacks; stacks that it does not name are
    empty. Without it, the contents of all stacks are unknown. ``left_out`` are modules of the workcell's file
    that the workcell does not have, and why. Raises SpecError or SpecErrors.
    """
    source = source if isinstance(source, Source) else read_workflow(source)
    report = FindingList(source.file)
    form, dialect = convert_workflow(source, report)
    file = expect_valid(WorkflowFile, form, report)
    finder = FileFinder(files or {}, [*([source.folder] if source.folder else []), *search])
    bound = bind_modules(file, workcell, Remarks(form, report))
    report.raise_if_failed()
    known = (source, form, dialect != "labos", payload, workcell, descriptions, finder)
    given = CompileInputs(*known, simulate, bench, left_out or {})
    found: list[Compiled] = []
    for one in bound:
        try:
            found.append(_compile(one.file, given, FindingList(source.file)))
        except SpecErrors as errors:
            raise SpecErrors([_with_choice(each, one.chosen) for each in errors.findings]) from None
        for each in found[-1].findings:
            report.keep(each)
    first, *others = found
    _refuse_unlike(found, form, report)
    return msgspec.structs.replace(
        first,
        findings=report.sort_findings(),
        files={name: content for each in found for name, content in each.files.items()},
        others=tuple(each.plan for each in others),
    )


def _with_choice(finding: Finding, chosen: Mapping[str, str]) -> Finding:
    """A finding with the chosen modules for which it was made, if there is a choice."""
    if not chosen:
        return finding
    by = ", ".join(f"{name!r} by {module}" for name, module in chosen.items())
    return msgspec.structs.replace(finding, message=f"With {by}: {finding.message}")


def _refuse_unlike(found: Sequence[Compiled], form: Source, report: FindingList) -> None:
    """Raises SpecErrors for plans that differ in more than their modules."""
    keys = [[(step.key, step.part) for step in each.plan.steps] for each in found]
    if any(other != keys[0] for other in keys):
        remedy = "Name the `module:` of transfers to and from modules that are chosen."
        Remarks(form, report).error("The steps depend on which modules are chosen.", ("steps",), remedy)
        report.raise_if_failed()


def _compile(file: WorkflowFile, given: CompileInputs, report: FindingList) -> Compiled:
    """Compile a workflow in which each step has one module. Raises SpecErrors."""
    payload, workcell, finder, form = given.payload, given.workcell, given.finder, given.form
    unroller = Unroller(report, finder, Defaults(workcell), Carriers(workcell, given.descriptions))
    layout = unroller.unroll(file, form, _make_payload(file, payload), foreign=given.foreign)
    report.raise_if_failed()
    remarks = UnrolledRemarks(form, report, layout)
    planner = StepPlanner(file, layout, remarks, given)
    planner.pinned.update(unroller.pinned)
    planner.contents.update(unroller.contents)
    plan = planner.plan()
    report.raise_if_failed()
    check_results(plan, planner.described, planner.remarks)
    plan, dry = planner.do_dry_run(plan)
    report.raise_if_failed()
    refuse_unused(payload, file, (given.source, form), finder, report)
    report.raise_if_failed()
    brought = [_make_starting_labware(dry, *taken) for taken in dry.taken if not taken[1].fresh]
    brought += [
        _make_starting_labware(dry, stack, Piece(dry.stock.get(stack, ""), fresh=True))
        for stack in dry.missing
    ]
    return Compiled(
        plan,
        tuple(dry.inputs),
        dry.list_outputs(),
        report.sort_findings(),
        planner.contents,
        tuple(brought),
        windows=file.windows or "warn",
        written={
            index: remarks.find_origin(("steps", index, "within"))
            for index, step in enumerate(plan.steps)
            if any(window.within_s is not None for window in step.windows)
        },
    )


def validate_workflow(
    source: Source | str | Path,
    payload: Mapping[str, Any],
    workcell: Workcell,
    descriptions: Mapping[str, Description],
    **options: Any,
) -> list[Finding]:
    """The faults of a workflow; it never raises because of the content of the file or the payload."""
    try:
        return list(compile_workflow(source, payload, workcell, descriptions, **options).findings)
    except (SpecError, SpecErrors) as error:
        return list_findings(error)


def _make_starting_labware(dry: DryRun, place: StationName, piece: Piece) -> StartingLabware:
    kind = piece.kind or (dry.stations[place].accepts or (DEFAULT_LABWARE,))[0]
    variables = dict(piece.at_first)
    is_lidded = variables.pop("lidded", False) and DEFAULT_LID in dry.labware
    return StartingLabware(place, f"{kind}+{DEFAULT_LID}" if is_lidded else kind, variables)


def _make_payload(file: WorkflowFile, payload: Mapping[str, Any]) -> dict[str, Any]:
    """The payload with the defaults of declared parameters."""
    try:
        encode_canonical(dict(payload))
    except (TypeError, ValueError, RecursionError) as error:
        raise SpecError(
            f"The payload cannot be recorded: {error}",
            field="payload",
            remedy="Send finite numbers, text, true, false, null, lists and tables only.",
        ) from None
    return with_defaults(file, payload)

"""Campaigns over HTTP: each is checked as a whole, stored as blobs, and submitted row by row."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping, Sequence
from typing import Any

import msgspec

from labos.core.approvals import ApprovalGiven
from labos.core.campaigns import Budget, Campaign, CampaignAmended, CampaignSubmitted, Terms
from labos.core.conditions import find_reads
from labos.core.decide.campaigns import SubmitCampaign
from labos.core.decide.policy import sum_demand
from labos.core.decide.runs import NOBODYS
from labos.core.ids import CampaignId, split_level_key, workcell_of
from labos.core.model import Plan
from labos.core.state import LabState
from labos.core.structs import make_from
from labos.core.users import find_person
from labos.core.viewer import Visibility
from labos.errors import BadInput, KeyReused, NotFound, SpecError
from labos.http.bodies import Amendment, Clone, NewCampaign
from labos.http.campaign_rows import explain_no_time, read_definition, read_table, take_due
from labos.http.service import LabService
from labos.planning.certified import check_windows
from labos.planning.lab_forecast import LabForecast
from labos.ports import LogQuery
from labos.services.log import Log, decode_events
from labos.services.times import parse_until
from labos.spec import SpecErrors, compile_workflow, parse_workflow
from labos.spec.campaign import CampaignFile, CampaignSource, RowsEntry, parse_campaign, stop_rule
from labos.spec.findings import Finding, FindingList, make_finding, suggest_name
from labos.spec.rows import TableLine
from labos.spec.source import parse

MOST_CHECKED = 2_000
"""The largest number of rows of one campaign that are planned before its submission; of a longer table so
many, evenly spread."""

CHECKED_AT_ONCE = 10
"""The number of rows that are planned without a pause, while the kernel waits for the processor."""


class ConsumableEstimate(msgspec.Struct, frozen=True):
    """The amount of a consumable that all rows use up, and the amount that is left in the lab (null: it is
    not counted)."""

    needed: float
    left: float | None


class Estimate(msgspec.Struct, frozen=True):
    """The work and material that a campaign needs. ``checked`` of its ``rows`` were planned; times are
    nominal, in lab seconds, and by module; ``bounds_s`` is what the busiest module needs for all rows."""

    name: str
    workflow: str
    workcell: str
    rows: int
    checked: int
    module_time_s: float
    modules: dict[str, float]
    bounds_s: float
    busiest: str
    consumables: dict[str, ConsumableEstimate]
    findings: tuple[Finding, ...] = ()


class CampaignView(msgspec.Struct, frozen=True):
    """``status``: proposed, open, paused, stopped or cancelled. ``left`` is the number of its ``rows`` that
    have not been submitted as runs. ``lab_time_s`` is the used module time, and ``used`` are the used
    consumables. ``visibility``: who sees it (lab, group or private). ``cloned_from`` is the campaign from
    which it was copied."""

    id: str
    name: str
    user: str
    workflow: str
    workcell: str
    status: str
    why: str
    rows: int
    queued: int
    active: int
    completed: int
    failed: int
    cancelled: int
    refused: int
    left: int
    lab_time_s: float
    used: dict[str, float]
    terms: Terms
    visibility: Visibility
    cloned_from: str


class CheckedCampaign(msgspec.Struct):
    """A campaign whose rows are checked: the plan of each row that was planned, and in ``rows`` all plans
    between which each of them chooses."""

    new: NewCampaign
    content: CampaignSource
    workcell: str
    report: FindingList
    plans: list[Plan] = []
    rows: list[tuple[Plan, ...]] = []
    findings: dict[Finding, bool] = {}


async def submit_campaign(service: LabService, new: NewCampaign, request: str) -> tuple[str, Estimate]:
    """Check the whole campaign, store its table and workflow, and submit it; with ``dry_run``, only check.
    Raises SpecError, SpecErrors with each fault and its row, NotFound, Refused, KeyReused."""
    return await keep_campaign(service, await _read(service, new), request)


async def keep_campaign(
    service: LabService, checked: CheckedCampaign, request: str, cloned_from: CampaignId = NOBODYS
) -> tuple[str, Estimate]:
    """Store the table and workflow of a checked campaign, and submit it. Raises Refused, KeyReused."""
    new, estimate = checked.new, _estimate(service, checked)
    if new.dry_run:
        return "", estimate
    table = b"\n".join(msgspec.json.encode(line.payload) for line in checked.content.lines)
    blobs = service.parts.blobs
    command = msgspec.structs.replace(
        _command(checked, estimate),
        table=await asyncio.to_thread(blobs.put, table),
        definition=await asyncio.to_thread(blobs.put, msgspec.json.encode(new.workflow)),
        request=request,
        cloned_from=cloned_from,
    )
    known = service.kernel.state.campaigns.requests
    if request in known:
        _expect_same(service, known[request], command)
    events = await service.kernel.execute(command, new.user)
    if not events:
        await service.kernel.flush()
    campaign = known[request] if request else getattr(events[0], "campaign", "")
    return str(campaign), estimate


async def clone_campaign(
    service: LabService, name: str, asked: Clone, user: str, request: str
) -> tuple[str, Estimate]:
    """Submit a copy of a campaign, also of one that has ended; with ``dry_run``, only check it. Raises
    SpecErrors with each fault and its row, NotFound, Refused, KeyReused."""
    service.expect_role(user, "submitter")
    first, terms = await asyncio.to_thread(_read_submitted, service.parts.store, name)
    blobs = service.parts.blobs
    workflow = await asyncio.to_thread(read_definition, blobs, first.definition)
    table = await asyncio.to_thread(read_table, blobs, first.table)
    terms = amend_terms(msgspec.structs.replace(terms, deadline=0), asked, service.kernel.clock.now_ns())
    file = CampaignFile(
        labos=1,
        campaign=asked.name or first.name,
        workflow=workflow.name,
        rows=RowsEntry(),
        due=first.due,
        visibility=asked.visibility or service.kernel.state.campaigns.visibility_of(first.campaign),
    )
    rows = [TableLine(table.read_row(number), f"rows of {name}") for number in range(len(table))]
    content = CampaignSource(file, parse("labos: 1\n", f"campaign {name}"), rows, terms)
    new = NewCampaign(
        text="",
        workflow=workflow,
        user=user,
        name=f"campaign {name}",
        dry_run=asked.dry_run,
        propose=asked.propose,
    )
    checked = await check_rows(service, new, content, first.workcell)
    return await keep_campaign(service, checked, request, first.campaign)


async def forecast_campaign(service: LabService, new: NewCampaign) -> tuple[Estimate, LabForecast]:
    """Check the whole campaign, and make its forecast. Raises as ``submit_campaign``."""
    checked = await _read(service, new)
    estimate = _estimate(service, checked)
    return estimate, await service.forecasts.forecast(_command(checked, estimate), new.user, checked.rows)


async def _read(service: LabService, new: NewCampaign) -> CheckedCampaign:
    """Read the file of a campaign, and check it."""
    service.expect_role(new.user, "submitter")  # before anything is planned or stored
    content = await service.run_beside(len(new.text), parse_campaign, new.text, new.name, new.files)
    terms = msgspec.structs.replace(content.terms, deadline=_parse_deadline(service, content))
    content = msgspec.structs.replace(content, terms=terms)
    workcell = await service.find_workcell_for(new.workflow, content.file.workcell)
    return await check_rows(service, new, content, workcell)


def _read_submitted(log: Log, name: str) -> tuple[CampaignSubmitted, Terms]:
    """The submitted campaign, and its last terms. Raises NotFound."""
    kinds: tuple[Any, ...] = (CampaignSubmitted, CampaignAmended, ApprovalGiven)
    query = LogQuery(streams=(name,), types=tuple(kind.TYPE for kind in kinds))
    first: CampaignSubmitted | None = None
    terms = Terms()
    for event, _ in decode_events(log.select(query)):
        if isinstance(event, CampaignSubmitted):
            first, terms = event, event.terms
        elif isinstance(event, CampaignAmended | ApprovalGiven):
            terms = event.terms or terms
    if first is None:
        raise NotFound(f"There is no campaign {name!r}.", remedy="List them: labos campaign list")
    return first, terms


def _command(checked: CheckedCampaign, estimate: Estimate) -> SubmitCampaign:
    """The command without its blobs."""
    new, content = checked.new, checked.content
    return SubmitCampaign(
        name=estimate.name,
        user=find_person(new.user),
        workflow=estimate.workflow,
        workcell=estimate.workcell,
        rows=estimate.rows,
        table="",
        definition="",
        terms=content.terms,
        demand=sum_demand(checked.plans, estimate.rows / len(checked.plans)),
        propose=new.propose,
        visibility=content.file.visibility,
        due=content.file.due,
    )


def _expect_same(service: LabService, name: CampaignId, command: SubmitCampaign) -> None:
    """Raises KeyReused if the campaign with this key is a different one; a campaign that has been completed
    is not compared."""
    known = service.kernel.state.campaigns.open.get(name)
    if known is None:
        return
    asked = (command.name, command.user, command.table, command.definition)
    if (known.name, known.user, known.table, known.definition) != asked:
        raise KeyReused(
            f"The key {command.request!r} belongs to {name}, {known.name!r} of {known.user}, which has other "
            "rows or another workflow.",
            remedy="Give a new campaign a key of its own.",
        )


def _parse_deadline(service: LabService, content: CampaignSource) -> int:
    if not content.file.deadline:
        return 0
    now = service.kernel.clock.now_ns()
    try:
        found = parse_until(content.file.deadline, now)
    except BadInput as error:
        raise content.source.error(error.message, ("deadline",), remedy=error.remedy) from None
    if found <= now:
        raise content.source.error(
            "The deadline has passed.", ("deadline",), remedy="Give a time in the future."
        )
    return found


def _choose_rows(lines: Sequence[TableLine]) -> list[int]:
    """The rows that are planned before the submission: all, or so many, evenly spread."""
    if len(lines) <= MOST_CHECKED:
        return list(range(len(lines)))
    last = len(lines) - 1
    return sorted({round(last * part / (MOST_CHECKED - 1)) for part in range(MOST_CHECKED)})


async def check_rows(
    service: LabService, new: NewCampaign, content: CampaignSource, workcell: str
) -> CheckedCampaign:
    """Plan rows. Raises SpecErrors with the faults of all rows."""
    cell = service.workcell(workcell).name
    checked, rows = CheckedCampaign(new, content, cell, FindingList(new.name)), _choose_rows(content.lines)
    for first in range(0, len(rows), CHECKED_AT_ONCE):
        part = rows[first : first + CHECKED_AT_ONCE]
        await service.run_beside(len(new.workflow.text) * len(part), _plan_rows, service, checked, part)
    _check_stop_rule(checked)
    checked.report.raise_if_failed()
    return checked


def _plan_rows(service: LabService, checked: CheckedCampaign, rows: Sequence[int]) -> None:
    new, content = checked.new, checked.content
    cell, bench = service.workcell(checked.workcell), service.read_bench(checked.workcell)
    source = parse_workflow(new.workflow.text, new.workflow.name)
    for row in rows:
        line = content.lines[row]
        payload, due = take_due(line.payload, content.file.due)
        if content.file.due and (wrong := explain_no_time(due)):
            place = line.place_of(f"payload.{content.file.due}")
            checked.report.error(
                f"Row {row + 1}: {wrong}",
                place,
                field=content.file.due,
                remedy="Write 2026-05-04T10:30, or nothing.",
            )
        try:
            compiled = compile_workflow(
                source,
                payload,
                cell,
                service.parts.descriptions,
                simulate=service.parts.simulated,
                files=new.workflow.files,
                bench=bench,
            )
            compiled = check_windows(compiled, cell)
        except SpecErrors as errors:
            for finding in errors.findings:
                if finding.severity == "error":
                    _report_row(checked.report, row, line, finding, source.text)
        except SpecError as error:
            _report_row(checked.report, row, line, make_finding(error), source.text)
        else:
            checked.plans.append(compiled.plan)
            checked.rows.append(compiled.plans)
            checked.findings.update(dict.fromkeys(compiled.findings, True))


def _report_row(report: FindingList, row: int, line: TableLine, finding: Finding, workflow: str) -> None:
    """Report a fault of a row, at its place in the table: at the value that the faulty line of the workflow
    uses, if it names one. The place in the workflow follows."""
    where, field = "", finding.field
    if finding.file and finding.line:
        where = f" ({finding.file}:{finding.line}:{finding.column})"
        written = workflow.splitlines()[finding.line - 1 : finding.line]
        taken = [key for key in line.columns if any(key in text for text in written)]
        field = f"payload.{max(taken, key=len)}" if taken else field
    report.error(
        f"Row {row + 1}: {finding.message}{where}",
        line.place_of(field),
        field=field,
        remedy=finding.remedy,
        file=line.file,
    )


def _check_stop_rule(checked: CheckedCampaign) -> None:
    until = checked.content.terms.until
    if until is None or not checked.plans:
        return
    known = {step.key for plan in checked.plans for step in plan.steps}
    for key in sorted(find_reads(until) - known):
        place = checked.content.source.place(("until",))
        remedy = suggest_name(key, known, "step")
        checked.report.error(f"The workflow has no step {key!r}.", place, field="until", remedy=remedy)


def _estimate(service: LabService, checked: CheckedCampaign) -> Estimate:
    plans, rows = checked.plans, len(checked.content.lines)
    asked = sum_demand(plans, rows / len(plans))
    busiest = max(asked.modules, key=asked.modules.__getitem__)
    return Estimate(
        name=checked.content.file.campaign,
        workflow=plans[0].workflow,
        workcell=checked.workcell,
        rows=rows,
        checked=len(plans),
        module_time_s=asked.module_time_s,
        modules=asked.modules,
        bounds_s=asked.modules[busiest],
        busiest=busiest,
        consumables=estimate_consumables(service, checked.workcell, asked.consumables),
        findings=tuple(checked.findings),
    )


def estimate_consumables(
    service: LabService, workcell: str, needed: Mapping[str, float]
) -> dict[str, ConsumableEstimate]:
    """The needed amounts of consumables, and how much of each is left in all modules of a workcell."""
    left: dict[str, float] = {}
    for name, level in service.kernel.state.resources.levels.items():
        module, kind = split_level_key(name)
        if workcell_of(module) == workcell:
            left[kind] = left.get(kind, 0.0) + level.level
    return {kind: ConsumableEstimate(amount, left.get(kind)) for kind, amount in needed.items()}


def amend_terms(terms: Terms, asked: Amendment, now: int) -> Terms:
    """The terms after the requested change. Raises BadInput."""
    budget = Budget(
        terms.budget.runs if asked.runs is None else asked.runs,
        terms.budget.lab_time_s if asked.lab_time_s is None else asked.lab_time_s,
        terms.budget.consumables if asked.consumables is None else asked.consumables,
    )
    changes: dict[str, Any] = {"budget": budget}
    if asked.priority is not None:
        changes["priority"] = asked.priority
    if asked.deadline is not None:
        changes["deadline"] = parse_until(asked.deadline, now) if asked.deadline else 0
    if asked.tags is not None:
        changes["tags"] = tuple(asked.tags)
    if asked.until is not None:
        changes["until"] = stop_rule(asked.until) if asked.until else None
    if asked.stop_after is not None:
        changes["stop_after"] = asked.stop_after
    return msgspec.structs.replace(terms, **changes)


def make_view(state: LabState, campaign: Campaign) -> CampaignView:
    return make_from(
        CampaignView,
        campaign,
        active=len(campaign.runs) - campaign.queued,
        lab_time_s=campaign.spent_ns / 1e9 * state.lab.pace,
        visibility=state.campaigns.visibility_of(campaign.id),
    )

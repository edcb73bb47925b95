"""The forecast of a lab: when its runs start and end, when a person is needed, and what a new submission
changes.

A copy of the state is simulated in virtual time (``virtual``), with the usual durations. The ranges are as
wide as the errors of past forecasts (``hindsight``).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import msgspec

from labos.core.booked import find_blocked
from labos.core.campaigns import CampaignSubmitted
from labos.core.decide import Command, Rejection
from labos.core.decide.campaigns import SubmitCampaign
from labos.core.decide.composites import SubmitWithLabware
from labos.core.decide.runs import SubmitRun
from labos.core.ids import CampaignId, ModuleName, RunId, local
from labos.core.model import Plan
from labos.core.modules import ModuleStatus
from labos.core.runs import RunSubmitted
from labos.core.state import LabState, encode_picture, from_picture
from labos.planning.forecast import find_usual_time
from labos.planning.hindsight import Hindsight, TimeRange
from labos.planning.own_order import OwnOrder
from labos.planning.virtual import MOST_RUNS, MOST_STEPS, Play, VirtualLab, keep_first

LATER_S = 1.0
"""The smallest delay of a run that is reported (seconds of wall time)."""


class ExpectedRun(msgspec.Struct, frozen=True):
    """What is expected of a run. ``starts`` and ``ends`` are null if they are not in sight; if the run has
    started, ``starts`` is that time. ``starts_alone`` and ``ends_alone`` are expected if nothing more is
    submitted. ``waits``: why it fails, or does not end without a person. ``modules``: those that it is
    expected to choose, by step key. ``due_at`` is its due date (UTC ns, 0: none). ``late_by_s`` is its
    expected delay (seconds of wall time): negative if it has time to spare; null if it has no due date, or
    its end is not in sight."""

    run: str
    workflow: str
    user: str
    campaign: str
    starts: TimeRange | None
    ends: TimeRange | None
    starts_alone: TimeRange | None = None
    ends_alone: TimeRange | None = None
    waits: str = ""
    modules: dict[str, str] = {}
    due_at: int = 0
    late_by_s: float | None = None


class ExpectedCampaign(msgspec.Struct, frozen=True):
    """What is expected of a campaign. The first ``rows_forecast`` of the rows that are left were simulated.
    If these are not all, ``ends`` assumes the same rate for the others."""

    campaign: str
    name: str
    starts: TimeRange | None
    ends: TimeRange | None
    rows_left: int
    rows_forecast: int
    waits: str = ""


class ExpectedTouch(msgspec.Struct, frozen=True):
    """When a person is needed, why, and what is to be done (``remedy``). ``planned``: a workflow asks for
    it."""

    at: TimeRange
    why: str
    remedy: str
    run: str
    planned: bool


class Delay(msgspec.Struct, frozen=True):
    """A run that would end later because of the new submission, by ``by_s`` seconds of wall time; null: it
    would not end without a person."""

    run: str
    user: str
    campaign: str
    by_s: float | None


class LabForecast(msgspec.Struct, frozen=True):
    """What is expected of a lab from ``now_at`` on (UTC ns). Ranges are as wide as the errors of the
    forecasts of ``learned_from`` ended runs; with fewer than ten, assumed errors count too. ``left_out``
    waiting runs were not simulated. ``cut``: the simulation was stopped early. ``new`` are the runs of the
    new submission; ``delays`` and ``conflicts`` are its consequences; ``refusal`` is why it would be
    refused."""

    now_at: int
    learned_from: int
    runs: list[ExpectedRun] = []
    campaigns: list[ExpectedCampaign] = []
    touches: list[ExpectedTouch] = []
    left_out: int = 0
    cut: bool = False
    new: list[str] = []
    delays: list[Delay] = []
    conflicts: list[str] = []
    refusal: str = ""


class ForecastRequest(msgspec.Struct):
    """What is asked: a state as a picture, and a time (UTC ns). ``new`` is a possible submission. If it is a
    campaign, ``new_rows`` has the plans of each row, from which its run chooses one. ``rows`` are those of
    known campaigns. ``hindsight`` has the errors of past forecasts. ``approved`` is used in place of ``new``:
    a submission that waits for an approval and goes on in the simulation. ``orders`` are those that the lab
    has found by itself; None if it follows the order by age."""

    picture: bytes
    now: int
    hindsight: Hindsight = msgspec.field(default_factory=Hindsight)
    rows: dict[CampaignId, list[tuple[Plan, ...]]] = {}
    new: SubmitRun | SubmitWithLabware | SubmitCampaign | None = None
    actor: str = ""
    new_rows: list[tuple[Plan, ...]] = []
    approved: str = ""
    most_runs: int = MOST_RUNS
    most_steps: int = MOST_STEPS
    orders: dict[str, OwnOrder] | None = None


def forecast_lab(request: ForecastRequest) -> LabForecast:
    """The forecast for a request. With a new submission, the lab is simulated with and without it."""
    base = from_picture(request.picture)
    left_out = keep_first(base, request.most_runs)
    base.recorded_at = max(base.recorded_at, request.now)
    forecaster = _Forecaster(request, encode_picture(base))
    play = forecaster.play()
    learned = len(request.hindsight.ended)
    if forecaster.refusal:
        return LabForecast(request.now, learned, left_out=left_out, refusal=forecaster.refusal)
    asks = request.new is not None or bool(request.approved)
    before = forecaster.play(without=True) if asks else None
    campaigns = _list_campaigns(forecaster, play)
    conflicts = list(_list_conflicts(forecaster, base, play)) if asks else []
    return LabForecast(
        now_at=request.now,
        learned_from=learned,
        runs=[_run(forecaster, play, name) for name in play.users],
        campaigns=campaigns,
        touches=_list_touches(forecaster, play),
        left_out=left_out,
        cut=play.cut,
        new=[str(name) for name in play.users if _is_new(forecaster, play, name)],
        delays=[
            delay
            for delay in (_list_delays(before, play) if before is not None else ())
            if forecaster.new not in (delay.run, delay.campaign) or not request.approved
        ],
        conflicts=conflicts,
    )


class _Forecaster:
    """Simulates copies of a state. ``new`` is the run or campaign that is not submitted or approved yet."""

    def __init__(self, request: ForecastRequest, base: bytes) -> None:
        self.request, self.base = request, base
        self.workflows: dict[RunId, str] = {}
        self.ages: dict[RunId, int] = {}
        self.due: dict[RunId, int] = {}
        self.campaigns: dict[CampaignId, tuple[str, int]] = {}
        self.new, self.refusal = "", ""

    def play(self, *, without: bool = False) -> Play:
        """The simulation with the usual durations, with the new submission or without it."""
        asked = self.request
        state = from_picture(self.base)
        rows: dict[CampaignId, Sequence[tuple[Plan, ...]]] = dict(asked.rows)
        fresh = CampaignId(f"C{state.campaigns.named + 1}")
        if not without and isinstance(asked.new, SubmitCampaign):
            rows[fresh] = asked.new_rows
        lab = VirtualLab(
            state,
            asked.now,
            lambda _, step: find_usual_time(state, step),
            rows,
            most_rows=asked.most_runs,
            most_steps=asked.most_steps,
            orders=asked.orders,
        )
        if asked.new is not None and not without:
            self._submit(lab, asked.new)
        if asked.approved and not without:
            lab.approve(asked.approved)
            self.new = asked.approved
        for campaign in state.campaigns.open.values():
            self.campaigns[campaign.id] = (campaign.name, campaign.left)
        for run in [*state.runs.active.values(), *state.runs.queued.values()]:
            self.workflows[run.id] = run.workflow
            self.ages[run.id] = max(0, asked.now - run.submitted_at)
            self.due[run.id] = run.due_at
        return lab.go_on()

    def expect(
        self, what: str, foreseen: int | None, age: int = 0
    ) -> tuple[TimeRange | None, TimeRange | None]:
        """The ranges around a foreseen time (UTC ns; None: not in sight) of a run that was submitted ``age``
        ns ago: the usual one, and the one if nothing more is submitted. ``what`` is `starts` or `ends`."""
        if foreseen is None:
            return None, None
        ranges = self.request.hindsight.expect(what, foreseen, self.request.now, age)
        return ranges.usual, ranges.alone

    def _submit(self, lab: VirtualLab, command: Command) -> None:
        answer = lab.submit(command, self.request.actor)
        if isinstance(answer, Rejection):
            self.refusal = f"{answer.message} {answer.remedy}".strip()
            return
        for event in answer:
            match event:
                case RunSubmitted():
                    self.new = str(event.run)
                case CampaignSubmitted():
                    self.new = str(event.campaign)
                case _:
                    pass


def _is_new(forecaster: _Forecaster, play: Play, name: RunId) -> bool:
    return bool(forecaster.new) and forecaster.new in (name, play.members.get(name))


def _run(forecaster: _Forecaster, play: Play, name: RunId) -> ExpectedRun:
    age = forecaster.ages.get(name, 0)
    starts, starts_alone = forecaster.expect("starts", play.starts.get(name), age)
    ends, ends_alone = forecaster.expect("ends", play.ends.get(name), age)
    due_at = forecaster.due.get(name, 0)
    return ExpectedRun(
        run=str(name),
        workflow=forecaster.workflows.get(name, ""),
        user=play.users[name],
        campaign=str(play.members.get(name, "")),
        starts=starts,
        ends=ends,
        starts_alone=starts_alone,
        ends_alone=ends_alone,
        waits=play.failed.get(name, "") or ("" if ends is not None else play.stays.get(name, "")),
        modules=play.modules.get(name, {}),
        due_at=due_at,
        late_by_s=(ends.expected_at - due_at) / 1e9 if due_at and ends is not None else None,
    )


def _list_campaigns(forecaster: _Forecaster, play: Play) -> list[ExpectedCampaign]:
    found: list[ExpectedCampaign] = []
    for name, (title, left) in forecaster.campaigns.items():
        runs = [run for run, member in play.members.items() if member == name]
        fresh = [run for run in runs if run not in forecaster.workflows]
        begun = [play.starts[run] for run in runs if run in play.starts]
        over = [play.ends[run] for run in runs if run in play.ends]
        is_seen = bool(runs) and len(over) == len(runs)
        end = _extrapolate(begun, over, max(0, left - len(fresh))) if is_seen else None
        starts, _ = forecaster.expect("starts", min(begun, default=None))
        ends, _ = forecaster.expect("ends", end)
        found.append(
            ExpectedCampaign(
                campaign=str(name),
                name=title,
                starts=starts,
                ends=ends,
                rows_left=left,
                rows_forecast=len(fresh),
                waits=next((play.stays[run] for run in runs if run in play.stays), ""),
            )
        )
    return found


def _extrapolate(starts: Sequence[int], ends: Sequence[int], rest: int) -> int:
    """When ``rest`` more rows would have ended (UTC ns), at the rate of the later half of the simulated
    ones."""
    ordered = sorted(ends)
    half = len(ordered) // 2
    if rest and half:
        return ordered[-1] + rest * (ordered[-1] - ordered[half - 1]) // (len(ordered) - half)
    return ordered[-1] + rest * (ordered[-1] - min(starts))


def _list_touches(forecaster: _Forecaster, play: Play) -> list[ExpectedTouch]:
    """The times when a person is needed, in order."""
    found: list[ExpectedTouch] = []
    request = forecaster.request
    for touch in play.touches:
        at = TimeRange(touch.at, touch.at, touch.at)
        if touch.at > request.now:
            at = request.hindsight.expect("ends", touch.at, request.now).usual
        found.append(ExpectedTouch(at, touch.why, touch.remedy, touch.run, touch.planned))
    return sorted(found, key=lambda touch: touch.at.expected_at)


def _list_delays(before: Play, after: Play) -> Iterator[Delay]:
    for name, ended in before.ends.items():
        later = after.ends.get(name)
        if later is None and after.cut:
            continue
        by_s = None if later is None else (later - ended) / 1e9
        if by_s is None or by_s >= LATER_S:
            yield Delay(str(name), before.users[name], str(before.members.get(name, "")), by_s)


# -- conflicts -----------------------------------------------------------------------------------


def _list_sure_to_use(plans: Sequence[Plan]) -> list[ModuleName]:
    """The modules that a run uses with each of these plans."""
    first, *others = ({step.module: True for step in plan.steps} for plan in plans)
    return [module for module in first if all(module in other for other in others)]


def _list_conflicts(forecaster: _Forecaster, state: LabState, play: Play) -> Iterator[str]:
    """The conflicts of a submission that is not made or approved yet, as sentences."""
    request = forecaster.request
    user, deadline, rows = _describe_request(request, state)
    modules = {module: True for plans in rows for module in _list_sure_to_use(plans)}
    for name in modules:
        module = state.modules.by_name.get(name)
        if module is None or module.out_of_service or module.status == ModuleStatus.GONE:
            yield f"{local(name)} is unavailable, or out of service."
    ends = [end for name, end in play.ends.items() if _is_new(forecaster, play, name)]
    last, _ = forecaster.expect("ends", max(ends, default=None))
    yield from _list_booked(state, user, modules, request.now, last.latest_at if last else request.now)
    if deadline:
        if last is None or last.expected_at > deadline:
            yield "The deadline would be missed."
        elif last.latest_at > deadline:
            yield "The deadline may be missed."
    stays = [why for name, why in play.stays.items() if _is_new(forecaster, play, name)]
    if stays:
        yield f"{len(stays)} of its runs would wait for a person: {stays[0]}."


def _describe_request(request: ForecastRequest, state: LabState) -> tuple[str, int, Sequence[Sequence[Plan]]]:
    """The user of the new submission, its deadline (UTC ns, 0: none), and the plans of its runs."""
    command = request.new
    if isinstance(command, SubmitCampaign):
        return command.user, command.terms.deadline, request.new_rows
    if command is not None:
        run = command.run if isinstance(command, SubmitWithLabware) else command
        return run.user, 0, [run.plans]
    known = state.runs.queued.get(RunId(request.approved))
    if known is not None:
        return known.user, 0, [[state.runs.plans[one].plan for one in known.choices or (known.plan,)]]
    campaign = state.campaigns.open.get(CampaignId(request.approved))
    if campaign is None:
        return "", 0, []
    proposal = state.approvals.open.get(request.approved)
    terms = (proposal.terms if proposal is not None else None) or campaign.terms
    return campaign.user, terms.deadline, request.rows.get(campaign.id, [])


def _list_booked(
    state: LabState, user: str, modules: dict[ModuleName, bool], since: int, until: int
) -> Iterator[str]:
    for name in modules:
        spans = find_blocked(state, user, name, since, until) if since < until else []
        if spans:
            yield f"{local(name)} is booked for {state.bookings.open[spans[0].booking].whom} meanwhile."

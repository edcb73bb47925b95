"""What is to be expected of a lab: when its runs start and end, when a person is needed, and what something
that is not submitted yet would change.

A copy of the state is carried on several times (``virtual``), with durations drawn from what was learned.
The same step takes the same time in the plays with and without what is new, so that they differ by nothing
else.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterator, Sequence
from functools import partial

import msgspec

from labos.core.actions import Action
from labos.core.booked import find_blocked
from labos.core.campaigns import CampaignSubmitted
from labos.core.decide import Command, Rejection
from labos.core.decide.campaigns import SubmitCampaign
from labos.core.decide.composites import SubmitWithLabware
from labos.core.decide.runs import SubmitRun
from labos.core.ids import CampaignId, ModuleName, RunId, local
from labos.core.model import Plan, PlanStep
from labos.core.modules import ModuleStatus
from labos.core.runs import RunSubmitted
from labos.core.state import LabState, from_picture, picture
from labos.planning.durations import Spreads, quantile
from labos.planning.newcomers import Newcomers
from labos.planning.virtual import MOST_RUNS, MOST_STEPS, Play, VirtualLab, keep_first

LOW, HIGH = 0.1, 0.9
"""The quantiles between which a range lies."""

STEPS = 3_000
"""About so many steps are started in all plays of a forecast."""

FEWEST, MOST = 9, 19
"""Plays with durations that were drawn, beside the one with the usual ones. Of fewer than ten in all the
least and the greatest are closer together than four of five."""

LATER_S = 1.0
"""Seconds of wall time by which a run has to be later for that to be told."""


class Times(msgspec.Struct, frozen=True):
    """When something is expected, and between which times it lies in four of five plays (UTC ns)."""

    earliest_at: int
    expected_at: int
    latest_at: int


class ExpectedRun(msgspec.Struct, frozen=True):
    """What is expected of a run. ``starts`` is when it started if it has; null: not in sight. ``waits`` is
    why it does not come to its end without a person; ``modules`` those that it is expected to choose, by the
    steps' keys."""

    run: str
    workflow: str
    user: str
    campaign: str
    starts: Times | None
    ends: Times | None
    waits: str = ""
    modules: dict[str, str] = {}


class ExpectedCampaign(msgspec.Struct, frozen=True):
    """What is expected of a campaign. The first ``rows_forecast`` of the rows that are left were carried on;
    if that is less than all, ``ends`` goes on at their rate."""

    campaign: str
    name: str
    starts: Times | None
    ends: Times | None
    rows_left: int
    rows_forecast: int
    waits: str = ""


class ExpectedTouch(msgspec.Struct, frozen=True):
    """When a person is needed next, for what, and what is to be done about it. ``planned``: a workflow asks
    for it."""

    at: Times
    why: str
    remedy: str
    run: str
    planned: bool


class Delay(msgspec.Struct, frozen=True):
    """A run of somebody that would end later, in seconds of wall time; null: it would not end without a
    person."""

    run: str
    user: str
    campaign: str
    by_s: float | None


class LabForecast(msgspec.Struct, frozen=True):
    """What is expected of a lab from ``now_at`` on, after ``plays`` plays. ``left_out`` runs that wait were
    not looked at. ``new`` are the runs of what is not submitted yet; ``delays`` and ``conflicts`` are what
    it would bring."""

    now_at: int
    plays: int
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
    """What is asked: of a state as a picture, at a time. ``new`` is what somebody thinks of submitting, and
    ``new_rows`` the plans of its rows, between which they choose, if it is a campaign. ``rows`` are those of
    campaigns that are known; ``newcomers`` tell who may come meanwhile. In place of what is new, a submission
    that waits for an approval (``approved``) is let go on."""

    picture: bytes
    now: int
    spreads: Spreads = Spreads()
    newcomers: Newcomers = Newcomers()
    rows: dict[CampaignId, list[tuple[Plan, ...]]] = {}
    new: SubmitRun | SubmitWithLabware | SubmitCampaign | None = None
    actor: str = ""
    new_rows: list[tuple[Plan, ...]] = []
    approved: str = ""
    most_runs: int = MOST_RUNS
    most_steps: int = MOST_STEPS
    steps: int = STEPS


def forecast_lab(request: ForecastRequest, is_late: Callable[[], bool] = lambda: False) -> LabForecast:
    """Carry the lab on, several times; once it ``is_late``, not once more."""
    base = from_picture(request.picture)
    left_out = keep_first(base, request.most_runs)
    base.recorded_at = max(base.recorded_at, request.now)
    forecaster = _Forecaster(request, picture(base))
    usual = forecaster.play(0)
    if forecaster.refusal:
        return LabForecast(request.now, 0, left_out=left_out, refusal=forecaster.refusal)
    count = max(FEWEST, min(MOST, request.steps // max(1, usual.steps)))
    asks = request.new is not None or bool(request.approved)
    before = forecaster.play(0, without=True) if asks else None
    plays = [usual]
    while len(plays) <= count and not is_late():
        plays.append(forecaster.play(len(plays)))
    conflicts = list(_conflicts(request, base, plays, forecaster.new)) if asks else []
    return LabForecast(
        now_at=request.now,
        plays=len(plays),
        runs=[_run(forecaster, plays, name) for name in usual.users],
        campaigns=_campaigns(forecaster, plays),
        touches=_touches(plays),
        left_out=left_out,
        cut=usual.cut,
        new=[str(name) for name in usual.users if _is_new(forecaster, usual, name)],
        delays=[
            delay
            for delay in (_delays(before, usual) if before is not None else ())
            if forecaster.new not in (delay.run, delay.campaign) or not request.approved
        ],
        conflicts=conflicts,
    )


class _Forecaster:
    """Carries copies of a state on. ``new`` is the run or campaign that is not submitted yet."""

    def __init__(self, request: ForecastRequest, base: bytes) -> None:
        self.request, self.base = request, base
        self.workflows: dict[RunId, str] = {}
        self.campaigns: dict[CampaignId, tuple[str, int]] = {}
        self.new, self.refusal = "", ""

    def play(self, number: int, *, without: bool = False) -> Play:
        """Number 0 takes the usual durations, and nobody comes; others draw both."""
        asked = self.request
        state = from_picture(self.base)
        rows: dict[CampaignId, Sequence[tuple[Plan, ...]]] = dict(asked.rows)
        fresh = CampaignId(f"C{state.campaigns.named + 1}")
        if not without and isinstance(asked.new, SubmitCampaign):
            rows[fresh] = asked.new_rows
        lasts = partial(_lasts, asked.spreads, state.lab.pace, number)
        come = asked.newcomers.draw(asked.now, lambda word: draw(f"{number}/{word}")) if number else []
        lab = VirtualLab(
            state,
            asked.now,
            lasts,
            rows,
            most_rows=asked.most_runs,
            most_steps=asked.most_steps,
            newcomers=come,
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
        return lab.go_on()

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


def _lasts(spreads: Spreads, pace: float, number: int, action: Action, step: PlanStep) -> int:
    level = 0.5 if number == 0 else draw(f"{number}/{action.run}/{action.step}/{action.attempt}")
    return spreads.lasts(action, step, pace, level)


def draw(what: str) -> float:
    """A number between 0 and 1: for the same words the same."""
    return int.from_bytes(hashlib.blake2b(what.encode(), digest_size=8).digest()) / 2**64


def times(values: Sequence[int], plays: int) -> Times | None:
    """What these values of several plays tell; None if less than half of them have one."""
    if not values or 2 * len(values) < plays:
        return None
    ordered = sorted(values)
    return Times(*(int(_outer(ordered, level)) for level in (LOW, 0.5, HIGH)))


def _outer(ordered: Sequence[int], level: float) -> float:
    """The quantile of all that could be, of which these are a few: a little further out than theirs."""
    count = len(ordered)
    place = (level * (count + 1) - 1) / max(1, count - 1)
    return quantile(ordered, min(1.0, max(0.0, place)))


def _is_new(forecaster: _Forecaster, play: Play, name: RunId) -> bool:
    return bool(forecaster.new) and forecaster.new in (name, play.members.get(name))


def _run(forecaster: _Forecaster, plays: list[Play], name: RunId) -> ExpectedRun:
    def find_times(pick: Callable[[Play], dict[RunId, int]]) -> Times | None:
        return times([pick(play)[name] for play in plays if name in pick(play)], len(plays))

    ends = find_times(lambda play: play.ends)
    usual = plays[0]
    failed = usual.failed.get(name, "")
    return ExpectedRun(
        run=str(name),
        workflow=forecaster.workflows.get(name, ""),
        user=usual.users[name],
        campaign=str(usual.members.get(name, "")),
        starts=find_times(lambda play: play.starts),
        ends=ends,
        waits=failed or ("" if ends is not None else usual.stays.get(name, "")),
        modules=usual.modules.get(name, {}),
    )


def _campaigns(forecaster: _Forecaster, plays: list[Play]) -> list[ExpectedCampaign]:
    found: list[ExpectedCampaign] = []
    for name, (title, left) in forecaster.campaigns.items():
        usual = [run for run, member in plays[0].members.items() if member == name]
        members = [[run for run, member in play.members.items() if member == name] for play in plays]
        begun = [
            min(play.starts[run] for run in runs if run in play.starts)
            for play, runs in zip(plays, members, strict=True)
            if any(run in play.starts for run in runs)
        ]
        stays = next((plays[0].stays[run] for run in usual if run in plays[0].stays), "")
        fresh = [run for run in usual if run not in forecaster.workflows]
        rest = max(0, left - len(fresh))
        over = [
            _extrapolate([play.starts[run] for run in runs], [play.ends[run] for run in runs], rest)
            for play, runs in zip(plays, members, strict=True)
            if runs and all(run in play.ends for run in runs)
        ]
        found.append(
            ExpectedCampaign(
                campaign=str(name),
                name=title,
                starts=times(begun, len(plays)),
                ends=times(over, len(plays)),
                rows_left=left,
                rows_forecast=len(fresh),
                waits=stays,
            )
        )
    return found


def _extrapolate(starts: Sequence[int], ends: Sequence[int], rest: int) -> int:
    """When so many rows more would have ended, at the rate of the later half of those that were seen."""
    ordered = sorted(ends)
    half = len(ordered) // 2
    if rest and half:
        return ordered[-1] + rest * (ordered[-1] - ordered[half - 1]) // (len(ordered) - half)
    return ordered[-1] + rest * (ordered[-1] - min(starts))


def _touches(plays: list[Play]) -> list[ExpectedTouch]:
    """When a person is needed, in order; what comes up in less than half of the plays is left out."""
    found: list[ExpectedTouch] = []
    for touch in plays[0].touches:
        at = times(
            [
                next(other.at for other in play.touches if (other.why, other.run) == (touch.why, touch.run))
                for play in plays
                if any((other.why, other.run) == (touch.why, touch.run) for other in play.touches)
            ],
            len(plays),
        )
        if at is not None:
            found.append(ExpectedTouch(at, touch.why, touch.remedy, touch.run, touch.planned))
    return sorted(found, key=lambda touch: touch.at.expected_at)


def _delays(before: Play, after: Play) -> Iterator[Delay]:
    for name, ended in before.ends.items():
        later = after.ends.get(name)
        if later is None and after.cut:
            continue
        by_s = None if later is None else (later - ended) / 1e9
        if by_s is None or by_s >= LATER_S:
            yield Delay(str(name), before.users[name], str(before.members.get(name, "")), by_s)


# -- conflicts -----------------------------------------------------------------------------------


def _sure_to_use(plans: Sequence[Plan]) -> list[ModuleName]:
    """The modules that a run uses whichever of these plans it follows."""
    first, *others = ({step.module: True for step in plan.steps} for plan in plans)
    return [module for module in first if all(module in other for other in others)]


def _conflicts(request: ForecastRequest, state: LabState, plays: list[Play], new: str) -> Iterator[str]:
    """What stands in the way of something that is not submitted yet, as sentences."""
    user, deadline, rows = _what_is_asked(request, state)
    modules = {module: True for plans in rows for module in _sure_to_use(plans)}
    for name in modules:
        module = state.modules.by_name.get(name)
        if module is None or module.out_of_service or module.status == ModuleStatus.GONE:
            yield f"{local(name)} is not there, or out of service."
    ends = [
        end
        for play in plays
        for name, end in play.ends.items()
        if new and new in (name, play.members.get(name))
    ]
    until = max(ends, default=request.now)
    yield from _list_booked(state, user, modules, request.now, until)
    if deadline:
        late = [end for end in ends if end > deadline]
        if late or not ends:
            yield "The deadline would be missed."
    stays = sum(new in (name, plays[0].members.get(name)) for name in plays[0].stays) if new else 0
    if stays:
        why = next(why for name, why in plays[0].stays.items() if new in (name, plays[0].members.get(name)))
        yield f"{stays} of its runs would wait for a person: {why}."


def _what_is_asked(request: ForecastRequest, state: LabState) -> tuple[str, int, Sequence[Sequence[Plan]]]:
    """Whose it is that may begin, its deadline (0: none), and the plans of its runs."""
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

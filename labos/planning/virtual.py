"""Simulates a lab in virtual time: its own rules and its own planning continue a copy of its state.

Steps start when planning proposes them, and end when their durations have passed. Rows of campaigns become
runs, bookings begin and end, and quotas and shares apply. No action fails. People do at once what a workflow
asks of them, and nothing else: an empty supply stays empty, and a run that needs it does not continue.

Pure: a function gives the duration of each action. Virtual time goes from one end or deadline to the next.
"""

from __future__ import annotations

import heapq
from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType
from typing import Any

import msgspec

from labos.core.actions import Action, ActionRequested, ActionStatus
from labos.core.campaigns import Campaign, CampaignStatus
from labos.core.decide import Command, Rejection, carry_out
from labos.core.decide.actions import AcceptAction, FinishAction
from labos.core.decide.campaigns import SubmitRow
from labos.core.decide.interventions import ResolveIntervention
from labos.core.decide.work import find_work
from labos.core.effects import Draws, Transfers
from labos.core.fold import evolve
from labos.core.ids import ActionId, CampaignId, ExperimentId, RunId, local
from labos.core.interventions import InterventionRequested
from labos.core.model import Plan, PlanStep
from labos.core.modules import ModuleStatus
from labos.core.quotas import explain_full_queue
from labos.core.registry import Event
from labos.core.rules import find_end_by
from labos.core.runs import (
    RunBound,
    RunCancelled,
    RunCompleted,
    RunFailed,
    RunStarted,
    RunState,
    find_chosen_modules,
    requeue,
)
from labos.core.state import LabState
from labos.core.steps import WindowBreached
from labos.core.topics import PlannedWork
from labos.core.users import LABOS
from labos.core.waits import Wait
from labos.planning.forecast import find_setup_in_progress
from labos.planning.obstacle import explain_wait
from labos.planning.own_order import OwnOrder
from labos.planning.scheduler import Scheduler, make_searching_scheduler
from labos.planning.touch import find_touched_keys
from labos.planning.wait_list import Name, WaitList

MOST_RUNS = 200
"""The most waiting runs that are simulated. If more wait, the first runs of each user are simulated. Also the
most rows of each campaign that become runs."""

MOST_STEPS = 10_000
"""The number of started steps after which a simulation stops."""

Lasts = Callable[[Action, PlanStep], int]
"""The duration of a step's action, from its request to its end (ns of wall time). The time of a set-up before
it is added to this."""

MOST_ALARMS = 1_000
"""The most deadlines in a row for which a simulation waits while nothing is in flight. Without this limit, a
booking for every day would keep it going without end."""

OVERDUE = 0.05
"""An action that takes longer than expected is assumed to need this part of its time so far in addition."""


class ForeseenTouch(msgspec.Struct, frozen=True):
    """The time at which a person is needed (UTC ns), the reason, and what the person has to do. ``planned``:
    a workflow asks for it."""

    at: int
    why: str
    remedy: str = ""
    run: str = ""
    planned: bool = False


class Play(msgspec.Struct):
    """The result of a simulation. ``starts`` and ``ends`` of runs are in UTC ns; ``failed`` says why runs
    failed or were cancelled. ``touches`` are the times at which a person is needed. ``stays`` says why each
    remaining run does not continue. ``cut``: the limit of steps ended the simulation.

    ``members`` are the campaigns of runs, and ``experiments`` their experiments. ``levels`` are the amounts
    of resources at the end. ``steps`` is the number of started steps, ``begun`` their starts (UTC ns), and
    ``missed`` the number of missed windows. ``modules`` are the modules that runs have chosen, by the steps'
    keys."""

    starts: dict[RunId, int] = {}
    ends: dict[RunId, int] = {}
    failed: dict[RunId, str] = {}
    touches: list[ForeseenTouch] = []
    stays: dict[RunId, str] = {}
    members: dict[RunId, CampaignId] = {}
    users: dict[RunId, str] = {}
    levels: dict[str, float] = {}
    steps: int = 0
    begun: dict[tuple[RunId, int], int] = {}
    cut: bool = False
    modules: dict[RunId, dict[str, str]] = {}
    missed: int = 0
    experiments: dict[RunId, ExperimentId] = {}


HORIZON_NS = 30 * 24 * 3600 * 10**9
"""The longest time after the last start for which a simulation waits while nothing is in flight (ns)."""


class VirtualLab:
    """Simulates a lab from ``now`` on (UTC ns), and changes ``state``. ``rows`` are plans for the rows of
    campaigns, each with its choices of modules. If there are fewer plans than rows, the rows use them in
    turn. At most ``most_rows`` of a campaign become runs.

    ``orders`` are the lab's own orders; the search for orders continues from them, as in a lab. With None,
    the order is by age. ``overtaken`` says how often waiting runs were overtaken before."""

    def __init__(
        self,
        state: LabState,
        now: int,
        lasts: Lasts,
        rows: Mapping[CampaignId, Sequence[tuple[Plan, ...]]] | None = None,
        *,
        most_rows: int = MOST_RUNS,
        most_steps: int = MOST_STEPS,
        orders: Mapping[str, OwnOrder] | None = None,
        overtaken: Mapping[RunId, float] = MappingProxyType({}),
    ) -> None:
        self.state, self.now, self.play = state, now, Play()
        self._lasts = lasts
        self._rows = {
            name: [tuple(map(strip_results, plans)) for plans in found]
            for name, found in (rows or {}).items()
        }
        self._most_rows, self._most_steps = most_rows, most_steps
        self._admitted: dict[CampaignId, int] = {}
        self._keys: set[str] = set()
        self._scheduler = Scheduler() if orders is None else make_searching_scheduler(orders)
        for name, times in overtaken.items():
            if times and name in state.runs.queued:
                self._scheduler.room.overtake(state, state.runs.queued[name], times)
        self._scheduler.wait_list = _ReportingWaitList(self._note_wait)
        self._flying: list[tuple[int, int, ActionId]] = []
        self._ends: dict[ActionId, int] = {}
        self._asked: dict[tuple[str, str], bool] = {}
        self._count = self._alarms = 0
        self._moved_at = now
        self._remove_unknowns()
        for run in [*state.runs.active.values(), *state.runs.queued.values()]:
            self._note(run)
        for question in state.interventions.open.values():
            if not isinstance(question.topic, PlannedWork):
                self._touch(ForeseenTouch(now, question.text, f"labos resolve {question.id}", question.run))

    # -- commands ----------------------------------------------------------------------------

    def submit(self, command: Command, actor: str) -> list[Event] | Rejection:
        """Carry out a command of ``actor``; returns its events or the rejection. Its runs and campaigns need
        no approval."""
        answer = self._ask(command, actor)
        for event in [] if isinstance(answer, Rejection) else answer:
            run = self.state.runs.queued.get(RunId(getattr(event, "run", "")))
            if run is not None and run.id not in self.play.users:
                self._note(run)
            self._release_run(run)
            self._open(self.state.campaigns.open.get(CampaignId(getattr(event, "campaign", ""))))
        return answer

    def approve(self, subject: str) -> None:
        """Approve a submission, or an amendment of a campaign, that waits for an approval."""
        proposal = self.state.approvals.open.pop(subject, None)
        self._release_run(self.state.runs.queued.get(RunId(subject)))
        campaign = self.state.campaigns.open.get(CampaignId(subject))
        if campaign is not None and proposal is not None:
            campaign.terms = proposal.terms or campaign.terms
            self._open(campaign)

    def _release_run(self, run: RunState | None) -> None:
        """From now on a waiting run needs no person's approval."""
        if run is not None and (run.held or run.unapproved):
            with requeue(self.state.runs, run):
                run.held = run.unapproved = False

    def _open(self, campaign: Campaign | None) -> None:
        if campaign is not None and campaign.status == CampaignStatus.PROPOSED:
            campaign.status = CampaignStatus.OPEN

    def _ask(self, command: Command, actor: str = LABOS) -> list[Event] | Rejection:
        answer = carry_out(self.state, command, self._write, actor)
        for event in [] if isinstance(answer, Rejection) else answer:
            self._keys.update(find_touched_keys(self.state, event))
            self._observe(event)
        return answer

    def _write(self, event: Event) -> Event:
        evolve(self.state, event, self.state.position + 1, self.now)
        return event

    def _observe(self, event: Event) -> None:
        match event:
            case ActionRequested():
                self._set_end(self.state.actions.open[event.action])
            case RunBound():
                self.play.modules[event.run] = {key: local(name) for key, name in event.modules.items()}
            case RunStarted():
                self.play.starts[event.run] = self.now
            case RunCompleted():
                self.play.ends[event.run] = self.now
            case RunFailed() | RunCancelled():
                self.play.ends[event.run] = self.now
                self.play.failed[event.run] = event.why
            case WindowBreached():
                self.play.missed += 1
            case InterventionRequested():
                planned = isinstance(event.topic, PlannedWork)
                remedy = f"labos resolve {event.intervention}"
                self._touch(ForeseenTouch(self.now, event.text, remedy, event.run, planned))
            case _:
                pass

    # -- simulation --------------------------------------------------------------------------

    def go_on(self) -> Play:
        """Simulate until nothing can start or end any more, or until the limit of steps. Returns the
        result."""
        self._start_and_feed()
        while not self.play.cut:
            at = self._find_next_time()
            if at is None:
                break
            self.now = max(self.now, at)
            self._end_due()
            self._start_and_feed()
        runs = [*self.state.runs.active.values(), *self.state.runs.queued.values()]
        if not self.play.cut:
            self.play.stays = {run.id: self._describe_wait(run) for run in runs}
            if self.play.stays and not self.play.touches:
                run, why = next(iter(self.play.stays.items()))
                self._touch(
                    ForeseenTouch(self.now, f"nothing continues, because {run} waits: {why}", run=run)
                )
        self.play.levels = {name: level.level for name, level in self.state.resources.levels.items()}
        return self.play

    def _find_next_time(self) -> int | None:
        """The next time at which an action ends or something is due (UTC ns). None if no run can continue at
        such a time."""
        if self._flying:
            self._alarms = 0
        elif not (self.state.runs.active or self.state.runs.queued) or self._alarms >= MOST_ALARMS:
            return None
        alarm = self._scheduler.find_next_deadline(self.state)
        times = [self._flying[0][0]] if self._flying else []
        if alarm is not None and not (times and alarm <= self.now):
            self._alarms += 1
            times.append(alarm)
        at = min(times, default=None)
        too_far = at is not None and not self._flying and at > self._moved_at + HORIZON_NS
        return None if too_far else at

    def _start_and_feed(self) -> None:
        while True:
            self._start()
            if self.play.cut or not self._feed():
                return

    def _start(self) -> None:
        while True:
            keys, self._keys = self._keys, set()
            before = self.state.position
            self._scheduler.note_changes(self.state, keys)
            for command in self._scheduler.iterate_due(self.state, self.now):
                self._ask(command)
            for start in self._scheduler.iterate_proposals(self.state, self.now):
                self._ask(start.make_command(self._name_action, self.now))
                for run, step in ((start.run, start.step), *start.others):
                    self.play.steps += 1
                    self.play.begun[run, step] = self.now
                self._moved_at = self.now
                if self.play.steps >= self._most_steps:
                    self.play.cut = True
                    return
            if self.state.position == before:
                return

    def _name_action(self) -> ActionId:
        self._count += 1
        return ActionId(f"virtual-{self._count}")

    def _feed(self) -> bool:
        """Let rows of campaigns become runs. Returns whether any did."""
        fed = False
        for name, plans in self._rows.items():
            campaign = self.state.campaigns.open.get(name)
            while (
                plans
                and campaign is not None
                and campaign.room
                and self._admitted.get(name, 0) < self._most_rows
                and not explain_full_queue(self.state, campaign.user)
            ):
                row = campaign.next_row
                first, *others = plans[row % len(plans)]
                answer = self._ask(SubmitRow(name, row, first, others=tuple(others)))
                if isinstance(answer, Rejection) or not answer:
                    break
                self._admitted[name] = self._admitted.get(name, 0) + 1
                for run in campaign.runs:
                    if run not in self.play.users:
                        self._note(self.state.runs.queued[run])
                        fed = True
                campaign = self.state.campaigns.open.get(name)
        return fed

    def _end_due(self) -> None:
        while self._flying and self._flying[0][0] <= self.now:
            action = self.state.actions.open.get(heapq.heappop(self._flying)[2])
            if action is None:
                continue
            question = find_work(self.state, action)
            if question is not None:
                self._ask(ResolveIntervention(question.id, "done", LABOS))
                continue
            if action.status == ActionStatus.REQUESTED:
                self._ask(AcceptAction(action.id, action.attempt, self.now))
            self._ask(FinishAction(action.id, action.attempt, True, "all"))

    def _set_end(self, action: Action) -> None:
        """Compute when an action in flight ends. It has no end if its outcome is unknown or its node is
        gone."""
        module = self.state.modules.by_name[action.module]
        run = self.state.runs.active.get(action.run)
        if run is None or action.status == ActionStatus.UNKNOWN or module.status == ModuleStatus.GONE:
            return
        step = self.state.runs.plan_of(run).steps[action.step]
        end = action.requested_at + self._lasts(action, step) + find_setup_in_progress(self.state, action)
        if action.together:  # the device ends all of them together: the first end that is found counts
            end = self._ends.setdefault(action.together[0], end)
        if end <= self.now:
            end = self.now + int(OVERDUE * (self.now - action.requested_at)) + 1
        limit = find_end_by(self.state, action)
        self._count += 1
        heapq.heappush(self._flying, (end if limit is None else min(end, limit - 1), self._count, action.id))

    # -- records -----------------------------------------------------------------------------

    def _remove_unknowns(self) -> None:
        """Remove from the state what a simulation cannot know. No results are read, and no observer checks
        motions. A device is idle when its action has ended. Also computes the ends of the actions in
        flight."""
        state = self.state
        for known in state.runs.plans.values():
            known.plan = strip_results(known.plan)
            known.conditional = ()
        state.bench.watched.clear()
        for module in state.modules.by_name.values():
            if module.status == ModuleStatus.BUSY:
                module.status = ModuleStatus.IDLE
        for action in state.actions.open.values():
            if action.status == ActionStatus.REPORTED:
                action.status, action.looks = ActionStatus.ACCEPTED, ()
            self._set_end(action)

    def _note(self, run: RunState) -> None:
        self.play.users[run.id] = run.user
        if run.campaign:
            self.play.members[run.id] = run.campaign
        if run.experiment:
            self.play.experiments[run.id] = run.experiment
        if run.has_started:
            self.play.starts[run.id] = run.started_at
            chosen = find_chosen_modules(self.state.runs, run)
            if chosen:
                self.play.modules[run.id] = {key: local(name) for key, name in chosen.items()}

    def _touch(self, touch: ForeseenTouch) -> None:
        key = (touch.why, touch.run if touch.planned else "")
        if key not in self._asked:
            self._asked[key] = True
            self.play.touches.append(touch)

    def _note_wait(self, name: Name, wait: Wait) -> None:
        if wait.blocked:
            run = name[0] if RunId(name[0]) in self.state.runs.active else ""
            self._touch(ForeseenTouch(self.now, wait.reason.sentence, wait.reason.remedy, run))

    def _describe_wait(self, run: RunState) -> str:
        waits = [wait for _, wait in self._scheduler.list_waits(self.state, run, self.now)]
        found = next((wait for wait in waits if wait.blocked), None) or next(iter(waits), None)
        if found is None:
            return "the outcome of its action cannot be found"
        return explain_wait(self._scheduler.safety, self.state, run, found)


class _ReportingWaitList(WaitList):
    """A wait list that reports each new wait."""

    def __init__(self, report: Callable[[Name, Wait], None]) -> None:
        super().__init__()
        self._report = report

    def add(self, name: Name, wait: Wait) -> None:
        super().add(name, wait)
        self._report(name, wait)


def strip_results(plan: Plan) -> Plan:
    """A plan whose steps do not read results of earlier steps: all its steps are carried out, and no
    expectation is checked. If it reads or checks a result, it also loses its effects on liquids."""
    if not plan.feeds and not any(step.when or step.expect for step in plan.steps):
        return plan
    return msgspec.structs.replace(plan, feeds=(), steps=tuple(map(_drop_results, plan.steps)))


def _drop_results(step: PlanStep) -> PlanStep:
    args: dict[str, Any] = {
        name: None if isinstance(value, dict) and "$result" in value else value
        for name, value in step.args.items()
    }
    effects = tuple(effect for effect in step.effects if not isinstance(effect, Transfers | Draws))
    return msgspec.structs.replace(step, args=args, effects=effects, when=None, expect=None)


def keep_first(state: LabState, most: int = MOST_RUNS) -> int:
    """Remove waiting runs from a state, except the first ``most``; returns how many were removed. Runs with a
    higher priority are kept first. Among runs of equal priority, users take turns."""
    turns: dict[tuple[int, str], int] = {}
    order: list[tuple[int, int, int, RunId]] = []
    for run in state.runs.queued.values():
        turn = turns[run.priority, run.user] = turns.get((run.priority, run.user), 0) + 1
        order.append((-run.priority, turn, run.position, run.id))
    gone = [name for *_, name in sorted(order)[most:]]
    for name in gone:
        evolve(state, RunCancelled(name), state.position + 1, state.recorded_at)
    return len(gone)

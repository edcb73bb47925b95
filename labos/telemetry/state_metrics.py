"""The present state of the lab: gauges computed from the folded state at each scrape; and the time without
human intervention."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping
from functools import lru_cache, partial
from typing import TYPE_CHECKING

from labos.core.calibrations import find_first_expiry
from labos.core.days import end_of
from labos.core.ids import ModuleName, StationName, local, split_level_key, workcell_of
from labos.core.open_experiments import ExperimentStatus
from labos.core.state import LabState
from labos.planning.scheduler import Scheduler
from labos.telemetry.series import BoundedNames, ComputedCounter, GaugeMetric, Labels, MetricGroup

if TYPE_CHECKING:
    from labos.services.twh import Twh

MODULE_STATES = ("idle", "busy", "error", "gone", "out_of_service")
RUN_STATES = ("queued", "active", "paused", "cancelling", "leaving")

APPROVALS = ("run", "campaign", "experiment", "amendment")
"""The kinds of submissions that wait for an approval."""

KINDS_OF_RUNS, USERS_SEEN, WAITS_SEEN = 150, 101, 500
"""The number of workflows in workcells, of users, and of reasons for waiting that are still shown, as 0, when
none are left."""

CELLS = 250
"""The number of workcells with their own series."""


class StateMetrics(MetricGroup):
    """The gauges of a lab's state. ``workflows`` and ``users`` limit these labels."""

    def __init__(self, workflows: BoundedNames, users: BoundedNames) -> None:
        self._workflow, self._user = workflows, users
        cell, module = ("workcell",), ("workcell", "module")
        of_cell = partial(GaugeMetric, labels=cell, most=CELLS)
        self.runs = GaugeMetric(
            "labos_runs",
            f"Runs that have not ended; state is {', '.join(RUN_STATES)}.",
            (*cell, "workflow", "state"),
        )
        self.queue = of_cell("labos_queue_runs", "Runs that wait to be started.")
        self.queue_age_s = of_cell(
            "labos_queue_oldest_age_seconds",
            "Waiting time of the oldest run that has not started; 0 if no run waits.",
        )
        self.waiting = GaugeMetric(
            "labos_waiting_steps",
            "Steps that wait although they are next, by reason; queued runs with one reason count as one.",
            (*cell, "reason"),
        )
        self.user_runs = GaugeMetric(
            "labos_user_runs", "Runs of a user that have not ended.", ("user", "state"), most=505
        )
        self.user_share = GaugeMetric(
            "labos_user_share_ratio",
            "A user's share of module time as the scheduler counts it; used time counts half after a day.",
            ("user",),
            most=101,
        )
        self.experiments = GaugeMetric("labos_experiments", "Experiments that have not ended.", ("status",))
        self.module_state = GaugeMetric(
            "labos_module_state",
            f"1 for the state that the module is in, 0 for the others: {', '.join(MODULE_STATES)}.",
            (*module, "state"),
            most=5_000,
        )
        self.stations = GaugeMetric(
            "labos_module_places", "Room for labware at the module's stations.", module
        )
        self.occupied = GaugeMetric(
            "labos_module_places_occupied",
            "Labware at the module's stations, including labware that is being moved there.",
            module,
        )
        self.labware = GaugeMetric(
            "labos_labware",
            "Labware on the bench; place is known, or uncertain for labware whose place is not known.",
            ("place",),
        )
        self.actions = GaugeMetric(
            "labos_actions_open",
            "Actions that have not ended; status is requested, accepted, reported or unknown.",
            ("status",),
        )
        self.level = GaugeMetric(
            "labos_resource_level",
            "The remaining amount of a resource, in its own unit.",
            (*module, "resource"),
        )
        self.capacity = GaugeMetric(
            "labos_resource_capacity", "The capacity for a resource, in its own unit.", (*module, "resource")
        )
        self.calibration_ends_s = of_cell(
            "labos_calibration_ends_timestamp_seconds",
            "The expiry time of the calibration that expires first; no value if none expires.",
        )
        self.questions = of_cell("labos_interventions_open", "Open questions and tasks for a person.")
        self.question_age_s = of_cell(
            "labos_intervention_oldest_age_seconds",
            "How long the oldest question or task has waited; 0 if none does.",
        )
        self.approvals = GaugeMetric(
            "labos_approvals_open",
            "Submissions that wait for an operator's approval, by the lab's policy; kind is run, campaign, "
            "experiment, or amendment of a campaign.",
            ("kind",),
            most=len(APPROVALS),
        )
        self._seen_runs: dict[Labels, bool] = {}
        self._seen_users: dict[Labels, bool] = {}
        self._seen_waits: dict[Labels, bool] = {}
        self.access = of_cell("labos_workcell_access", "1 while a person has access to the workcell.")
        self.starts_paused = GaugeMetric(
            "labos_starts_paused",
            "The number of experiments, modules and workcells whose starts somebody has paused; 0 is normal.",
        )

        self.bookings = GaugeMetric(
            "labos_bookings",
            "Bookings that have not ended; when is now for those that have begun, else later.",
            ("when",),
            most=2,
        )

    def update(self, state: LabState, scheduler: Scheduler, now: int) -> None:
        """Take the figures from a state at ``now`` (UTC ns)."""
        self._count_runs(state, now)
        self._count_users(state, now)
        self._count_modules(state)
        self._count_stations(state)
        self._count_people(state, now)
        self._count_waits(state, scheduler)
        statuses = Counter(experiment.status for experiment in state.experiments.open.values())
        self.experiments.replace({(s,): float(statuses[s]) for s in ExperimentStatus})
        uncertain = sum(not item.station and not item.on for item in state.bench.labware.values())
        known = len(state.bench.labware) - uncertain
        self.labware.replace({("known",): float(known), ("uncertain",): float(uncertain)})
        flying: Counter[str] = Counter(action.status for action in state.actions.open.values())
        names = ("requested", "accepted", "reported", "unknown")
        self.actions.replace({(name,): float(flying[name]) for name in names})
        self.starts_paused.set(len(state.lab.paused))
        begun = len(state.bookings.now)
        self.bookings.replace({("now",): float(begun), ("later",): float(len(state.bookings.open) - begun)})

    def _count_runs(self, state: LabState, now: int) -> None:
        runs: Counter[Labels] = Counter(dict.fromkeys(self._seen_runs, 0))
        mine: Counter[Labels] = Counter(dict.fromkeys(self._seen_users, 0))
        queue = dict.fromkeys(state.lab.workcells, 0)
        queued, active = state.runs.queued.values(), state.runs.active.values()
        # Thousands may wait: runs with equal properties are counted together first.
        kinds = Counter((run.plan, run.workflow, run.user, run.paused, run.status) for run in queued)
        kinds.update((run.plan, run.workflow, run.user, run.paused, run.status) for run in active)
        for (plan, workflow, user, paused, status), count in kinds.items():
            cell = state.runs.plans[plan].plan.workcell
            shown = "paused" if paused else status
            runs[cell, self._workflow(workflow), shown] += count
            mine[self._user(user), shown] += count
            if status == "queued":
                queue[cell] = queue.get(cell, 0) + count
        self._remember(self._seen_runs, runs, KINDS_OF_RUNS)
        self._remember(self._seen_users, mine, USERS_SEEN)
        self.runs.replace(runs)
        self.user_runs.replace(mine)
        self.queue.replace({(cell,): float(count) for cell, count in queue.items()})
        ages: dict[Labels, float] = {(cell,): 0.0 for cell, count in queue.items() if not count}
        for run in queued:  # in order of age: the first of each workcell is its oldest
            if len(ages) == len(queue):
                break
            ages.setdefault((state.runs.plans[run.plan].plan.workcell,), (now - run.submitted_at) / 1e9)
        self.queue_age_s.replace(ages)

    def _count_users(self, state: LabState, now: int) -> None:
        used: dict[Labels, float] = {}
        for user, usage in state.shares.usage.items():
            key = (self._user(user),)
            used[key] = used.get(key, 0.0) + usage.compute_level(now)
        total = sum(used.values())
        self.user_share.replace({key: level / total for key, level in used.items()} if total else {})

    def _count_modules(self, state: LabState) -> None:
        states: dict[Labels, float] = {}
        levels: dict[Labels, float] = {}
        capacities: dict[Labels, float] = {}
        ends: dict[Labels, float] = {}
        for name, module in state.modules.by_name.items():
            now = "out_of_service" if module.out_of_service else module.status.lower()
            for each, key in _state_keys(name):
                states[key] = 1.0 if each == now else 0.0
            if last := find_first_expiry(module.calibrations):
                key = (workcell_of(name),)
                ends[key] = min(ends.get(key, math.inf), end_of(last))
        for what, level in state.resources.levels.items():
            key = _resource_key(what)
            levels[key], capacities[key] = level.level, level.capacity
        self.module_state.replace(states)
        self.level.replace(levels)
        self.capacity.replace(capacities)
        self.calibration_ends_s.replace(ends)

    def _count_stations(self, state: LabState) -> None:
        room: dict[Labels, float] = {}
        taken: dict[Labels, float] = {}
        for name, station in state.bench.stations.items():
            if name in state.bench.shelves or station.spec.kind == "waste":
                continue  # each shelf of a hotel is counted by itself
            key = _place_key(name, station.spec.module)
            room[key] = room.get(key, 0.0) + station.spec.capacity
            taken[key] = taken.get(key, 0.0)
            if station.labware or station.stock or station.expected:  # most are empty
                taken[key] += station.count
        self.stations.replace(room)
        self.occupied.replace(taken)

    def _count_people(self, state: LabState, now: int) -> None:
        count = dict.fromkeys(state.lab.workcells, 0)
        oldest = dict.fromkeys(state.lab.workcells, now)
        for question in state.interventions.open.values():
            cell = _cell_of(state, question.run, question.module)
            count[cell] = count.get(cell, 0) + 1
            oldest[cell] = min(oldest.get(cell, now), question.requested_at)
        self.questions.replace({(cell,): float(n) for cell, n in count.items()})
        self.question_age_s.replace({(cell,): (now - at) / 1e9 for cell, at in oldest.items()})
        waiting = Counter[str](proposal.kind for proposal in state.approvals.open.values())
        self.approvals.replace({(kind,): float(waiting[kind]) for kind in APPROVALS})
        self.access.replace({(cell,): float(cell in state.lab.access) for cell in state.lab.workcells})

    def _count_waits(self, state: LabState, scheduler: Scheduler) -> None:
        found: Counter[Labels] = Counter(dict.fromkeys(self._seen_waits, 0))
        for who, wait in scheduler.wait_list.list_all():
            run = state.runs.get(who)
            cell = state.runs.plan_of(run).workcell if run is not None else scheduler.room.find_cell(who)
            found[(cell, wait.code)] += 1
        for key in found:
            if len(self._seen_waits) < WAITS_SEEN:
                self._seen_waits[key] = True
        self.waiting.replace(found)

    def _remember(self, seen: dict[Labels, bool], found: Counter[Labels], most: int) -> None:
        """Show a former series as 0 in each state."""
        for key in list(found):
            if key not in seen and len(seen) < most * len(RUN_STATES):
                seen.update({(*key[:-1], state): True for state in RUN_STATES})


class UnattendedMetrics(MetricGroup):
    """Time without human intervention, as ``docs/time-without-human-intervention.md`` defines it: the figures
    of the lab (scope ``lab``, no workcell) and of each workcell. They exist as soon as the log was read from
    its beginning."""

    def __init__(self) -> None:
        gauge = partial(GaugeMetric, labels=("scope", "workcell"), most=250)
        counter = partial(ComputedCounter, labels=("scope", "workcell"), most=250)
        self.current_s = gauge("labos_twh_current_seconds", "Working time since the last human intervention.")
        self.longest_s = gauge(
            "labos_twh_longest_seconds", "The longest working time without a human intervention so far."
        )
        self.working = gauge(
            "labos_twh_working", "1 while the clock runs: a run is under way and does not wait for a person."
        )
        self.clock_s = counter(
            "labos_twh_clock_seconds_total", "Total working time, with and without people."
        )
        self.planned = counter(
            "labos_planned_touches_total",
            "Planned work of people, which does not end a stretch without intervention.",
        )
        self.interventions = ComputedCounter(
            "labos_human_interventions_total",
            "Interventions that ended a stretch, by cause: the kind of question, or the type of the event "
            "that a person caused.",
            ("cause",),
            most=100,
        )

    def update(self, lab: Twh, workcells: Mapping[str, Twh], causes: Mapping[str, int]) -> None:
        """Take the figures of all scopes at one moment."""
        scopes: dict[Labels, Twh] = {("lab", ""): lab}
        scopes.update({("workcell", name): twh for name, twh in workcells.items()})
        self.current_s.replace({key: twh.current.worked_ns / 1e9 for key, twh in scopes.items()})
        self.longest_s.replace({key: twh.longest.worked_ns / 1e9 for key, twh in scopes.items()})
        self.working.replace({key: float(twh.working) for key, twh in scopes.items()})
        self.clock_s.replace({key: twh.clock_ns / 1e9 for key, twh in scopes.items()})
        self.planned.replace({key: float(twh.planned) for key, twh in scopes.items()})
        self.interventions.replace({(cause,): float(count) for cause, count in causes.items()})


OWN = "bench"
"""The module name for stations that belong to no module."""


# A factory has thousands of names, which do not change.


@lru_cache(maxsize=10_000)
def _state_keys(name: ModuleName) -> tuple[tuple[str, Labels], ...]:
    return tuple((state, (workcell_of(name), local(name), state)) for state in MODULE_STATES)


@lru_cache(maxsize=10_000)
def _resource_key(name: str) -> Labels:
    module, resource = split_level_key(name)
    return workcell_of(module), local(module), resource


@lru_cache(maxsize=50_000)
def _place_key(station: StationName, module: ModuleName) -> Labels:
    return workcell_of(station), local(module) or OWN


def _cell_of(state: LabState, run: str, module: str) -> str:
    """The workcell of a question; empty if it concerns the whole lab."""
    found = state.runs.get(run) if run else None
    if found is not None:
        return state.runs.plan_of(found).workcell
    return workcell_of(StationName(module)) if module else ""

"""The rules for starting a step at present. Planning uses them for its proposals, and ``decide`` enforces
them.

``examine`` checks one step of one run. It returns the step's effects with the labware written in, or the
first reason to wait. Whether a start could cause a deadlock is not checked here but in planning.
"""

from __future__ import annotations

from collections.abc import Collection
from math import inf

from labos.core import reasons
from labos.core.actions import Action, ActionStatus
from labos.core.bench import StationState
from labos.core.binding import bind, check_module, find_unreserved
from labos.core.booked import check_not_booked
from labos.core.effects import AnyEffect, list_places
from labos.core.expiry import check_in_date
from labos.core.holding import find_other_holder
from labos.core.ids import (
    ActionId,
    ModuleName,
    RunId,
    access_key,
    local,
    module_key,
    run_key,
    workcell_of,
    zone_key,
)
from labos.core.lab import WHOLE_LAB
from labos.core.model import MAIN, PlanStep
from labos.core.modules import ModuleStatus
from labos.core.quotas import check_quota
from labos.core.resources import sum_by_supply
from labos.core.runs import PENDING, SETTLED, RunState, RunStatus, find_anchor
from labos.core.state import LabState
from labos.core.together import check_left_out
from labos.core.waits import Wait, list_keys_until_free
from labos.core.watching import find_unwatched
from labos.core.zones import find_other_at_work, find_stopped_module, find_zones

NODE_AWAY_S = 60.0
"""If the node of an action in flight is gone for this many wall seconds, a person is asked."""

WAITS_S = 30.0
"""If a device stands still during an action for this many wall seconds, a person is asked."""

CLOSING_S = 1800.0
"""If a closing workflow has not begun its first step after this many lab seconds, a person is asked."""


def examine(
    state: LabState, run: RunState, index: int, now: int, others: Collection[RunId] = ()
) -> Wait | tuple[AnyEffect, ...]:
    """The bound effects with which the step may start now, or why it waits. The step of this run is carried
    out together with one step of each of the ``others``."""
    step = state.runs.plan_of(run).steps[index]
    return (
        _check_own_turn(state, run, step, index)
        or check_log_whole(state, step)
        or check_starts_allowed(state, run, step)
        or check_no_access(state, run, step)
        or check_quota(state, run, now)
        or _check_windows(state, run, step, now)
        or _check_retry_delay(state, run, step, index, now)
        or check_not_booked(state, run, step, now)
        or check_module_free(state, run, step)
        or check_left_out(state, run, step, others)
        or find_unwatched(state, (step,))
        or check_zones_free(state, step)
        or _check_supplies(state, run)
        or check_in_date(state, run, step, now)
        or bind(state, run, step)
    )


def find_approval_wait(state: LabState, run: RunState) -> Wait:
    """The reason why a run that is not approved waits."""
    proposal = state.approvals.open.get(run.id)
    why = ", and ".join(why.text for why in proposal.why) if proposal is not None else "its policy says so"
    return Wait(reasons.NotApproved(run.id, why), (run_key(run.id),))


def find_person_wait(state: LabState, run: RunState) -> Wait | None:
    """What a run waits for until a person approves or resumes it."""
    if run.unapproved:
        return Wait(reasons.Unapproved(run.user), (run_key(run.id),))
    if run.held:
        return find_approval_wait(state, run)
    return Wait(reasons.Paused(run.id), (run_key(run.id),)) if run.paused else None


def _check_own_turn(state: LabState, run: RunState, step: PlanStep, index: int) -> Wait | None:
    wait = find_person_wait(state, run)
    if wait is not None:
        return wait
    if run.status == RunStatus.CANCELLING:
        return Wait(reasons.Cancelling(run.id), (run_key(run.id),))
    if not run.has_started:
        first = not step.after and step.part == MAIN
        return None if first else Wait(reasons.After(), (run_key(run.id),))
    if run.steps[index].status != PENDING:
        return Wait(reasons.NotPending(step.key), (run_key(run.id),))
    reset = step.retry.reset if step.retry is not None else None
    for before in (*step.after, reset) if reset is not None else step.after:
        if run.steps[before].status not in SETTLED:
            return Wait(reasons.After(str(before)), (run_key(run.id),))
    return None


def check_log_whole(state: LabState, step: PlanStep) -> Wait | None:
    """While the log has lost its end and the bench is not checked, only steps that reset modules may
    start."""
    shorter = state.shorter
    if not shorter.since or step.recovers:
        return None
    names = [local(name) for name in shorter.evidence]
    more = [f"{len(names) - 3} more"] if len(names) > 3 else []
    return Wait(reasons.LogShorter(", ".join([*names[:3], *more]), str(shorter.ended)))


def check_starts_allowed(state: LabState, run: RunState, step: PlanStep) -> Wait | None:
    """If a user has paused starts here, only steps may start that reset modules or move arms out of the
    way."""
    if not state.lab.paused or step.recovers:
        return None
    cell = workcell_of(step.module)
    access = state.lab.access.get(cell)
    if access is not None and run.plan in access.parking:
        return None
    for target in (run.experiment, step.module, cell, WHOLE_LAB):
        pause = state.lab.paused.get(target)
        if pause is not None:
            return Wait(reasons.Halted(target, pause.by))
    return None


def check_no_access(state: LabState, run: RunState, step: PlanStep) -> Wait | None:
    """No step starts in a workcell into which a person reaches; arms are parked before."""
    if not state.lab.access:
        return None
    cell = workcell_of(step.module)
    access = state.lab.access.get(cell)
    if access is None or (not access.granted and run.plan in access.parking):
        return None
    return Wait(reasons.Access(cell, access.by), (access_key(cell),))


def _check_windows(state: LabState, run: RunState, step: PlanStep, now: int) -> Wait | None:
    for window in step.windows:
        ended = find_anchor(run, window)
        if ended is None:
            continue
        earliest = ended + convert_lab_s(state, window.wait_s)
        if now < earliest:
            return Wait(reasons.TooEarly(step.key), (), until=earliest)
    return None


def _check_retry_delay(state: LabState, run: RunState, step: PlanStep, index: int, now: int) -> Wait | None:
    """Whether the delay before the retry of a failed step has passed."""
    failed_at = run.steps[index].retried_at if run.steps else None
    if failed_at is None or step.retry is None:
        return None
    again = failed_at + convert_lab_s(state, step.retry.delay_s)
    return Wait(reasons.RetryLater(step.key), (), until=again) if now < again else None


def find_due_time(state: LabState, action: Action) -> int | None:
    """The time at which an action without a result counts as unknown (UTC ns). None if its step has no
    time-out, its device has reported success, or the outcome is unknown already. None also for the work of a
    person: a person who is late is asked again, and knows the outcome."""
    is_known = action.status in (ActionStatus.REPORTED, ActionStatus.UNKNOWN)
    return None if is_known else find_end_by(state, action)


def find_end_by(state: LabState, action: Action) -> int | None:
    """The time-out of an action, with the set-up of its module before it (UTC ns). None if its step has
    none."""
    run = state.runs.active.get(action.run)
    if run is None:
        return None
    step = state.runs.plan_of(run).steps[action.step]
    if step.timeout_s is None or step.by_person:
        return None
    flight = state.modules.by_name[action.module].in_flight.get(action.id)
    setup_s = flight.setup_s if flight is not None else 0.0
    return action.requested_at + convert_lab_s(state, step.timeout_s + setup_s)


def find_give_up_time(state: LabState, action: Action) -> int | None:
    """The time at which LabOS stops waiting for the node of an action (UTC ns): ``NODE_AWAY_S`` after it was
    lost. None if the node is there, or if an observer or a person settles the outcome."""
    module = state.modules.by_name[action.module]
    if module.status != ModuleStatus.GONE or not module.gone_at or module.person:
        return None
    if action.status in (ActionStatus.REPORTED, ActionStatus.UNKNOWN):
        return None
    if state.interventions.find_about(action.id) is not None:
        return None
    return module.gone_at + int(NODE_AWAY_S * 1e9)


def find_standstill_time(state: LabState, action: Action) -> int | None:
    """The time at which a person is asked about a device that stands still during an action and reports why
    (UTC ns). None if it does not stand still, or if a person was asked before."""
    module = state.modules.by_name[action.module]
    waits = module.status == ModuleStatus.ERROR and module.error_at and not module.asked and not module.person
    if not waits or action.status != ActionStatus.ACCEPTED or not action.exclusive:
        return None
    return module.error_at + int(WAITS_S * 1e9)


def find_late_close(state: LabState, run: RunState) -> int | None:
    """The time at which a person is asked about a closing workflow that has not begun (UTC ns). None if it
    has begun, if the run is no closing run, or if a person was asked before."""
    if not run.closing or run.has_started or run.asked:
        return None
    return run.submitted_at + convert_lab_s(state, CLOSING_S)


def may_still_act(state: LabState, action: Action) -> bool:
    """Whether a node that is away may still carry an action out or report its end. A request may be on its
    way to it, or the device may stand still. A person who took the module out of service has made sure that
    it does not."""
    module = state.modules.by_name[action.module]
    return module.status == ModuleStatus.GONE and not module.out_of_service and not module.person


def convert_lab_s(state: LabState, seconds: float) -> int:
    """Lab seconds as nanoseconds of wall time."""
    return int(seconds * 1e9 / state.lab.pace)


def check_module_free(state: LabState, run: RunState, step: PlanStep) -> Wait | None:
    """Whether this run may use the step's module now."""
    module = state.modules.by_name.get(step.module)
    key = module_key(step.module)
    if module is None:
        return Wait(reasons.NoModule(step.module), (key,))
    away = check_module(module, recovers=step.recovers)
    if away:
        return away
    if not step.exclusive:
        return None
    # This recovery may be needed for a device that does not become idle by itself.
    if module.busy or (module.status == ModuleStatus.BUSY and not step.recovers):
        return Wait(reasons.ModuleBusy(step.module), (key,))
    # A run that holds a module in error can continue only after the module works again.
    holder = "" if step.recovers else find_other_holder(state, step.module, run)
    if holder:
        return Wait(reasons.Held(step.module, holder), (key,))
    for name in state.bench.by_module.get(step.module, ()):
        station = state.bench.stations[name]
        if not station.spec.stands_apart and (station.expected or _is_in_motion(state, station)):
            return Wait(reasons.ReachedInto(name), list_keys_until_free(state, name))
    return None


def check_zones_free(state: LabState, step: PlanStep) -> Wait | None:
    """Whether no other arm is in the zones that this step's arm would enter."""
    for zone in find_zones(state, step.module, step.effects) if step.exclusive else ():
        busy = find_other_at_work(state, zone, step.module)
        if busy:
            return Wait(reasons.ZoneBusy(busy, zone), (zone_key(zone), module_key(busy)))
        stopped = "" if step.recovers else find_stopped_module(state, zone, step.module)
        if stopped:
            keys = (zone_key(zone), module_key(ModuleName(stopped)))
            return Wait(reasons.ZoneBarred(stopped, zone), keys)
    return None


def _is_in_motion(state: LabState, station: StationState) -> bool:
    """Whether labware is leaving a station. Labware that was seen here does not count if it has an unknown
    motion between two other places."""
    labware, open_ = state.bench.labware, state.actions.open
    moving = [open_[ActionId(name)] for item in station.labware if (name := labware[item].moving)]
    return any(
        a.status != ActionStatus.UNKNOWN or station.spec.name in list_places(a.effects) for a in moving
    )


def _check_supplies(state: LabState, run: RunState) -> Wait | None:
    """A run is admitted only if the supplies are enough for all its steps, besides the needs of the runs
    under way; or if the module is full. A run that runs out of supplies half-way would block other runs until
    a person comes."""
    if run.has_started:
        return None
    for (module, resource), amount in sum_by_supply(state.runs.plans[run.plan].uses_up).items():
        spare, capacity = find_spare(state, module, resource)
        if spare < min(amount, capacity):
            return Wait(reasons.UsedUp(module, resource), (module_key(module),))
    return None


def find_spare(state: LabState, module: ModuleName, resource: str) -> tuple[float, float]:
    """The amount that a run that is let in finds besides the needs of the runs under way, and the amount with
    which the module is full; both endless if the amount was never declared."""
    level, left = state.resources.find(module, resource), find_unreserved(state, module, resource)
    if level is None or left is None:
        return inf, inf
    return left - _sum_to_come(state, module, resource), level.capacity


def _sum_to_come(state: LabState, module: ModuleName, resource: str) -> float:
    """The amount that the runs under way will still use up."""
    return sum(
        amount
        for run in state.runs.list_inside(workcell_of(module))
        for index, at, what, amount in state.runs.plans[run.plan].uses_up
        if at == module and what == resource and run.steps[index].status == PENDING
    )

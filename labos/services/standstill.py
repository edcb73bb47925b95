"""Why a run makes no progress: follows its waits, from run to run, to the cause that a person or a device has
to remove.

The reasons of waits are not events: they are computed from the folded state, by the rules by which the kernel
decides.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Literal, assert_never

import msgspec

from labos.core import reasons
from labos.core.actions import Action, ActionFailed, ActionStatus
from labos.core.effects import list_places
from labos.core.envelope import Envelope
from labos.core.fold import evolve
from labos.core.ids import (
    ActionId,
    LabwareId,
    ModuleName,
    RunId,
    StationName,
    experiment_owner,
    find_owning_run,
    local,
    run_owner,
    split_key,
)
from labos.core.interventions import (
    Intervention,
    InterventionRequested,
    InterventionResolved,
)
from labos.core.lab import StationsApplied, WorkcellApplied
from labos.core.modules import ModuleStatus, ModuleTakenOut
from labos.core.registry import Event
from labos.core.runs import RunFailed, RunState, RunStatus
from labos.core.state import LabState
from labos.core.steps import StepUnexpected
from labos.core.topics import PlannedWork
from labos.core.waits import Wait
from labos.planning.obstacle import find_obstacle
from labos.planning.scheduler import Scheduler
from labos.planning.touch import find_touched_keys, is_key_of_all

Kind = Literal["error", "person", "resource", "planned", "other"]
ErrorClass = Literal["", "software", "operational", "experiment"]


class Cause(msgspec.Struct, frozen=True, order=True):
    """The cause to which a lost minute is charged. ``kind``: an *error* of one of the paper's classes, a
    *person* who is waited for without any error, an empty *resource*, a *planned* touch. ``asked``:
    a question or a task for a person is open.
    """

    kind: Kind
    what: str
    module: str = ""
    error_class: ErrorClass = ""
    asked: bool = False


Entry = Cause | tuple[RunId, ...]
"""One thing for which a run waits: a cause, or other runs. An empty tuple is a wait that ends by itself."""

PASSES: Entry = ()

CLASSES: dict[str, ErrorClass] = {"late_step": "experiment"}
"""The error class of a question, if it does not depend on earlier events; every other question is an
operational error."""


class Standstill:
    """Follows a log and finds, at each moment, the final cause of a run's wait."""

    def __init__(self) -> None:
        self.state = LabState()
        self._scheduler = Scheduler()
        self._briefly = False
        self._looked: dict[RunId, list[Entry]] = {}
        self._before: dict[RunId, list[Entry]] = {}
        self._by_key: dict[str, set[RunId]] = {}
        self._unexpected: set[str] = set()
        self._failures: dict[str, ErrorClass] = {}
        self._reported: set[ActionId] = set()
        self._collided: set[str] = set()
        self._taken_by_person: dict[ModuleName, bool] = {}

    def add(self, event: Event, head: Envelope) -> None:
        """Take in one event, in order."""
        evolve(self.state, event, head.position, head.recorded_at)
        match event:
            case StepUnexpected():
                self._unexpected.add(f"{event.run}#{event.step}")
            case ActionFailed(kind="software"):
                self._reported.add(event.action)
                self._collided.discard(f"{event.run}#{event.step}")
            case ActionFailed():
                self._collided.add(f"{event.run}#{event.step}")
            case RunFailed():
                self._failures[event.run] = event.kind  # type: ignore[assignment]
            case ModuleTakenOut():
                self._taken_by_person[event.module] = "/" not in head.actor and head.actor != "labos"
        self._forget(event)

    def find_cause(self, run: RunState, *, briefly: bool = False) -> Cause | None:
        """The final cause for which a run that has not ended waits; None if the run continues, or waits for
        one that does. With ``briefly``, the whole bench is not examined: a run that waits for its turn has
        the same cause as before."""
        self._briefly = briefly
        return self._find_final_cause(run, set())

    # -- facts from earlier events ------------------------------------------------------------

    def _forget(self, event: Event) -> None:
        keys = find_touched_keys(self.state, event)
        furnished = isinstance(event, WorkcellApplied | StationsApplied)
        if furnished:
            self._scheduler = Scheduler()
        asked = isinstance(event, InterventionRequested | InterventionResolved)
        if asked or furnished or any(map(is_key_of_all, keys)):
            self._looked.clear()
            self._by_key.clear()
            return
        for key in keys:
            for run in self._by_key.pop(key, ()):
                self._looked.pop(run, None)
        own = RunId(str(getattr(event, "run", "")))
        self._looked.pop(own, None)
        self._before.pop(own, None)

    def _list_entries(self, run: RunState) -> list[Entry]:
        known = self._looked.get(run.id)
        if known is None:
            known = list(self._look(run))
            if not known and self._briefly:
                return self._before.get(run.id, [PASSES])
            known = self._before[run.id] = known or list(self._iterate_steps(run))
            if PASSES not in known:  # no key shows when a run may not start any more
                self._looked[run.id] = known
        return known

    # -- one run -------------------------------------------------------------------------------

    def _find_final_cause(self, run: RunState, seen: set[RunId]) -> Cause | None:
        seen.add(run.id)
        found: Cause | None = None
        for entry in self._list_entries(run):
            if isinstance(entry, Cause):
                found = found or entry
                continue
            others = [other for other in map(self.state.runs.get, entry) if other and other.id not in seen]
            if not others:
                if not entry:
                    return None
                continue  # they wait for each other: the cause is found from another entry
            behind = [self._find_final_cause(other, seen) for other in others]
            if None in behind:
                return None
            found = found or behind[0]
        return found

    def _look(self, run: RunState) -> Iterator[Entry]:
        """The causes that need no examination of steps: questions about a run, a person in its workcell, a
        pause, and actions in flight."""
        state = self.state
        asked = [question for question in state.interventions.open.values() if question.run == run.id]
        if asked:
            yield self._make_question_cause(asked[0])
            return
        access = state.lab.access.get(state.runs.plan_of(run).workcell)
        if access is not None:
            yield Cause("planned", "hands in the workcell", asked=True)
            return
        if run.paused:
            yield Cause("person", "paused")
            return
        flying = [action for action in state.actions.open.values() if action.run == run.id]
        for action in flying:
            yield self._explain_flight(action)
        if run.status == RunStatus.CANCELLING and not flying:
            yield PASSES

    def _iterate_steps(self, run: RunState) -> Iterator[Entry]:
        """The causes for which the ready steps wait."""
        waits = self._scheduler.list_waits(self.state, run, self.state.recorded_at)
        if not waits:
            yield PASSES
        for _, wait in waits:
            for key in wait.on:
                self._by_key.setdefault(key, set()).add(run.id)
            yield self._wait(run, wait)

    def _explain_flight(self, action: Action) -> Entry:
        """An action in flight continues, unless its node is away or its outcome is unknown."""
        if action.status == ActionStatus.UNKNOWN:
            return Cause("error", "unknown action", action.module, "operational", asked=True)
        module = self.state.modules.by_name.get(action.module)
        lost = module is None or module.status in (ModuleStatus.GONE, ModuleStatus.ERROR)
        return (self._explain_away(action.module) if lost else None) or PASSES

    def _make_question_cause(self, question: Intervention) -> Cause:
        kind = question.kind
        if kind == PlannedWork.KIND:
            return Cause("planned", "work by hand", question.module, asked=True)
        error = CLASSES.get(kind, "operational")
        if kind == "failed_step":
            error = "experiment" if question.subject in self._unexpected else "software"
            error = "operational" if question.subject in self._collided else error
        elif kind == "failed_run":
            error = self._failures.get(question.subject, error)
        elif kind == "lost_labware" and ActionId(question.subject) in self._reported:
            error = "software"
        return Cause("error", kind.replace("_", " "), question.module, error, asked=True)

    def _explain_away(self, name: ModuleName) -> Cause | None:
        """Why a module cannot be used; None if it can."""
        module = self.state.modules.by_name.get(name)
        if module is None:
            return Cause("person", "no such module", name)
        if module.out_of_service:
            asked = any(
                question.module == name and question.kind != PlannedWork.KIND
                for question in self.state.interventions.open.values()
            )
            if self._taken_by_person.get(name):
                return Cause("person", "out of service", name, asked=asked)
            return Cause("error", "out of service", name, "operational", asked=asked)
        if module.status == ModuleStatus.GONE:
            return Cause("error", "node gone", name, "operational")
        if module.status == ModuleStatus.ERROR:
            if module.stopped:
                return Cause("person", "emergency stop", name)
            return Cause("error", "in error", name, "software")
        return None

    # -- one wait ------------------------------------------------------------------------------

    def _wait(self, run: RunState, wait: Wait) -> Entry:
        reason = wait.reason
        words: Iterable[str] = reason.names
        match reason:
            case reasons.ModuleDown() | reasons.OutOfService() | reasons.NoModule() | reasons.ZoneBarred():
                return self._explain_away(ModuleName(reason.module)) or PASSES
            case reasons.BetterHere():  # it makes way for a module that is down
                return self._explain_away(ModuleName(reason.dead[0])) or PASSES
            case reasons.UsedUp() | reasons.Expired():
                return Cause("resource", reason.resource, reason.module)
            case reasons.StackEmpty() | reasons.WasteFull():
                place = StationName(reason.place)
                lacks = "empty" if isinstance(reason, reasons.StackEmpty) else "full"
                return Cause("resource", f"{local(place)} {lacks}", self._find_module_at(place))
            case reasons.Uncertain():
                return self._charge_lost(reason.place)
            case reasons.Lost():
                return self._charge_lost(reason.labware)
            case reasons.Outcome():
                return Cause("error", "unknown action", "", "operational", asked=True)
            case reasons.Halted():
                return Cause("person", "paused", self._find_module_at(reason.target))
            case reasons.NoWayOut():
                found = find_obstacle(self._scheduler.safety, self.state, run)
                words = [found.replace("experiment ", "experiment:")]
            case reasons.NotYours():  # it waits for the owner
                pass
            case reasons.NeedsPerson():
                at = self._find_module_at(next(iter(reason.names), ""))
                return Cause("person", reason.code.replace("_", " "), at)
            case (
                reasons.TooEarly()
                | reasons.RetryLater()
                | reasons.Booked()
                | reasons.BookedSoon()
                | reasons.ForOthers()
            ):
                return PASSES
            case (
                # It waits for the run of the reservation, or for the run that has the hold.
                reasons.InUse()
                | reasons.Reserved()
                | reasons.Held()
                | reasons.Setpoint()
                | reasons.HandFull()
                | reasons.InsideToo()
                | reasons.ModuleBusy()
                | reasons.ZoneBusy()
                | reasons.ReachedInto()
                | reasons.InMotion()
                | reasons.Buried()
                | reasons.Occupied()
                | reasons.AfterElder()
                | reasons.WouldBlock()
                | reasons.HoldsUp()
                | reasons.SearchForOrder()
                | reasons.SoonerLater()
                | reasons.SoonerAfter()
                | reasons.LaterHere()
                | reasons.AfterSuggested()
                | reasons.ClockLater()
                | reasons.Unsafe()
                # It waits for its own steps, or for no particular run.
                | reasons.After()
                | reasons.NotPending()
                | reasons.Cancelling()
                | reasons.Gone()
                | reasons.Requires()
                | reasons.NoAccess()
                | reasons.StillToCome()
            ):
                pass
            case reasons.NotInTime() | reasons.WouldDelay() | reasons.FollowsLate():
                if wait.until is not None:
                    return PASSES
            case _:
                assert_never(reason)
        others, left = self._find_runs_named_in(words)
        others = tuple(other for other in others if other != run.id)
        if left is not None and not others:
            return self._charge_left(left)
        return others

    def _charge_lost(self, where: str) -> Cause:
        """Labware of unknown place: charged to the action that lost it."""
        item = self.state.bench.labware.get(LabwareId(where))
        names = {item.id} if item else set()
        for other in self.state.bench.labware.values():
            if StationName(where) in other.maybe:
                names.add(other.id)
        for question in self.state.interventions.open.values():
            action = self.state.actions.open.get(ActionId(question.subject))
            moved = [*question.motions, *(action.effects if action is not None else ())]
            if names & {getattr(effect, "labware", "") for effect in moved} or names & set(question.labware):
                return self._make_question_cause(question)
        return Cause("error", "labware lost", "", "operational", asked=False)

    def _charge_left(self, item: LabwareId) -> Cause:
        """Labware that no run will move away blocks a place."""
        for question in self.state.interventions.open.values():
            if item in question.labware:
                return self._make_question_cause(question)
        station = self.state.bench.labware[item].station
        return Cause("person", "labware in the way", self._find_module_at(station))

    def _find_module_at(self, name: str) -> str:
        """The module of a station, or the module of that name; empty if there is none."""
        station = self.state.bench.stations.get(StationName(name))
        if station is not None:
            return station.spec.module
        return name if name in self.state.modules.by_name else ""

    def _find_runs_named_in(self, words: Iterable[str]) -> tuple[tuple[RunId, ...], LabwareId | None]:
        """The runs that names refer to: by their own name, by the module or station at which they work, or by
        labware that they own; and labware that no active run owns."""
        state = self.state
        owners: dict[str, bool] = {}
        items: dict[str, LabwareId] = {}
        for name in (name for text in words for name in text.replace(",", " ").split()):
            owners[name] = True
            station = state.bench.stations.get(StationName(name))
            standing = station.labware if station is not None else [LabwareId(name)]
            for item in standing:
                if item in state.bench.labware:
                    owners[state.bench.labware[item].owner] = True
                    items[state.bench.labware[item].owner] = item
            for action in state.actions.open.values():
                if name == action.module or name in list_places(action.effects):
                    owners[run_owner(action.run)] = True
        runs: dict[RunId, bool] = {}
        for owner in owners:
            run = state.runs.get(find_owning_run(owner) or owner)
            if run is not None:
                runs[run.id] = True
            elif split_key(owner)[0] == "experiment":
                of = [r.id for r in state.runs.active.values() if experiment_owner(r.experiment) == owner]
                runs |= dict.fromkeys(of, True)
        nobodys = (item for owner, item in items.items() if split_key(owner)[0] not in ("run", "experiment"))
        return tuple(runs), next(nobodys, None)

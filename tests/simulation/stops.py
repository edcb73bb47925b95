"""Why runs stand still: each followed, wait by wait, to what somebody would have to do something about."""

from __future__ import annotations

from collections.abc import Iterable

from labos.core.ids import RunId, experiment_owner
from labos.core.runs import RunState
from labos.core.state import LabState
from labos.core.waits import Wait
from labos.planning.obstacle import find_obstacle
from labos.planning.scheduler import Scheduler

KINDS = {
    "module": ("module_down", "out_of_service", "zone_barred", "no_module", "better_here"),
    "labware": (
        "uncertain",
        "not_yours",
        "undeclared",
        "nothing_there",
        "wrong_way",
        "not_accepted",
        "no_grip",
        "unfit",
    ),
    "person": ("paused", "access"),
    "resource": ("used_up", "stack_empty", "waste_full"),
}
KIND_OF = {code: kind for kind, codes in KINDS.items() for code in codes}


def causes(state: LabState, runs: Iterable[RunState], now: int) -> dict[RunId, set[str]]:
    """What stops each run: kind, code and a sentence. Empty for one that could go on, or that waits in a
    circle."""
    search = _Search(state, now)
    return {run.id: search.find_causes(run, set()) for run in runs}


class _Search:
    def __init__(self, state: LabState, now: int) -> None:
        self.state, self.now = state, now
        self.scheduler = Scheduler()

    def find_causes(self, run: RunState, seen: set[str]) -> set[str]:
        """What a run waits for in the end; ``seen`` are those that are being looked at."""
        if run.id in seen:
            return set()
        seen.add(run.id)
        found: set[str] = set()
        for action in self.state.actions.open.values():
            if action.run == run.id:
                module = self.state.modules.by_name[action.module]
                if action.status == "unknown":
                    found.add(f"person, to say how {action.name} of {action.module} ended")
                elif module.status in ("GONE", "ERROR"):
                    found.add(f"module, in flight on {action.module}, which is {module.status}")
        for question in self.state.interventions.open.values():
            if question.run == run.id:
                found.add(f"person, {question.kind}: {question.text}")
        for _, wait in self.scheduler.list_waits(self.state, run, self.now):
            found |= self._behind(run, wait, seen)
        return found

    def _behind(self, run: RunState, wait: Wait, seen: set[str]) -> set[str]:
        if wait.blocked and wait.code in KIND_OF:
            return {f"{KIND_OF[wait.code]}, {wait.code}: {wait.reason.sentence}"}
        found: set[str] = set()
        cause = find_obstacle(self.scheduler.safety, self.state, run) if wait.code == "no_way_out" else ""
        for other in self._list_named((*wait.names, *cause.replace("experiment ", "experiment:").split())):
            if other.id != run.id:
                found |= self.find_causes(other, seen)
        return found or ({f"way, no_way_out: {cause}"} if cause else set())

    def _list_named(self, words: Iterable[str]) -> list[RunState]:
        """The runs that words speak of: by name, as holders of a module, as owners of labware."""
        names: dict[str, bool] = {}
        for text in words:
            for name in text.replace(",", " ").split():
                names[name.removeprefix("run:")] = True
                item = self.state.bench.labware.get(name)  # type: ignore[call-overload]
                if item is not None:
                    names[item.owner.removeprefix("run:")] = True
                for action in self.state.actions.open.values():
                    if action.module == name:
                        names[action.run] = True
        for name in list(names):
            if name.startswith("experiment:"):
                inside, outside = self.state.runs.active.values(), self.state.runs.queued.values()
                of = [r.id for r in (*inside, *outside) if experiment_owner(r.experiment) == name]
                names |= dict.fromkeys(of, True)
        found = [self.state.runs.get(RunId(name)) for name in names]
        return [run for run in found if run is not None]

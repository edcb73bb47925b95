"""Which statuses follow each other as events are folded."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from labos.core.bench import Labware
from labos.core.fold import evolve
from labos.core.registry import Event
from labos.core.runs import list_statuses
from labos.core.state import LabState

Found = dict[str, dict[tuple[str, str, str], bool]]
"""By machine: event type, status before, status after; an empty status for what is not there."""


def statuses(state: LabState) -> dict[str, dict[str, str]]:
    """The status of everything, by machine and id."""
    runs = [*state.runs.queued.values(), *state.runs.active.values()]
    return {
        "run": {run.id: str(run.status) for run in runs},
        "step": {
            f"{run.id}#{index}": str(status)
            for run in runs
            for index, status in enumerate(list_statuses(state.runs.plan_of(run), run))
        },
        "action": {action.id: str(action.status) for action in state.actions.open.values()},
        "node": {name: str(module.status) for name, module in state.modules.by_name.items()},
        "labware": {name: labware_status(item) for name, item in state.bench.labware.items()},
    }


def labware_status(item: Labware) -> str:
    if item.maybe:
        return "uncertain"
    return "in use" if item.moving else "at rest"


def transitions(events: Iterable[tuple[Event, int, int]]) -> Found:
    """What an event log does to everything. ``events`` with their positions and times (UTC ns)."""
    state = LabState()
    found: Found = {}
    before = statuses(state)
    for event, position, at in events:
        evolve(state, event, position, at)
        after = statuses(state)
        for machine, now in after.items():
            then = before[machine]
            for name in {**then, **now}:
                pair = then.get(name, ""), now.get(name, "")
                if pair[0] != pair[1] and not (machine == "step" and "" in pair):
                    found.setdefault(machine, {})[event.TYPE, *pair] = True
        before = after
    return found


def together(many: Iterable[Found]) -> Iterator[tuple[str, str, str, str]]:
    """All of them: machine, event type, before, after."""
    yield from sorted(
        {(machine, *row): True for one in many for machine, rows in one.items() for row in rows}
    )

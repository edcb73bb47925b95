"""When a person is needed next, and for what: tasks that wait for a person now, and foreseen ones.

The forecast is only as good as the nominal durations on which it is based; a fault may need a person earlier.
"""

from __future__ import annotations

from collections.abc import Iterator

import msgspec

from labos.core.ids import local
from labos.core.modules import ModuleStatus
from labos.core.state import LabState
from labos.core.topics import PlannedWork
from labos.planning.forecast import is_pending
from labos.services.inventory import Ahead, Inventory, count_inventory, list_runs_ahead, list_shortfalls
from labos.services.times import iso_time


class Touch(msgspec.Struct, frozen=True):
    """``at`` in UTC ns; not later than now if something already waits for the person. ``kind``: question,
    work, access, module, supply. ``run`` is the first run that needs it; empty if there is no such run."""

    at: int
    kind: str
    what: str
    run: str = ""
    remedy: str = ""


def list_next_touches(state: LabState, now: int) -> list[Touch]:
    """The tasks for which a person is needed, earliest first; ``now`` in UTC ns."""
    walked = list(list_runs_ahead(state, now))
    left = count_inventory(state, now, iso_time(now)[:10])
    found = [
        *_find_asked(state),
        *_list_modules(state, walked),
        *_list_supplies(left),
        *_list_work(state, walked),
    ]
    return sorted(found, key=lambda touch: (max(touch.at, now), touch.at))


def _find_asked(state: LabState) -> Iterator[Touch]:
    for question in state.interventions.open.values():
        planned = question.kind == PlannedWork.KIND
        answer = f"labos {'confirm' if planned else 'resolve'} {question.id}"
        kind = "work" if planned else "question"
        yield Touch(question.requested_at, kind, question.text, question.run, answer)
    for cell, access in state.lab.access.items():
        what = f"{access.by} reaches into the workcell {cell}"
        yield Touch(access.asked_at, "access", what, "", f"labos access {cell} --done")


def _list_modules(state: LabState, walked: list[Ahead]) -> Iterator[Touch]:
    """Modules that runs need and that do not become available by themselves; each once, at its first use."""
    named: set[str] = set()
    for found in walked:
        plan = state.runs.plan_of(found.run)
        for index, at in found.starts.items():
            name = plan.steps[index].module
            module = state.modules.by_name.get(name)
            if module is None or name in named or name in state.modules.back_at or plan.steps[index].recovers:
                continue
            if module.out_of_service or module.status in (ModuleStatus.ERROR, ModuleStatus.GONE):
                named.add(name)
                why = module.out_of_service or f"{module.status} {module.error}".strip()
                remedy = f"labos reset {local(name)}"
                yield Touch(at, "module", f"{local(name)} ({why})", found.run.id, remedy)


def _list_supplies(left: Inventory) -> Iterator[Touch]:
    for name, out in list_shortfalls(left):
        what = local(name).replace(":", " ")
        yield Touch(out.at, "supply", f"{what} are not suitable for step {out.step!r}", out.run)


def _list_work(state: LabState, walked: list[Ahead]) -> Iterator[Touch]:
    """Steps that a workflow plans for a person and that have not been requested yet."""
    for found in walked:
        run = found.run
        plan = state.runs.plan_of(run)
        for index, at in found.starts.items():
            step = plan.steps[index]
            if step.by_person and is_pending(run, index):
                yield Touch(at, "work", f"{step.key!r} of {run.workflow}", run.id)

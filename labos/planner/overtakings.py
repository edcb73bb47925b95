"""How often waiting runs were overtaken: the lab protects a run that was overtaken too often."""

from __future__ import annotations

from collections.abc import Sequence

import msgspec

from labos.core.ids import ModuleName, RunId
from labos.core.runs import RunState
from labos.core.state import LabState


class _Known(msgspec.Struct, frozen=True):
    position: int
    priority: int
    modules: frozenset[ModuleName]


class Overtakings:
    """Counts for one workcell, from one look to the next. The kernel has counts of its own, which no event
    tells. Here a run that has gone before an older one counts once it is seen to wait no more."""

    def __init__(self) -> None:
        self._waiting: dict[RunId, _Known] = {}
        self._inside: dict[RunId, _Known] = {}
        self._counts: dict[RunId, int] = {}

    def count(self, state: LabState, cell: str, waiting: Sequence[RunState]) -> dict[RunId, int]:
        """For each waiting run, how many younger ones that use one of its modules went before it."""
        now = {run.id: _look_at(state, run) for run in waiting}
        inside = {run.id: _look_at(state, run) for run in state.runs.list_inside(cell)}
        gone = {**self._waiting, **inside}
        went = [gone[name] for name in gone if name not in now and name not in self._inside]
        self._counts = {
            name: self._counts.get(name, 0) + sum(_has_overtaken(other, elder) for other in went)
            for name, elder in now.items()
        }
        self._waiting, self._inside = now, inside
        return self._counts


def _look_at(state: LabState, run: RunState) -> _Known:
    modules = frozenset(step.module for step in state.runs.plan_of(run).steps)
    return _Known(run.position, run.priority, modules)


def _has_overtaken(run: _Known, elder: _Known) -> bool:
    is_younger = run.position > elder.position and run.priority <= elder.priority
    return is_younger and not run.modules.isdisjoint(elder.modules)

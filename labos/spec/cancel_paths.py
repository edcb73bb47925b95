"""A check of the ``on_cancel`` steps of a plan, for a cancellation after any of its steps."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from typing import Any

from labos.core.effects import list_carried
from labos.core.ids import ModuleName, StationName, local
from labos.core.leaving import BenchOfRun, find_way_out, list_steps_out
from labos.core.model import Plan
from labos.spec.dryrun import DryRun
from labos.spec.paper import AddFinding


class CancelPaths:
    """Reports each finding once: faults to ``error``; labware that is left in the way to ``warning``."""

    def __init__(self, plan: Plan, error: AddFinding, warning: AddFinding) -> None:
        self.plan, self.error, self.warning = plan, error, warning
        self.steps = list_steps_out(plan)
        self._seen: set[Any] = set()
        self._reported: set[tuple[int, str]] = set()
        self._left: set[StationName] = set()

    def check(self) -> None:
        """Check what does not depend on the place of the cancellation."""
        for index in self.steps:
            if any(what.stock for what in list_carried(self.plan.steps[index].effects)):
                what = "A workflow on cancellation cannot take new labware."
                self.error(index, what, "Move what the run has on the bench, or leave this step out.")

    def try_out(self, dry: DryRun, last: int) -> None:
        """Cancel the run after step ``last``, in the present state of ``dry``."""
        mark = dry.mark()
        if mark in self._seen:
            return
        self._seen.add(mark)
        key = self.plan.steps[last].key

        def add_finding(index: int, message: str, remedy: str) -> None:
            if (index, message) not in self._reported:
                self._reported.add((index, message))
                self.error(index, f"After a cancellation that follows {key!r}: {message}", remedy)

        steps = find_way_out(self.plan, find_bench_on_paper(dry))
        out = dry.copy(add_finding)
        out.run([(index, self.plan.steps[index]) for index in steps])
        for place in set(out.list_outputs()) - self._left:
            if not out.stations[place].is_storage:
                self._left.add(place)
                self.warning(
                    last,
                    f"If the run is cancelled after it, labware stays at {local(place)} and blocks "
                    "other runs.",
                    "Add a step under `on_cancel` that carries it to storage or waste.",
                )


def find_bench_on_paper(dry: DryRun) -> BenchOfRun:
    """The parts of the bench that concern a run, in the present state of its dry run."""
    rests: dict[ModuleName, Mapping[str, Any]] = {name: m.rest for name, m in dry.modules.items()}
    left = {
        name
        for name, rest in rests.items()
        if any(dry.variables.get(name, {}).get(variable, value) != value for variable, value in rest.items())
    }
    return BenchOfRun(
        Counter(dry.list_outputs()),
        {name: station.module for name, station in dry.stations.by_name.items()},
        {name: dict(values) for name, values in dry.variables.items()},
        rests,
        left,
    )

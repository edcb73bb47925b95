"""A dry run of a plan: on each of its ways, and with a cancellation after each of its steps."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial

from labos.core.branches import list_ways, main_steps
from labos.core.ids import ModuleName, StationName
from labos.core.leaving import list_steps_out
from labos.core.model import LabwareSpec, ModuleSpec, Plan
from labos.spec.bench import BenchFile
from labos.spec.cancel_paths import CancelPaths
from labos.spec.dryrun import DryRun
from labos.spec.findings import Remarks
from labos.spec.paper import UNKNOWN, AddFinding
from labos.spec.plan_branches import PlanBranches, find_first_way
from labos.spec.stations import Stations
from labos.spec.steps import Steps


class InitialBench:
    """The bench before any run. ``bench`` has the known labware on it; ``labware`` are the types that the
    workcell knows."""

    def __init__(
        self,
        stations: Stations,
        modules: Mapping[ModuleName, ModuleSpec],
        bench: BenchFile | None,
        labware: Mapping[str, LabwareSpec],
    ) -> None:
        self.stations, self.modules, self.labware = stations, modules, labware
        self.stock: dict[StationName, str] = {}
        self.away_from_rest = bench.away_from_rest if bench is not None else {}
        self.counts: dict[StationName, int] | None = None if bench is None else {}
        for item in bench.stock if bench is not None else ():
            place = stations[item.station].hotel or item.station
            self.stock[place] = item.labware if self.stock.get(place, item.labware) == item.labware else ""
            assert self.counts is not None
            self.counts[place] = self.counts.get(place, 0) + item.count

    def make_dry_run(self, error: AddFinding, warning: AddFinding) -> DryRun:
        """A dry run that has not begun."""
        counts = None if self.counts is None else dict(self.counts)
        dry = DryRun(self.stations, self.modules, self.labware, self.stock, counts, error, warning)
        for module, names in self.away_from_rest.items():
            dry.variables.setdefault(module, {}).update(dict.fromkeys(names, UNKNOWN))
        return dry


class PlanCheck:
    """Tries a plan, and reports its faults. If steps may overtake each other, a fault in only one order is a
    warning."""

    def __init__(self, bench: InitialBench, steps: Steps, remarks: Remarks) -> None:
        self.bench, self.steps, self.remarks = bench, steps, remarks
        self._error = self._make_reporter(certain=steps.is_chain())
        self._warning = self._make_reporter(certain=False)

    def do_dry_run(self, plan: Plan) -> tuple[Plan, DryRun]:
        """Returns also the plan in which only steps may be skipped for which this is possible."""
        plan, dry = self._do_all_ways(plan)
        if list_steps_out(plan) and not self.remarks.report.errors:
            self._try_ways_out(plan)
        return plan, dry

    def _do_all_ways(self, plan: Plan) -> tuple[Plan, DryRun]:
        forks = any(step.on_error is not None or step.when is not None for step in plan.steps)
        main = set(main_steps(plan))
        order = (
            find_first_way(plan) if forks else [index for index in self.steps.sort_steps() if index in main]
        )
        dry = self._run(plan, order, self._error, self._warning)
        if not forks or self.remarks.report.errors:
            return plan, dry
        explicit = {index for index, entry in enumerate(self.steps.entries) if entry.on_error == "skip"}
        courses = PlanBranches(plan, self._run, explicit)
        courses.try_out()
        for fault in courses.errors:
            self._error(*fault)
        for fault in courses.warnings:
            self._warning(*fault)
        dry.inputs = courses.inputs
        return courses.plan, dry

    def _try_ways_out(self, plan: Plan) -> None:
        """Cancel the run after each of its steps, in dry runs."""
        out = CancelPaths(plan, self._error, self._warning)
        out.check()
        for way in list_ways(plan):
            dry = self.bench.make_dry_run(_ignore, _ignore)
            dry.run([(index, plan.steps[index]) for index in way.steps], partial(out.try_out, dry))

    def _run(self, plan: Plan, order: Sequence[int], error: AddFinding, warning: AddFinding) -> DryRun:
        dry = self.bench.make_dry_run(error, warning)
        dry.run([(index, plan.steps[index]) for index in order])
        return dry

    def _make_reporter(self, *, certain: bool) -> AddFinding:
        say = self.remarks.error if certain else self.remarks.add_warning

        def add_finding(index: int, message: str, remedy: str) -> None:
            say(f"Step {self.steps.keys[index]!r}: {message}", ("steps", index), remedy)

        return add_finding


def _ignore(index: int, message: str, remedy: str) -> None:
    """Findings that were reported before are not reported again."""

"""Every way that a plan may take, tried in a dry run: labware has to be where it is needed on each way.

A step may be skipped only if the later steps are possible without it. Recovery steps can only use the labware
that the failed step found. If this does not hold, a written ``on_error`` is an error, a module's default is
not applied, and a person cannot choose to skip the step.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import msgspec

from labos.core.branches import TooManyWays, Way, is_inert, list_ways, main_steps, sort_steps
from labos.core.conditions import find_decision
from labos.core.effects import list_carried
from labos.core.ids import StationName, local
from labos.core.model import OnError, Plan
from labos.core.runs import list_rescue_steps
from labos.spec.dryrun import DryRun
from labos.spec.paper import AddFinding

Paper = Callable[[Plan, Sequence[int], AddFinding, AddFinding], DryRun]
"""Carries out some of a plan's steps in a dry run, in this order, and reports errors and warnings."""

Fault = tuple[int, str, str]
"""The index of a step, its fault on some way, and a remedy."""


class PlanBranches:
    """The ways of one plan. ``explicit`` are the steps with an explicit ``skip``. ``errors`` and ``warnings``
    were found on ways with a failure. ``plan`` is the plan in which only steps may be skipped for which this
    is possible."""

    def __init__(self, plan: Plan, paper: Paper, explicit: set[int]) -> None:
        self.plan, self.paper, self.explicit = plan, paper, explicit
        self.errors: list[Fault] = []
        self.warnings: list[Fault] = []
        self.main = sort_steps(plan, main_steps(plan))
        self.conditional = any(step.when is not None for step in plan.steps)
        self.inputs: list[StationName] = []
        self._warned: set[tuple[int, str]] = set()
        first = Way(find_first_way(plan))
        self.inputs = self._list_faults(first)[1]
        if self.conditional:
            for place in set(self.inputs) & self._find_filled():
                where, last = local(place), first.steps[-1]
                what = f"With all conditions true, labware of this run is needed twice at {where}."
                remedy = "Of two conditions that exclude each other, write one as `not (…)`."
                self.errors.append((last, what, remedy))

    def try_out(self) -> None:
        """Try all ways; called when the way without a failure has no fault."""
        for index in self.main:
            policy = self.plan.steps[index].on_error
            if policy is None:
                continue
            if policy.do == "run":
                self._try_recovery(index)
            elif not is_inert(self.plan, index):
                self._try_skip(index, policy)
        if self.errors:
            return
        try:
            found = list_ways(self.plan)
        except TooManyWays:
            self._ask_less()
            try:
                found = list_ways(self.plan)
            except TooManyWays:
                what = (
                    "The workflow has too many possible paths: too many of its steps may fail to check "
                    "all combinations."
                )
                remedy = "Allow skipping or recovery for fewer steps that move labware."
                self.errors.append((self.main[0], what, remedy))
                return
        for way in found[1:]:
            if self.conditional or len(way.without | way.rescued) > 1:
                self._keep(way, self._list_faults(way)[0])

    def _try_skip(self, index: int, policy: OnError) -> None:
        if self.conditional and index in self.explicit:
            return  # all ways are checked below
        steps = tuple(step for step in self.main if step != index)
        way = Way(steps, without=frozenset((index,)))
        faults = self._list_faults(way)[0]
        if self.conditional and not faults:
            faults = [(index, "The following steps depend on results.", "")]
        if not faults:
            return
        if index in self.explicit:
            self._keep(way, faults)
            return
        kept = None if policy.do == "skip" else msgspec.structs.replace(policy, may_skip=False)
        self._replace(index, kept)
        if policy.do == "skip":
            module = local(self.plan.steps[index].module)
            what = f"It cannot be skipped as {module} says by default: {_start_lower_case(faults[0][1])}"
            self.warnings.append(
                (index, what, "If it fails, the run fails. Set another reaction under `on_error`.")
            )

    def _try_recovery(self, index: int) -> None:
        policy = self.plan.steps[index].on_error
        assert policy is not None
        if self.plan.steps[index].expect is not None and not is_inert(self.plan, index):
            what = (
                "The step changes the bench, so after a wrong result recovery steps would not find the "
                "state before it."
            )
            self.errors.append((index, what, "Put `expect` on a separate step that only measures."))
        if self.conditional:
            return  # all ways are checked below
        at = self.main.index(index)
        rest = self.main[at + 1 :] if policy.then == "go_on" else ()
        recovery = sort_steps(self.plan, list_rescue_steps(self.plan, index))
        way = Way((*self.main[:at], *recovery, *rest), rescued=frozenset((index,)))
        self._keep(way, self._list_faults(way)[0])

    def _ask_less(self) -> None:
        """Let people skip only steps that make no difference."""
        for index in self.main:
            policy = self.plan.steps[index].on_error
            if policy is not None and policy.do == "ask" and not is_inert(self.plan, index):
                self._replace(index, msgspec.structs.replace(policy, may_skip=False))

    def _replace(self, index: int, policy: OnError | None) -> None:
        steps = list(self.plan.steps)
        steps[index] = msgspec.structs.replace(steps[index], on_error=policy)
        self.plan = msgspec.structs.replace(self.plan, steps=tuple(steps))

    def _list_faults(self, way: Way) -> tuple[list[Fault], list[StationName]]:
        """The faults of a way, and the stations at which labware must be at its start. A finding that is only
        a warning on the way without a failure is not a fault, for example a stack that has to be refilled
        during the run."""
        faults: list[Fault] = []

        def add_finding(index: int, message: str, remedy: str) -> None:
            faults.append((index, message, remedy))

        def warn(index: int, message: str, remedy: str) -> None:
            if plain:
                self._warned.add((index, message))
            elif (index, message) not in self._warned:
                faults.append((index, message, remedy))

        plain = way.plain and not way.decisions
        dry = self.paper(self.plan, way.steps, add_finding, warn)
        if not plain:
            spare = list(self.inputs)
            for place in dry.inputs:
                if place in spare:
                    spare.remove(place)
                    continue
                if way.plain and place not in self._find_filled():
                    self.inputs.append(place)  # it must be there for that way
                    continue
                where = local(place)
                faults.append(
                    (
                        way.steps[-1],
                        f"Labware of this run is needed at {where}, but none is there.",
                        "Move it there, or do not skip the step that does.",
                    )
                )
        return faults, dry.inputs

    def _find_filled(self) -> set[StationName]:
        """The stations at which the run itself puts labware, on any way."""
        effects = [effect for step in self.plan.steps for effect in step.effects]
        return {what.filled for what in list_carried(effects) if what.filled}

    def _keep(self, way: Way, faults: Sequence[Fault]) -> None:
        """Store faults with the way on which they were found."""
        for index, message, remedy in faults[:3]:
            fault = (index, f"{self._describe_way(way)}: {_start_lower_case(message)}", remedy)
            if fault not in self.errors:
                self.errors.append(fault)

    def _describe_way(self, way: Way) -> str:
        steps = self.plan.steps
        parts = [f"{steps[index].key!r} fails and is skipped" for index in sorted(way.without)]
        parts += [f"{steps[index].key!r} fails and is recovered from" for index in sorted(way.rescued)]
        texts = {find_decision(step.when): step.when.text for step in steps if step.when is not None}
        for what, value in way.decisions:
            text = texts.get((what, True)) or texts[what, False]
            holds = value == ((what, True) in texts)
            parts.append(f"`{text}` {'holds' if holds else 'does not hold'}")
        return f"If {' and '.join(parts)}"


def find_first_way(plan: Plan) -> tuple[int, ...]:
    """The steps of a way without a failure. If steps exclude each other, those written first are used."""
    decisions: dict[str, bool] = {}
    steps: list[int] = []
    for index in sort_steps(plan, main_steps(plan)):
        condition = plan.steps[index].when
        if condition is not None:
            what, positive = find_decision(condition)
            if decisions.setdefault(what, positive) != positive:
                continue
        steps.append(index)
    return tuple(steps)


def _start_lower_case(message: str) -> str:
    return message[:1].lower() + message[1:]

"""Small workcells gone through in every order: what safety answers, beside what is true.

A state is true to be safe if everybody inside can come to the end whatever the actions in flight do: there
is something to start after which that is so, or it is so however the next one ends. Runs that are not
inside yet stay out. A step that takes hold of a module by its plan's word waits while another keeps it.
"""

from __future__ import annotations

import random
from collections.abc import Iterator
from itertools import pairwise

import msgspec

from labos.core.ids import ActionId, RunId
from labos.core.model import Hold, OnError, Plan, PlanStep
from labos.core.rules import examine
from labos.core.state import encode_picture, from_picture
from labos.core.waits import Wait
from labos.planning.safety import Safety
from labos.planning.scheduler import list_ready_steps
from labos.planning.stuck import find_block
from tests.support.bench import (
    Driver,
    claims,
    hold,
    module,
    move,
    needs,
    plan,
    releases,
    station,
    step,
    take,
    workcell,
)

Key = tuple[object, ...]
Start = tuple[RunId, int]


class Count(msgspec.Struct):
    """What safety was asked, and where it was wrong. In a dead end somebody is inside, nothing is in flight,
    and nothing may start."""

    asked: int = 0
    unsafe_allowed: int = 0
    safe_refused: int = 0
    states: int = 0
    dead_ends: int = 0

    def with_(self, other: Count) -> Count:
        """Both together."""
        return Count(
            *map(sum, zip(msgspec.structs.astuple(self), msgspec.structs.astuple(other), strict=True))
        )


class SmallCell:
    """Three stations and two or three short runs. ``kinds``: ``holds`` of a module of which some of them
    need steps, ``decks``, ``setpoints`` beside labware, ``forks`` where a step fails or not, two branches
    ``beside`` each other in a run, which may have to use the same places."""

    def __init__(self, rng: random.Random, *kinds: str) -> None:
        self.rng, self.kinds = rng, kinds
        self.places = ["s0", "s1", "dev.n" if "decks" in kinds else "s2"]

    def submit_all(self) -> Driver:
        lab = Driver(
            workcell(
                [*map(module, ("arm", "arm2", "dev", "sealer", "heat"))],
                [
                    station("stack", "stack", 9),
                    station("trash", "waste", 9),
                    station("spare"),
                    *(station(name, "deck", claim=True) for name in self.places if name == "dev.n"),
                    *(station(name) for name in self.places if name != "dev.n"),
                ],
            )
        )
        lab.careful = False
        lab.stock("stack", 5)
        for _ in range(2 if {"forks", "beside"} & {*self.kinds} else self.rng.randint(2, 3)):
            lab.submit(self.two_branches() if "beside" in self.kinds else self.some_plan())
        return lab

    def two_branches(self) -> Plan:
        """Two plates go their ways beside each other; now and then a step of one waits for the other."""
        steps: list[PlanStep] = []
        for arm in ("arm", "arm2"):
            route = [self.rng.choice(self.places)]
            if self.rng.random() < 0.5:
                route.append(self.rng.choice([place for place in self.places if place != route[0]]))
            first = len(steps)
            steps.append(step(arm, take("stack", route[0])))
            for here, there in pairwise([*route, "trash"]):
                if here == "dev.n" and self.rng.random() < 0.5:
                    steps.append(step("dev", needs("dev.n"), after=(len(steps) - 1,)))
                steps.append(step(arm, move(here, there), after=(len(steps) - 1,)))
            if first and self.rng.random() < 0.3:
                late = self.rng.randrange(first, len(steps))
                after = (*steps[late].after, self.rng.randrange(first))
                steps[late] = msgspec.structs.replace(steps[late], after=after)
        return plan(*steps, name=f"w{self.rng.random()}", parallel=True)

    def some_plan(self) -> Plan:
        rng = self.rng
        route = [rng.choice(self.places)]
        for _ in range(rng.randint(1, 2)):
            route.append(rng.choice([place for place in self.places if place != route[-1]]))
        arm = rng.choice(["arm", "arm2"])
        steps = [step(arm, take("stack", route[0]))]
        for here, there in pairwise([*route, "trash"]):
            if here == "dev.n" or rng.random() < 0.25:
                steps.append(step("dev" if here == "dev.n" else rng.choice(["sealer", "dev"])))
            steps.append(step(arm, move(here, there)))
        if "setpoints" in self.kinds and rng.random() < 0.7:
            first = rng.randrange(len(steps))
            steps.insert(first, step("heat", claims("t", rng.choice([37, 42]))))
            if rng.random() < 0.5:
                steps.insert(rng.randint(first + 1, len(steps)), step("heat", releases("t")))
        kept: tuple[Hold, ...] = ()
        if "holds" in self.kinds and rng.random() < 0.8:
            first = rng.randrange(len(steps))
            kept = (hold(rng.choice(["sealer", "dev", "arm"]), first, rng.randrange(first, len(steps))),)
        return self.fork(plan(*steps, name=f"w{rng.random()}", holds=kept))

    def fork(self, what: Plan) -> Plan:
        """One step may fail, and is made good by way of a place of which the rest knows nothing, or of one
        that others use."""
        carrying = [
            n for n, s in enumerate(what.steps) if s.effects and type(s.effects[0]) is type(move("", ""))
        ]
        if "forks" not in self.kinds or not carrying or self.rng.random() < 0.3:
            return what
        failing = self.rng.choice(carrying)
        (carried,) = what.steps[failing].effects
        here, there = carried.source, carried.target  # type: ignore[union-attr]
        between = self.rng.choice(
            [p for p in (*self.places, "spare") if not here.endswith(p) and not there.endswith(p)]
        )
        steps: list[PlanStep] = list(what.steps)
        steps[failing] = msgspec.structs.replace(steps[failing], on_error=OnError("run", "go_on"))
        for n, effect in enumerate((move(here, between), move(between, there))):
            after = (len(what.steps),) if n else ()
            steps.append(
                msgspec.structs.replace(step("arm2", effect), key=f"r{n}", part=failing, after=after)
            )
        return msgspec.structs.replace(what, steps=tuple(steps))


class Explored:
    """All states of a lab to which what safety allows leads from the one that it is in."""

    def __init__(self, lab: Driver) -> None:
        self.states: dict[Key, bytes] = {}
        self.safe: dict[Key, bool] = {}
        self.root = self.note(lab)

    def note(self, lab: Driver) -> Key:
        """Remember a state; what it is called does not tell the order in which it was reached."""
        runs = lab.state.runs
        key = tuple(
            tuple(runs.active[name].statuses)
            if (name := RunId(f"R{n + 1}")) in runs.active
            else name in runs.queued
            for n in range(runs.named)
        ) + self.belongings(lab)
        self.states.setdefault(key, encode_picture(lab.state))
        return key

    @staticmethod
    def belongings(lab: Driver) -> Key:
        """What belongs to no run or is lent to one, and how variables stand: that may depend on who came
        first."""
        items = [i for i in lab.state.bench.labware.values() if i.lender or not i.owner.startswith("run:")]
        values = [str(module.values) for module in lab.state.modules.by_name.values()]
        return (*sorted((i.station, i.owner, i.lender, str(i.variables)) for i in items), *values)

    def at(self, key: Key) -> Driver:
        lab = Driver()
        lab.careful = False
        lab.state = from_picture(self.states[key])
        lab._actions = lab.state.position  # no action has that name yet
        return lab

    def starts(self, lab: Driver, *, newcomers: bool) -> Iterator[Start]:
        """What the rules let start."""
        queued = [r for r in lab.state.runs.queued.values() if newcomers and find_block(lab.state, r) is None]
        for run in [*lab.state.runs.active.values(), *queued]:
            steps = (
                list_ready_steps(lab.state, run) if run.has_started else lab.state.runs.plans[run.plan].starts
            )
            for index in steps:
                kept = [h.module for h in lab.state.runs.plan_of(run).holds if h.first == index]
                others = [who for name in kept for who in lab.state.runs.list_holders(name) if who != run.id]
                if not others and not isinstance(examine(lab.state, run, index, lab.now), Wait):
                    yield run.id, index

    def after(self, key: Key, start: Start) -> Key:
        lab = self.at(key)
        lab.start(*start)
        return self.note(lab)

    def ends(self, key: Key) -> list[Key]:
        """What may be next if nothing is started: each action in flight may be the first that ends."""
        found = []
        for action in self.at(key).list_flying():
            for fails in (False, True):
                lab = self.at(key)
                if not fails:
                    lab.finish(action)
                elif self.may_fail(lab, action):
                    lab.fail(action, "none")
                else:
                    continue
                found.append(self.note(lab))
        return found

    def may_fail(self, lab: Driver, action: ActionId) -> bool:
        at = lab.state.actions.open[action]
        return lab.state.runs.plan_of(lab.run(at.run)).steps[at.step].on_error is not None

    def is_safe(self, key: Key) -> bool:
        """Whether everybody inside can come to the end."""
        known = self.safe.get(key)
        if known is None:
            lab = self.at(key)
            known = not lab.state.runs.active
            ends = [] if known else self.ends(key)
            known = known or (bool(ends) and all(map(self.is_safe, ends)))
            known = known or any(self.is_safe(self.after(key, s)) for s in self.starts(lab, newcomers=False))
            self.safe[key] = known
        return known

    def count(self) -> Count:
        """Go through all states that what safety allows leads to, and ask about every start there."""
        count, left, seen = Count(), [self.root], {self.root}
        while left:
            key = left.pop()
            lab = self.at(key)
            after = self.ends(key)
            inside = len(lab.state.runs.active)
            for start in self.starts(lab, newcomers=True):
                then = self.after(key, start)
                allowed = not Safety().list_trapped(lab.state, lab.run(start[0]), start[1], only_asking=True)
                count.asked += 1
                count.unsafe_allowed += allowed and not self.is_safe(then)
                count.safe_refused += not allowed and self.is_safe(then)
                after += [then] if allowed else []
            count.dead_ends += bool(inside) and not after
            fresh = [then for then in dict.fromkeys(after) if then not in seen]
            seen.update(fresh)
            left += fresh
        count.states = len(seen)
        return count

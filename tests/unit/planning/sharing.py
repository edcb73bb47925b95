"""Small workcells in which several runs need the same labware where it stands, carry it or throw it away."""

from __future__ import annotations

import random

from labos.core.decide.handover import HandOver
from labos.core.effects import AnyEffect
from labos.core.ids import LabwareId, Owner
from labos.core.model import Hold, Plan, PlanStep
from tests.support.bench import (
    Driver,
    claims,
    hold,
    module,
    move,
    needs,
    plan,
    releases,
    relid,
    requires,
    sets,
    station,
    step,
    take,
    unlid,
    workcell,
)

USERS = ("ada", "bob")
STANDING = ("a", "b", "dev.n1", "cam.nest")
"""Where labware stands before anybody comes; ``dev.n1`` claims its module."""


class Sharing:
    """Two or three plates that are everybody's or one user's, and two to five plans about them. Each plan
    could be carried out if nobody else were there. Some belong to one experiment."""

    def __init__(self, rng: random.Random, most: int = 5) -> None:
        self.rng = rng
        rest = {"lid": "open"} if rng.random() < 0.3 else {}
        self.cell = workcell(
            [
                module("arm"),
                module("arm2"),
                module("dev", variables=rest, rest=rest),
                module("cam"),
                module("heat", variables={"mode": 0}),
            ],
            [
                station("stack", "stack", 20),
                station("trash", "waste", 99),
                station("lids", accepts=("lid",)),
                *map(station, ("a", "b", "c")),
                station("dev.n1", "deck", claim=True, access=rest),
                station("dev.n2", "deck", claim=True, access=rest),
                station("cam.nest"),
                station("cam.spare"),
            ],
        )
        self.standing = rng.sample(STANDING, rng.randint(1, 3))
        self.lidded = set(rng.sample(self.standing, rng.randint(0, 1)))
        self.plans = [self.some_plan() for _ in range(rng.randint(2, most))]

    def some_plan(self) -> Plan:
        """What one run does with the plates that stand there, and with one of its own."""
        rng = self.rng
        there, free = list(self.standing), [p for p in (*STANDING, "c") if p not in self.standing]
        lids = {place: place in self.lidded for place in there}
        sealed: dict[str, bool] = {}
        mine, steps = "", list[PlanStep]()
        for _ in range(rng.randint(1, 5)):
            what = rng.random()
            if what < 0.4 and there:
                steps.append(self.work(rng.choice(there), sealed))
            elif what < 0.6 and there:
                here = rng.choice(there)
                there.remove(here)
                target = "trash" if rng.random() < 0.5 or not free else rng.choice(free)
                steps.append(step(self.arm(), move(here, target)))
                if target != "trash":
                    there.append(target)
                    lids[target] = lids[here]
                    free.remove(target)
                    sealed[target] = sealed.pop(here, False)
            elif what < 0.75 and not mine and free:
                mine = rng.choice(free)
                free.remove(mine)
                steps.append(step(self.arm(), take("stack", mine)))
            elif what < 0.85:
                steps.append(step(rng.choice(["dev", "heat", "cam"])))
            elif there and lids[here := rng.choice(there)]:
                steps.append(step(self.arm(), unlid(here, "lids")))
                if rng.random() < 0.5:
                    steps.append(step("cam", needs(here)))
                steps.append(step(self.arm(), relid("lids", here)))
        if mine:
            steps.append(step(self.arm(), move(mine, "trash")))
        steps = steps or [self.work(self.standing[0], {})]
        return plan(*self.weave(steps), name=f"w{rng.random()}", holds=self.holds(steps))

    def arm(self) -> str:
        return self.rng.choice(["arm", "arm2"])

    def work(self, here: str, sealed: dict[str, bool]) -> PlanStep:
        """Something that is done to a plate where it stands, without or with a trace on it."""
        rng = self.rng
        effects: list[AnyEffect] = [needs(here)]
        if here in ("dev.n1", "cam.nest") and rng.random() < 0.3:
            effects = [needs()]
        elif rng.random() < 0.3:
            effects += [requires("sealed", sealed.get(here, False), "labware")]
        elif rng.random() < 0.3:
            sealed[here] = not sealed.get(here, False)
            effects += [sets("sealed", sealed[here], "labware")]
        on = here.partition(".")[0] if "." in here else rng.choice(["cam", "dev", "heat"])
        return step(on, *effects, exclusive=rng.random() < 0.8)

    def weave(self, steps: list[PlanStep]) -> list[PlanStep]:
        rng = self.rng
        if rng.random() < 0.3:  # a mode that stays as somebody has set it
            mode, at = 0, 0
            for _ in range(rng.randint(1, 3)):
                at = rng.randint(at, len(steps))
                if rng.random() < 0.5:
                    mode = rng.choice([0, 1, 2])
                    steps.insert(at, step("heat", sets("mode", mode)))
                else:
                    steps.insert(at, step("heat", requires("mode", mode)))
                at += 1
        if rng.random() < 0.3:
            first = rng.randrange(len(steps))
            steps.insert(first, step("heat", claims("t", rng.choice([37, 42]))))
            if rng.random() < 0.5:
                steps.insert(rng.randint(first + 1, len(steps)), step("heat", releases("t")))
        return steps

    def holds(self, steps: list[PlanStep]) -> tuple[Hold, ...]:
        if self.rng.random() > 0.3:
            return ()
        first = self.rng.randrange(len(steps))
        return (hold(self.rng.choice(["dev", "cam", "arm"]), first, self.rng.randrange(first, len(steps))),)

    def submit_all(self) -> Driver:
        rng = self.rng
        lab = Driver(self.cell)
        lab.careful = False
        lab.stock("stack", 9)
        for place in self.standing:
            lab.stock(place, 1, "plate+lid" if place in self.lidded else "plate")
            owner = rng.choice(["", "", "user:ada", "user:bob"])
            if owner:
                lab.do(HandOver(LabwareId(lab.at(place)[0]), Owner(owner), "labos"))
        experiment = lab.experiment(user="ada") if rng.random() < 0.3 else ""
        for number, what in enumerate(self.plans):
            more = {"experiment": experiment} if experiment and number % 2 == 0 else {}
            lab.submit(what, user=USERS[number % 2], priority=rng.choice([0, 0, 1]), **more)
        return lab


__all__ = ["Sharing"]

"""Random small workcells, and plans that have every reason to get into each other's way."""

from __future__ import annotations

import random

from labos.core.effects import Move, Take
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
    sets,
    station,
    step,
    take,
    unlid,
    workcell,
)


class Case:
    """A workcell of 3 to 6 stations of capacity 1 or 2, some of them on a deck that has one holder
    at a time, and ``plans`` that cross it on routes which may come back to where they were.
    A share of them (``stays``) comes to rest at its last station instead of in the waste. With
    ``holds`` they keep the deck from others before they come, and set a heater on their way. With
    ``zones`` there are always two arms, and parts of the bench that only one of them may be in. With
    ``hands`` some labware is picked and placed in two steps. With
    ``covers`` plates wear lids, which some put aside in a nest on their way."""

    def __init__(
        self,
        rng: random.Random,
        *,
        lids: bool = False,
        holds: bool = False,
        covers: bool = False,
        stays: float = 0.0,
        zones: bool = False,
        hands: bool = False,
    ) -> None:
        self.rng, self.covers = rng, covers
        self.lids, self.holds, self.stays, self.hands = lids, holds, stays, hands
        arms = [module("arm"), *[module("arm2")] * (1 if zones else rng.randint(0, 1))]
        rest = {"lid": "open"} if lids else {}
        deck = [f"dev.n{i}" for i in range(rng.randint(0, 2))]
        free = [f"s{i}" for i in range(max(3 - len(deck), rng.randint(1, 4)))]
        self.arms = [spec.name.partition("/")[2] for spec in arms]
        self.places = [*free, *deck]
        self.cell = workcell(
            [*arms, module("dev", variables=rest, rest=rest), module("cam"), module("heat")],
            [
                station("stack", "stack", 40),
                station("trash", "waste", 199),
                *([station("lids", accepts=("lid",), capacity=rng.choice([1, 1, 2]))] if covers else ()),
                *(station(f"{arm}.gripper", "gripper") for arm in self.arms if hands),
                *(station(name, capacity=rng.choice([1, 1, 1, 2]), **self.zone(zones)) for name in free),
                *(station(name, "deck", claim=True, access=rest, **self.zone(zones)) for name in deck),
            ],
        )
        self.plans = [self.some_plan() for _ in range(rng.randint(2, 7))]

    def zone(self, zones: bool) -> dict[str, str]:
        """The zone of a station, of two or none."""
        return {"zone": self.rng.choice(["cell/z1", "cell/z1", "cell/z2", ""])} if zones else {}

    def some_plan(self) -> Plan:
        rng = self.rng
        route = [rng.choice(self.places)]
        for _ in range(rng.randint(1, 4)):
            route.append(rng.choice([p for p in self.places if p != route[-1]]))
        steps: list[PlanStep] = [step(rng.choice(self.arms), take("stack", route[0]))]
        ends = [] if rng.random() < self.stays else ["trash"]
        for here, there in zip(route, [*route[1:], *ends], strict=False):
            if here.startswith("dev"):
                if self.lids:
                    steps += [step("dev", sets("lid", "shut")), step("dev", sets("lid", "open"))]
                else:
                    steps.append(step("dev", needs()))
            elif rng.random() < 0.2:
                steps.append(step("cam", exclusive=False))
            elif rng.random() < 0.15:
                steps.append(step("dev"))  # needs the module, but has no labware there
            steps += self.some_carrying(here, there)
        if self.covers:
            steps = self.uncover(steps, route)
        kept = self.some_holds(steps) if self.holds else ()
        return plan(*steps, name=f"w{rng.random()}", holds=kept)

    def uncover(self, steps: list[PlanStep], route: list[str]) -> list[PlanStep]:
        """Take the lid off at one place, and put it back on at a later one or throw it away."""
        rng = self.rng
        off = rng.randrange(len(route))
        on = rng.choice([None, *range(off, len(route))])
        woven: list[PlanStep] = []
        here = -1
        for item in steps:
            woven.append(item)
            if not isinstance(item.effects[0] if item.effects else None, Move | Take):
                continue
            here += 1
            if here == off:
                woven.append(step(rng.choice(self.arms), unlid(route[here], "lids")))
            if here == on and here < len(route):
                woven.append(step(rng.choice(self.arms), relid("lids", route[here])))
        return woven if on is not None else [*woven, step(rng.choice(self.arms), move("lids", "trash"))]

    def some_carrying(self, here: str, there: str) -> list[PlanStep]:
        """One transfer, or two steps with the labware in the hand between them."""
        arm = self.rng.choice(self.arms)
        if not self.hands or self.rng.random() < 0.4:
            return [step(arm, move(here, there))]
        hand = f"{arm}.gripper"
        between = [step("cam", exclusive=False)] if self.rng.random() < 0.2 else []
        return [step(arm, move(here, hand)), *between, step(arm, move(hand, there))]

    def some_holds(self, steps: list[PlanStep]) -> tuple[Hold, ...]:
        """Weave steps in that hold something beside labware."""
        rng = self.rng
        for _ in range(rng.randint(0, 2)):
            first = rng.randrange(len(steps))
            steps.insert(first, step("heat", claims("t", rng.choice([37, 42]))))
            if rng.random() < 0.5:
                steps.insert(rng.randint(first + 1, len(steps)), step("heat", releases("t")))
        first = rng.randrange(len(steps))
        return (
            (hold(rng.choice(["dev", "dev", "arm"]), first, rng.randint(first, len(steps) - 1)),)
            if rng.random() < 0.6
            else ()
        )

    def lab(self) -> Driver:
        lab = Driver(self.cell)
        lab.stock("stack", 40, "plate+lid" if self.covers else "plate")
        return lab

    def submit_all(self) -> Driver:
        lab = self.lab()
        for number, what in enumerate(self.plans):
            lab.submit(what, user=("ada", "bob")[number % 2], priority=self.rng.choice([0, 0, 0, 1]))
        return lab

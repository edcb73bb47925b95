"""Random small workcells in which everything that can keep others from something comes together: hands,
zones, lids, doors, decks, holds, setpoints, places to change the grip, stacks, two plates of one run,
steps beside each other, steps that fail and are recovered from, and what an experiment parks."""

from __future__ import annotations

import random
from collections.abc import Sequence
from itertools import pairwise

import msgspec

from labos.core.effects import AnyEffect
from labos.core.ids import ActionId
from labos.core.model import Hold, OnError, Plan, PlanStep
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

ARMS = ("arm", "arm2")
KINDS = (
    "hands",
    "zones",
    "covers",
    "doors",
    "decks",
    "holds",
    "setpoints",
    "grips",
    "piles",
    "pairs",
    "forks",
)
OPEN = {"lid": "open"}


class Item:
    """A step of a plan that is being written, and the steps that have to be done before it."""

    def __init__(self, what: PlanStep, *after: Item) -> None:
        self.what = what
        self.after = list(after)

    def add(self, *effects: AnyEffect) -> None:
        self.what = msgspec.structs.replace(self.what, effects=(*self.what.effects, *effects))

    def waits_for(self, other: Item) -> bool:
        return any(before is other or before.waits_for(other) for before in self.after)


class Mixed:
    """A workcell and plans of as many kinds as chance says. With ``stays`` a share of the plates comes to
    rest where its run ends. Each plan could be carried out in the empty workcell."""

    def __init__(self, rng: random.Random, *, stays: float = 0.0) -> None:
        self.rng, self.stays = rng, stays
        self.kinds = {kind for kind in KINDS if rng.random() < 0.5}
        decks = [f"dev.n{n}" for n in range(rng.randint(1, 2))] if "decks" in self.kinds else []
        free = [f"s{n}" for n in range(max(3 - len(decks), rng.randint(1, 4)))]
        piles = ["pile"] if "piles" in self.kinds else []
        self.places = [*free, *decks, *piles]
        rest = OPEN if "doors" in self.kinds else {}
        self.cell = workcell(
            [
                *map(module, ARMS),
                module("dev", variables=rest, rest=rest),
                module("press", variables=OPEN, rest=OPEN),
                *map(module, ("sealer", "heat", "cam")),
            ],
            [
                station("stack", "stack", 40),
                station("trash", "waste", 199),
                *([station("lids", accepts=("lid",), capacity=rng.choice([1, 1, 2]))] * self.has("covers")),
                *([station("grip", zone=self.zone())] * self.has("grips")),
                *(station(f"{arm}.gripper", "gripper") for arm in ARMS if self.has("hands")),
                *(station(name, capacity=rng.choice([1, 1, 1, 2]), zone=self.zone()) for name in free),
                *(station(name, "deck", claim=True, access=rest, zone=self.zone()) for name in decks),
                *(station(name, "stack", 3) for name in piles),
            ],
        )
        self.plans = [self.some_plan() for _ in range(rng.randint(2, 6))]

    def has(self, kind: str) -> bool:
        return kind in self.kinds

    def zone(self) -> str:
        return self.rng.choice(["cell/z1", "cell/z1", "cell/z2", ""]) if self.has("zones") else ""

    # -- plans -------------------------------------------------------------------------------

    def some_plan(self) -> Plan:
        """One plate, or two that have nothing to do with each other and so no place in common."""
        rng = self.rng
        places = rng.sample(self.places, len(self.places))
        two = self.has("pairs") and len(places) > 3 and rng.random() < 0.6
        cut = len(places) // 2 if two else len(places)
        chains = [self.chain(places[:cut]), *([self.chain(places[cut:], lidded=False)] if two else [])]
        items: list[Item] = []
        left = [list(chain) for chain in chains]
        while any(left):  # what is in a hand is put down before the arm has to do something else
            items += rng.choice([groups for groups in left if groups]).pop(0)
        # A lid that two plates of one run are behind is not worked by both of them at once.
        shared_lid = self.has("doors") and all("dev" in str([i.what for g in c for i in g]) for c in chains)
        if two and (shared_lid or rng.random() < 0.5):
            for before, behind in pairwise(items):
                behind.after.append(before)
        self.weave(items)
        return self.finish_plan(items)

    def chain(self, places: Sequence[str], *, lidded: bool = True) -> list[list[Item]]:
        """The way of one plate, in groups that are not torn apart."""
        rng = self.rng
        route = [rng.choice([place for place in places if place != "pile"])]
        for _ in range(rng.randint(0, 3) if len(places) > 1 else 0):
            route.append(rng.choice([place for place in places if place != route[-1]]))
        if rng.random() >= self.stays:
            route.append("trash")
        groups = [[Item(step(rng.choice(ARMS), take("stack", route[0])))]]
        covered = lidded and self.has("covers") and rng.random() < 0.6
        off = rng.randrange(len(route)) if covered else -1
        on = rng.randrange(off, len(route)) if covered else -1
        for number, here in enumerate(route):
            if number in (off, on) and route[off] not in ("trash", "pile") and here not in ("trash", "pile"):
                groups += self.lid(here, number == off, number == on)
            elif number == on and off >= 0 and route[off] not in ("trash", "pile"):
                groups.append([Item(step(rng.choice(ARMS), move("lids", "trash")))])
            if number + 1 < len(route):
                groups += [*self.work_at(here), self.start_carrying(here, route[number + 1])]
        last: Item | None = None
        for item in (item for group in groups for item in group):
            item.after += [last] if last is not None else []
            last = item
        return groups

    def lid(self, here: str, comes_off: bool, comes_on: bool) -> list[list[Item]]:
        arm = self.rng.choice(ARMS)
        off, on = [Item(step(arm, unlid(here, "lids")))], [Item(step(arm, relid("lids", here)))]
        return [*([off] * comes_off), *([on] * comes_on)]

    def work_at(self, here: str) -> list[list[Item]]:
        rng = self.rng
        if here.startswith("dev"):
            if self.has("doors"):
                return [[Item(step("dev", sets("lid", "shut"))), Item(step("dev", sets("lid", "open")))]]
            return [[Item(step("dev", needs(here)))]]
        if rng.random() < 0.3:
            return [[Item(step(rng.choice(["dev", "sealer", "press"])))]]
        return [[Item(step("cam", exclusive=False))]] if rng.random() < 0.2 else []

    def start_carrying(self, here: str, there: str) -> list[Item]:
        """One transfer, perhaps with a change of grip or by the device itself, or two steps with the
        labware in the hand between them."""
        rng = self.rng
        arm = rng.choice(ARMS)
        if self.has("hands") and rng.random() < 0.5:
            hand = f"{arm}.gripper"
            between = [Item(step("cam", exclusive=False))] if rng.random() < 0.2 else []
            return [Item(step(arm, move(here, hand))), *between, Item(step(arm, move(hand, there)))]
        if self.has("decks") and rng.random() < 0.2:
            return [Item(step("dev", move(here, there)))]
        via = "grip" if self.has("grips") and rng.random() < 0.4 else ""
        return [Item(step(arm, move(here, there, via)))]

    # -- what is held beside -----------------------------------------------------------------

    def weave(self, items: list[Item]) -> None:
        """Put in what holds something beside labware."""
        rng = self.rng
        if self.has("doors") and rng.random() < 0.5:
            first = self.insert(items, rng.randrange(len(items)), step("press", sets("lid", "shut")))
            at = rng.randint(items.index(first) + 1, len(items))
            self.insert(items, at, step("press", sets("lid", "open"))).after.append(first)
        for _ in range(rng.randint(0, 2) if self.has("setpoints") else 0):
            wanted = claims("t", rng.choice([37, 37, 42]))
            first = self.insert(items, rng.randrange(len(items)), step("heat", wanted))
            if rng.random() < 0.6:
                at = rng.randint(items.index(first) + 1, len(items))
                self.insert(items, at, step("heat", releases("t"))).after.append(first)
        if self.has("setpoints") and rng.random() < 0.5:
            self.slowly(items)

    def insert(self, items: list[Item], at: int, what: PlanStep) -> Item:
        """A step between two that follow one another."""
        new = Item(what, *items[at - 1 : at])
        if at < len(items):
            items[at].after.append(new)
        items.insert(at, new)
        return new

    def slowly(self, items: list[Item]) -> None:
        """An arm is set to a speed with one of its motions, perhaps until another."""
        arm = self.rng.choice(ARMS)
        carrying = [item for item in items if item.what.module == f"cell/{arm}"]
        if carrying:
            first = self.rng.randrange(len(carrying))
            carrying[first].add(claims("speed", self.rng.choice([1, 2])))
            if first + 1 < len(carrying) and carrying[-1].waits_for(carrying[first]):
                carrying[-1].add(releases("speed"))

    def holds(self, items: Sequence[Item]) -> tuple[Hold, ...]:
        """Modules that are kept by the plan's word, perhaps from a step that carries, perhaps crossed."""
        rng = self.rng
        found: dict[str, Hold] = {}
        for _ in range(rng.randint(0, 3) if self.has("holds") else 0):
            on = rng.choice(["dev", "sealer", "sealer", "press", "heat", *ARMS])
            first = rng.randrange(len(items))
            later = [n for n, item in enumerate(items) if n == first or item.waits_for(items[first])]
            found[on] = hold(on, first, rng.choice(later))
        return tuple(found.values())

    def finish_plan(self, items: list[Item]) -> Plan:
        """The plan, and behind its steps those that stand in for one that failed."""
        rng = self.rng
        steps: list[PlanStep] = []
        rescue: list[PlanStep] = []
        kept = self.holds(items)
        forks = 0
        for number, item in enumerate(items):
            what = item.what
            if self.has("forks") and forks < 4 and rng.random() < 0.3:
                others = self.stand_ins(what, items)
                policy = OnError("run", "go_on") if others else OnError("skip", may_skip=True)
                if others or what.module in ("cell/press", "cell/heat"):
                    forks += 1
                    what = msgspec.structs.replace(what, on_error=policy)
                for n, other in enumerate(others):
                    after = (len(items) + len(rescue) - 1,) if n else ()
                    key = f"r{len(rescue)}"
                    rescue.append(msgspec.structs.replace(other, key=key, part=number, after=after))
            before = tuple(sorted({items.index(other) for other in item.after}))
            steps.append(msgspec.structs.replace(what, after=before, key=f"s{number}"))
        made = plan(*steps, name=f"w{rng.random()}", parallel=True, holds=kept)
        return msgspec.structs.replace(made, steps=(*made.steps, *rescue))

    def stand_ins(self, what: PlanStep, items: Sequence[Item]) -> list[PlanStep]:
        """Another arm carries the labware instead, round by a place of which the plan knows nothing."""
        carried = what.effects[0] if what.effects else None
        if type(carried) is not type(move("a", "b")) or len(what.effects) > 1:
            return []
        here, there = carried.source, carried.target
        used = str([item.what.effects for item in items])
        round_by = [place for place in self.places if f"cell/{place}'" not in used and place != "pile"]
        if "gripper" in here + there or not round_by:
            return []
        arm, between = self.rng.choice(ARMS), self.rng.choice(round_by)
        return [step(arm, move(here, between)), step(arm, move(between, there))]

    # -- labs --------------------------------------------------------------------------------

    def submit_all(self) -> Driver:
        lab = Driver(self.cell)
        lab.careful = False
        lab.stock("stack", 40, "plate+lid" if self.has("covers") else "plate")
        for number, what in enumerate(self.plans):
            lab.submit(what, user=("ada", "bob")[number % 2], priority=self.rng.choice([0, 0, 0, 1]))
        return lab


def end(lab: Driver, rng: random.Random, action: ActionId) -> None:
    """A step succeeds; one that may fail sometimes does, without having done anything."""
    at = lab.state.actions.open[action]
    step_ = lab.state.runs.plan_of(lab.run(at.run)).steps[at.step]
    if step_.on_error is not None and rng.random() < 0.4:
        lab.fail(action, "none")
    else:
        lab.finish(action)

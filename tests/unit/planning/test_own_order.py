"""The lab's own order of all that waits, and the simplified model in which it is found.

The model (``outline``) is a second one, beside the rules. So what it predicts is held against what the real
kernel then does, in virtual time, on random workcells without windows.
"""

from __future__ import annotations

import random
from collections.abc import Callable, Sequence

import pytest

from labos.core.decide.runs import SubmitRun
from labos.core.ids import StationName
from labos.core.model import Plan, Workcell
from labos.core.runs import RunState
from labos.core.state import LabState
from labos.planning.outline import Outline, Ways
from labos.planning.own_order import AT_ONCE, OwnOrders
from labos.planning.scheduler import Scheduler
from tests.benchmarks.league.play import Outcome, Player, Work
from tests.support.bench import full, module, move, needs, plan, station, step, take, workcell

STOCK = {StationName(full("stack")): ("plate", 40)}
SECOND = 1_000_000_000
APART = 0.02
"""So far may the end that the model predicts be from the real one, as a part of the time between."""


class Told(OwnOrders):
    """Follows every order, however old the runs are. Keeps what was predicted at each look: (now, when all is
    over)."""

    def __init__(self) -> None:
        super().__init__(before_start=3 * AT_ONCE, weighs_age=False)
        self.predicted: list[tuple[int, int]] = []

    def search(
        self, state: LabState, cell: str, inside: Sequence[RunState], waiting: Sequence[RunState], now: int
    ) -> bool:
        changed = super().search(state, cell, inside, waiting, now)
        outline = Outline(state, cell, waiting, now, Ways())
        order = self.find(cell)
        assert order is not None, "each of these cells has an order"
        assert outline.is_safe
        if self._known[cell].seen == now:
            ends = [one.start + self._lasts(state, one.run, one.step) for one in order.steps]
            flying = [end for end, _, _ in outline.flying]
            self.predicted.append((now, max([*ends, *flying])))
        return changed

    def _lasts(self, state: LabState, run: str, index: int) -> int:
        known = state.runs.get(run)
        assert known is not None
        return int(state.runs.plan_of(known).steps[index].duration_s * SECOND)


def make_cell(rng: random.Random) -> tuple[Workcell, list[Plan]]:
    """A workcell of a few machines with one or two nests, one or two arms, and ways of three to five plates
    over some of the machines, some of them twice."""
    names = [f"m{number}" for number in range(rng.randint(2, 4))]
    arms = [f"arm{number}" for number in range(rng.randint(1, 2))]
    nests = {name: [f"{name}.{slot}" for slot in range(rng.choice([1, 1, 2]))] for name in names}
    cell = workcell(
        [*map(module, arms), *map(module, names)],
        [
            station("stack", "stack", 40),
            *(station(nest, claim=len(nests[name]) == 1) for name in names for nest in nests[name]),
            station("trash", "waste", 99),
        ],
    )
    ways = []
    for number in range(rng.randint(3, 5)):
        visits = [rng.choice(names) for _ in range(rng.randint(2, 4))]
        visits = [name for at, name in enumerate(visits) if not at or visits[at - 1] != name]
        places = [rng.choice(nests[name]) for name in visits]
        steps = [step(rng.choice(arms), take("stack", places[0]), duration_s=10.0)]
        for at, (name, place) in enumerate(zip(visits, places, strict=True)):
            onward = places[at + 1] if at + 1 < len(places) else "trash"
            steps.append(step(name, needs(place), duration_s=10.0 * rng.randint(2, 30)))
            steps.append(step(rng.choice(arms), move(place, onward), duration_s=10.0))
        ways.append(plan(*steps, name=f"way {number}"))
    return cell, ways


def play(cell: Workcell, ways: Sequence[Plan], make: Callable[[], Scheduler], jitter: float = 0.0) -> Outcome:
    works = [Work((SubmitRun(way, "ada"),)) for way in ways]
    return Player(cell, STOCK, make, jitter=jitter).play(works)


@pytest.mark.parametrize("seed", range(25))
def test_what_the_model_predicts_is_what_the_kernel_does(seed: int) -> None:
    """Every run comes to its end. No look predicts an end that is much too early (a later look may find a
    better order), and the last one is right."""
    cell, ways = make_cell(random.Random(f"own order/{seed}"))
    told = Told()
    outcome = play(cell, ways, lambda: Scheduler(told))
    assert len(outcome.steps) == sum(len(way.steps) for way in ways)
    began = told.predicted[0][0]
    end = began + outcome.makespan_s * SECOND
    for at, predicted in told.predicted:
        apart = APART * (predicted - began)
        assert end <= predicted + apart, (
            f"at {(at - began) / SECOND:.0f} s, {(end - predicted) / SECOND} s more"
        )
    last = told.predicted[-1][1]
    assert abs(end - last) <= APART * (last - began)


def test_an_order_is_found_that_no_rule_of_the_queue_has() -> None:
    """The short run goes first through the mill, though it is younger, and the long one loses no time."""
    cell = workcell(
        [module("arm"), module("mill"), module("oven")],
        [
            station("stack", "stack", 40),
            station("mill.nest", claim=True),
            station("oven.nest", claim=True),
            station("trash", "waste", 99),
        ],
    )
    ways = [make_way(("mill", 300.0), ("oven", 30.0)), make_way(("mill", 30.0), ("oven", 300.0))]
    together = play(cell, ways, lambda: Scheduler(OwnOrders(before_start=AT_ONCE))).makespan_s
    alone = play(cell, ways[:1], Scheduler).makespan_s
    assert together < alone + 60.0


def make_way(*visits: tuple[str, float]) -> Plan:
    """A plate's way over machines, and how long it is on each."""
    places = [f"{name}.nest" for name, _ in visits]
    steps = [step("arm", take("stack", places[0]), duration_s=10.0)]
    for at, (name, takes) in enumerate(visits):
        steps.append(step(name, needs(places[at]), duration_s=takes))
        onward = places[at + 1] if at + 1 < len(places) else "trash"
        steps.append(step("arm", move(places[at], onward), duration_s=10.0))
    return plan(*steps, name="-".join(name for name, _ in visits))


@pytest.mark.parametrize("seed", range(5))
def test_all_come_to_their_ends_where_durations_scatter(seed: int) -> None:
    cell, ways = make_cell(random.Random(f"own order/{seed}"))
    outcome = play(cell, ways, lambda: Scheduler(OwnOrders(before_start=AT_ONCE)), jitter=0.3)
    assert len(outcome.steps) == sum(len(way.steps) for way in ways)


def test_the_same_lab_has_the_same_order() -> None:
    cell, ways = make_cell(random.Random("own order/3"))
    first, second = (
        play(cell, ways, lambda: Scheduler(OwnOrders(before_start=AT_ONCE))).steps for _ in range(2)
    )
    assert first == second

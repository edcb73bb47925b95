"""Labs in which clocks run, with durations as they are declared; and who could have kept which window.

A seed makes several runs that share arms, devices and nests, with windows that are short or long, one
after the other, side by side, and across the runs of an experiment. The same runs are carried out twice:
by planning, and by a checker that knows nothing of planning and lets one run after the other have
the lab to itself. A window that the checker keeps can be kept, so whoever breaches it could have
done better.
"""

from __future__ import annotations

import random
from collections.abc import Callable, Iterable
from itertools import pairwise

import msgspec

from labos.core.actions import ActionRequested
from labos.core.ids import ExperimentId, RunId
from labos.core.model import Plan, PlanStep, Window
from labos.core.rules import examine
from labos.core.runs import RunState, find_anchor
from labos.core.state import LabState
from labos.core.steps import WindowBreached
from labos.core.waits import Wait
from labos.planning.reservations import Reservations
from labos.planning.scheduler import Scheduler, list_ready_steps
from tests.support.bench import (
    SECOND,
    START,
    Driver,
    module,
    move,
    needs,
    plan,
    sets,
    station,
    step,
    take,
    workcell,
)

Breached = dict[tuple[str, int], bool]
"""Which step of which run was late (by the name of the run and the index of the step)."""

LIMIT = 20_000


class Order(msgspec.Struct):
    """A run that somebody wants after so many seconds, or after the run ``behind`` has ended; ``name``
    tells it from others in both ways of carrying it out."""

    name: str
    plan: Plan
    after_s: float = 0.0
    behind: str = ""


class Told(msgspec.Struct):
    """What became of an instance: how many windows with an end there were, which steps were late, and
    which of them need not have been; how many steps were started and rehearsals played."""

    windows: int
    breached: Breached
    avoidable: Breached
    starts: int
    plays: int


# -- making ----------------------------------------------------------------------------------------


class Instance:
    """What a seed makes: a workcell with one or two arms, a liquid handler with a deck, a heater with a
    nest, a reader with a lid, nests and a hotel; and the orders of one morning."""

    def __init__(self, seed: int) -> None:
        self.rng = rng = random.Random(f"clocked/{seed}")
        self.arms = ["arm", "arm2"][: rng.randint(1, 2)]
        self.lid = rng.random() < 0.5
        self.move_s = rng.choice([5.0, 10.0, 30.0])
        rest = {"lid": "open"} if self.lid else {}
        self.cell = workcell(
            [
                *map(module, self.arms),
                module("dev"),
                module("heat"),
                module("cam", variables=rest, rest=rest),
            ],
            [
                station("stack", "stack", 40),
                station("trash", "waste", 99),
                station("a"),
                station("b"),
                station("hotel", "hotel", 3),
                station("dev.n1", "deck", claim=True),
                station("heat.nest", claim=True),
                station("cam.nest", claim=self.lid, access=rest),
            ],
        )
        self.orders: list[Order] = []
        while len(self.orders) < rng.randint(3, 7):
            self._order(f"r{len(self.orders)}")

    def lab(self) -> Driver:
        lab = Driver(self.cell)
        lab.careful = False
        lab.stock("stack", 40)
        return lab

    def _order(self, name: str) -> None:
        rng = self.rng
        after_s = rng.choice([0.0, rng.uniform(0.0, 900.0)])
        kind = rng.random()
        if kind < 0.2:
            self.orders.append(Order(name, self._picture(), after_s))
        elif kind < 0.35:
            self.orders.append(Order(name, self._branches(), after_s))
        elif kind < 0.45:
            self.orders.append(Order(name, self._dose(), after_s))
            self.orders.append(Order(f"{name}b", self._read_later(), behind=name))
        else:
            self.orders.append(Order(name, self._way(clocked=kind < 0.85), after_s))

    def _duration(self) -> float:
        return self.rng.choice([2.0, 10.0, 60.0, 60.0, 300.0, 900.0])

    def _slack(self) -> float:
        return self.rng.choice([0.0, 1.0, 5.0, 20.0, 60.0, 400.0])

    def _carry(self, source: str, target: str) -> PlanStep:
        return step(self.rng.choice(self.arms), move(source, target), duration_s=self.move_s)

    def _take(self, target: str) -> PlanStep:
        return step(self.rng.choice(self.arms), take("stack", target), duration_s=self.move_s)

    def _work(self, place: str) -> list[PlanStep]:
        on = place.partition(".")[0]
        if place == "cam.nest" and self.lid:
            shut, opened = sets("lid", "shut"), sets("lid", "open")
            return [
                step("cam", shut, duration_s=3.0),
                step("cam", needs(place), duration_s=self._duration()),
                step("cam", opened, duration_s=3.0),
            ]
        return [step(on, needs(place), duration_s=self._duration())] if "." in place else []

    def _picture(self) -> Plan:
        """A long piece of work without labware, or with labware that stays for long."""
        if self.rng.random() < 0.5:
            on = self.rng.choice(["cam", "dev", *self.arms])
            return plan(step(on, duration_s=self.rng.choice([60.0, 300.0, 1200.0])), name="picture")
        return self._way(clocked=False)

    def _way(self, *, clocked: bool) -> Plan:
        """A plate's way over some places, with windows between its steps."""
        rng = self.rng
        places = ["dev.n1", "cam.nest", "heat.nest", "a", "b", "hotel"]
        route = [rng.choice(places)]
        for _ in range(rng.randint(1, 4)):
            route.append(rng.choice([place for place in places if place != route[-1]]))
        steps = [self._take(route[0]), *self._work(route[0])]
        for source, target in pairwise(route):
            steps += [self._carry(source, target), *self._work(target)]
        steps.append(self._carry(route[-1], "trash"))
        for _ in range(rng.randint(1, 4) if clocked else 0):
            self._add_window(steps)
        return plan(*steps, name=f"way {len(self.orders)}")

    def _add_window(self, steps: list[PlanStep]) -> None:
        """A window whose length fits what has to be done meanwhile, now and then not quite."""
        rng = self.rng
        index = rng.randrange(1, len(steps))
        anchor = max(0, index - rng.choice([1, 1, 2, 2, 3]))
        between_s = sum(item.duration_s for item in steps[anchor + 1 : index])
        waits_s = sum(max((w.wait_s for w in s.windows), default=0.0) for s in steps[anchor + 1 : index])
        wait_s = rng.choice([0.0, 0.0, 0.0, 30.0, 400.0])
        least_s = max(wait_s, between_s + waits_s)
        within_s = max(1.0, least_s + self._slack() - (20.0 if rng.random() < 0.03 else 0.0))
        window = Window(anchor, wait_s, max(wait_s, within_s))
        steps[index] = msgspec.structs.replace(steps[index], windows=(*steps[index].windows, window))

    def _branches(self) -> Plan:
        """Two pieces of work side by side after a dose, each within its time."""
        left_s, right_s = self._duration(), self._duration()
        dose = step("dev", key="dose", duration_s=self._duration())
        wait_s = self.rng.choice([0.0, 30.0])
        left = step(
            "cam", key="left", after=(0,), duration_s=left_s, windows=(Window(0, 0.0, self._slack() + 1),)
        )
        right = step(
            "heat",
            key="right",
            after=(0,),
            duration_s=right_s,
            windows=(Window(0, wait_s, wait_s + self._slack()),),
        )
        last = step(
            "dev",
            key="last",
            after=(1, 2),
            duration_s=10.0,
            windows=(Window(2, 0.0, left_s + self._slack()),),
        )
        return plan(dose, left, right, last, parallel=True, name=f"branches {len(self.orders)}")

    def _dose(self) -> Plan:
        dose = step("dev", needs("dev.n1"), key="dose", duration_s=self._duration())
        return plan(self._take("dev.n1"), dose, self._carry("dev.n1", "hotel"), name="dose")

    def _read_later(self) -> Plan:
        """The clock has begun before this run is known: it is given time for what goes on by then."""
        wait_s = self.rng.choice([0.0, 600.0])
        window = Window(None, wait_s, wait_s + 15_000.0, of="dose", of_step="dose")
        over = self._carry("hotel", "cam.nest")
        steps = [msgspec.structs.replace(over, windows=(window,)), *self._work("cam.nest")]
        return plan(*steps, self._carry("cam.nest", "trash"), name="read later")


# -- carrying out ----------------------------------------------------------------------------------


class Life:
    """One way of carrying out an instance's orders; time passes as the plans say, or ``stray`` of it
    more or less."""

    def __init__(self, instance: Instance, stray: float = 0.0, seed: int = 0) -> None:
        self.instance, self.lab = instance, instance.lab()
        self.stray, self.rng = stray, random.Random(seed)
        self.names: dict[RunId, str] = {}
        self.plans: dict[RunId, Plan] = {}
        self._left = list(instance.orders)
        self._experiments: dict[str, ExperimentId] = {}
        self._ends: dict[str, int] = {}

    def submit_due(self) -> None:
        """Submit what is wanted by now."""
        for order in list(self._left):
            experiment = self._experiments.get(order.behind or order.name)
            if order.behind:
                known = order.behind in self.names.values()
                if not known or any(self.names[run] == order.behind for run in self._open()):
                    continue
            elif self.lab.now < START + int(order.after_s * SECOND):
                continue
            elif any(other.behind == order.name for other in self.instance.orders):
                experiment = self._experiments[order.name] = self.lab.experiment()
            self._left.remove(order)
            more = {"experiment": experiment} if experiment else {}
            run = self.lab.submit(order.plan, user=f"u{len(self.names) % 2}", **more)
            self.names[run], self.plans[run] = order.name, order.plan

    def _open(self) -> Iterable[RunId]:
        return [*self.lab.state.runs.active, *self.lab.state.runs.queued]

    def next_time(self, alarm: int | None = None) -> int | None:
        """When an action ends, somebody wants something, or the alarm rings."""
        for action in self.lab.state.actions.open.values():
            if action.id not in self._ends:
                seconds = self.plans[action.run].steps[action.step].duration_s
                seconds *= 1.0 + self.rng.uniform(-self.stray, self.stray)
                self._ends[action.id] = action.requested_at + int(seconds * SECOND)
        times = [self._ends[name] for name in self.lab.list_flying()]
        times += [START + int(o.after_s * SECOND) for o in self._left if not o.behind]
        times += [alarm] if alarm is not None else []
        return min((max(at, self.lab.now) for at in times), default=None)

    def finish_due(self) -> None:
        for name in self.lab.list_flying():
            if self._ends[name] <= self.lab.now:
                self.lab.finish(name)

    def find_breached(self) -> Breached:
        found: Breached = {}
        for entry in self.lab.log:
            if isinstance(entry.event, WindowBreached):
                found[self.names[entry.event.run], entry.event.step] = True
        return found


def careless() -> Scheduler:
    """Planning that leaves no room for anybody; deadlines still decide who goes first."""
    scheduler = Scheduler()
    scheduler.reservations = _Careless(scheduler.safety, {})
    return scheduler


class _Careless(Reservations):
    def check_start(self, state: LabState, run: RunState, step: int, now: int) -> Wait | None:
        return None


def run_planned(
    instance: Instance, stray: float = 0.0, plan_with: Callable[[], Scheduler] = Scheduler
) -> Life:
    """The orders, carried out by planning. Raises AssertionError if the lab comes to rest before its
    orders have."""
    life = Life(instance, stray)
    lab = life.lab
    lab.scheduler = plan_with()
    for _ in range(LIMIT):
        life.finish_due()
        life.submit_due()
        lab.pump()
        at = life.next_time(lab.scheduler.find_next_deadline(lab.state))
        if at is None:
            assert not life.names or not list(life._open()), lab.describe_stuck()
            assert not life._left
            return life
        lab.now = at
    raise AssertionError(f"the lab does not come to rest: {lab.describe_stuck()}")


def one_by_one(instance: Instance) -> Life:
    """The orders, each with the lab to itself: what the rules allow starts at once."""
    life = Life(instance)
    lab = life.lab
    for _ in range(LIMIT):
        life.finish_due()
        life.submit_due()
        runs = [*lab.state.runs.active.values(), *lab.state.runs.queued.values()]
        keys, lab.keys = lab.keys, set()
        lab.scheduler.note_changes(lab.state, keys)
        for command in lab.scheduler.deadlines.iterate_due(lab.state, lab.now):
            lab.do(command)
        waits: list[int] = []
        behind = [run for run in runs if run.experiment]
        for run in [*lab.state.runs.active.values(), *behind, *runs][:1]:
            turn = (
                list_ready_steps(lab.state, run) if run.has_started else lab.state.runs.plans[run.plan].starts
            )
            for index in turn:
                found = examine(lab.state, lab.run(run.id), index, lab.now)
                if not isinstance(found, Wait):
                    lab.start(run.id, index)
                elif found.until is not None:
                    waits.append(found.until)
                late = [
                    ended + int(window.within_s * SECOND) + 1
                    for window in life.plans[run.id].steps[index].windows
                    if window.within_s is not None and (ended := find_anchor(run, window)) is not None
                ]
                waits += [at for at in late if at > lab.now]
        at = life.next_time(min(waits, default=None))
        if at is None:
            assert not runs, lab.describe_stuck()
            return life
        lab.now = at
    raise AssertionError("the lab does not come to rest")


def judge(seed: int, stray: float = 0.0, plan_with: Callable[[], Scheduler] = Scheduler) -> Told:
    """Carry out a seed's instance both ways."""
    instance = Instance(seed)
    windows = sum(
        window.within_s is not None
        for order in instance.orders
        for item in order.plan.steps
        for window in item.windows
    )
    life = run_planned(instance, stray, plan_with)
    breached = life.find_breached()
    alone = one_by_one(instance).find_breached()
    avoidable: Breached = {}
    for name in {run for run, _ in breached}:
        late = [key for key in breached if key[0] == name]
        not_kept = [key for key in alone if key[0] == name]
        late.sort(key=lambda key: key in not_kept)
        avoidable.update(dict.fromkeys(late[: max(0, len(late) - len(not_kept))], True))
    starts = sum(isinstance(entry.event, ActionRequested) for entry in life.lab.log)
    return Told(windows, breached, avoidable, starts, life.lab.scheduler.reservations.windows.plays)

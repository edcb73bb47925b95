"""Random bookings and random runs in virtual time: no start runs into what others have booked, by its
planned duration, and everything comes to its end."""

from __future__ import annotations

import heapq
import random
from collections.abc import Sequence
from typing import NamedTuple

import msgspec
import pytest

from labos.core.actions import ActionRequested
from labos.core.bookings import BookingMade
from labos.core.decide import Command, Rejection
from labos.core.decide.bookings import CancelBooking, ChangeBooking, MakeBooking, NewTerms
from labos.core.decide.shares import ApplyShares
from labos.core.envelope import Record
from labos.core.ids import ActionId, local
from labos.core.model import Plan, Workcell
from labos.core.registry import decode
from labos.core.runs import RunSubmitted
from labos.core.shares import Group, Member
from labos.core.state import hash_state
from labos.testing.faults import QUIET, STORMY, FaultRates
from labos.testing.lab import SimulatedLab
from labos.testing.stand import Meddle
from tests.simulation.invariants import fold_again
from tests.simulation.mixes import mix, pcr, stand
from tests.support.bench import SECOND, Driver, move, plan, sets, small_cell, step, take, workcell

pytestmark = pytest.mark.timeout(300)
"""These tests compute for half a minute; on a busy computer they take several times as long."""

MINUTE, DAY = 60 * SECOND, 86_400 * SECOND
GROUPS = {"ada": "chemistry", "bo": "chemistry", "cy": "", "di": ""}
MODULES = ("dev", "cam", "arm", "arm2")


class Booked(NamedTuple):
    """What was booked, as the test keeps it: ``every`` is how often it comes again (ns; 0: once)."""

    place: str
    begins: int
    ends: int
    whom: str
    every: int
    made: int

    def covers(self, module: str) -> bool:
        return self.place in (module, "cell")

    def is_for(self, user: str) -> bool:
        return self.whom in (f"user:{user}", f"group:{GROUPS[user]}")

    def overlaps(self, begins: int, ends: int) -> bool:
        if not self.every:
            return self.begins < ends and self.ends > begins
        first = max(0, (begins - self.ends) // self.every)
        times = ((self.begins + n * self.every, self.ends + n * self.every) for n in range(first, first + 4))
        return any(a < ends and b > begins for a, b in times)


def roomy() -> Workcell:
    """The small cell with plates and waste for a whole day."""
    known = small_cell()
    more = {"cell/stack": 500, "cell/trash": 500}
    stations = [
        msgspec.structs.replace(spec, capacity=more.get(spec.name, spec.capacity)) for spec in known.stations
    ]
    return workcell(known.modules, stations)


class Day(Driver):
    """A lab in which people book and submit, and actions take more or less as long as they should."""

    careful = False

    def __init__(self, seed: int) -> None:
        super().__init__(roomy())
        self.rng = random.Random(seed)
        self.stock("stack", 200)
        members = {user: Member() for user, group in GROUPS.items() if group}
        self.do(ApplyShares("d", (Group("chemistry", 1.0, members),)))
        self.booked: dict[str, Booked] = {}
        self.ends: list[tuple[int, ActionId]] = []
        self.started = self.held = 0
        self._seen = len(self.log)

    def book(self) -> None:
        rng = self.rng
        whom = rng.choice(["user:ada", "user:cy", "user:di", "group:chemistry", "maintenance"])
        kind, _, name = whom.partition(":")
        begins = self.now + rng.randrange(-10, 600) * MINUTE
        daily = rng.random() < 0.25
        ends = begins + rng.randrange(5, 240) * MINUTE
        what = NewTerms(
            begins=begins,
            ends=ends,
            user=name if kind == "user" else "",
            group=name if kind == "group" else "",
            maintenance=kind == "maintenance",
            rule="FREQ=DAILY" if daily else "",
        )
        place = rng.choice([*MODULES, "cell"])
        target = place if place == "cell" else f"cell/{place}"
        answer = self.ask(MakeBooking(target, what, "op", self.now, rng.random() < 0.3))
        if isinstance(answer, Rejection):
            assert answer.code in ("booked", "past"), answer
            return
        name = f"B{self.state.bookings.named}"
        self.booked[name] = Booked(place, begins, ends, whom, DAY if daily else 0, self.state.bookings.made)

    def rebook(self) -> None:
        """Give a booking back, or move it."""
        if not self.state.bookings.open:
            return
        name = self.rng.choice(list(self.state.bookings.open))
        known = self.state.bookings.open[name]
        if self.rng.random() < 0.5 or known.rule:
            self.do(CancelBooking(name, "op"))
            del self.booked[name]
            return
        begins = self.now + self.rng.randrange(0, 300) * MINUTE
        what = NewTerms(
            begins=begins,
            ends=begins + 30 * MINUTE,
            user=known.user,
            group=known.group,
            maintenance=known.maintenance,
        )
        if isinstance(self.ask(ChangeBooking(name, what, "op", self.now)), list):
            before = self.booked[name]
            self.booked[name] = before._replace(begins=begins, ends=what.ends, made=self.state.bookings.made)

    def plan_of(self) -> Plan:
        rng = self.rng
        takes_s = rng.randrange(1, 40) * 60.0
        arm = rng.choice(["arm", "arm2"])
        slot = rng.choice(["dev.n1", "dev.n2"])
        match rng.randrange(5):
            case 0:
                return plan(step(rng.choice(["cam", "dev"]), duration_s=takes_s))
            case 1:
                return plan(
                    step(arm, take("stack", slot), duration_s=60.0),
                    step("dev", sets("lid", "closed"), duration_s=30.0),
                    step("dev", duration_s=takes_s),
                    step("dev", sets("lid", "open"), duration_s=30.0),
                    step(arm, move(slot, "trash"), duration_s=60.0),
                )
            case 2:
                return plan(
                    step(arm, take("stack", slot), duration_s=60.0),
                    step("dev", duration_s=takes_s),
                    step(arm, move(slot, "cam.nest"), duration_s=60.0),
                    step("cam", duration_s=600.0),
                    step("arm", move("cam.nest", "trash"), duration_s=60.0),
                )
            case 3:
                return plan(
                    step("arm", take("stack", "a"), duration_s=60.0),
                    step("arm2", move("a", "b"), duration_s=60.0),
                    step("arm", move("b", "trash"), duration_s=60.0),
                )
            case _:
                return plan(step(arm, duration_s=takes_s), step("cam", duration_s=takes_s))

    def turn(self) -> None:
        """What the kernel does; each start is held against what is booked."""
        self.pump()
        for entry in self.log[self._seen :]:
            if entry.event.TYPE == "action.requested":
                self._look_at(entry.event.run, entry.event.step)  # type: ignore[attr-defined]
                run = self.state.runs.active[entry.event.run]  # type: ignore[attr-defined]
                nominal = self.state.runs.plan_of(run).steps[entry.event.step].duration_s  # type: ignore[attr-defined]
                takes = int(nominal * SECOND * self.rng.choice([0.5, 1.0, 1.0, 1.0, 3.0]))
                heapq.heappush(self.ends, (self.now + takes, entry.event.action))  # type: ignore[attr-defined]
        self._seen = len(self.log)
        assert not self.find_missed()

    def _look_at(self, name: str, index: int) -> None:
        run = self.state.runs.active[name]  # type: ignore[index]
        at = self.state.runs.plan_of(run).steps[index]
        ends = self.now + int(at.duration_s * SECOND)
        self.started += 1
        emptied = {local(e.source) for e in at.effects if e.__class__.__name__ in ("Move", "Take")}  # type: ignore[union-attr]
        filled = {local(e.target) for e in at.effects if e.__class__.__name__ in ("Move", "Take")}  # type: ignore[union-attr]
        reached = {place.partition(".")[0]: place in emptied for place in filled | emptied if "." in place}
        for module, clears in {**reached, local(at.module): False}.items():
            own = [b for b in self.booked.values() if b.covers(module) and b.is_for(run.user)]
            for booked in self.booked.values():
                if not booked.covers(module) or booked.is_for(run.user):
                    continue
                if clears and booked.whom != "maintenance":
                    continue
                if any(mine.made > booked.made for mine in own) and booked.whom != "maintenance":
                    continue  # an admin has booked over it
                assert not booked.overlaps(self.now, ends), f"{name}#{index} on {module} runs into {booked}"

    def go_on(self) -> bool:
        """To the next end of an action, or the next time that somebody waits for; False if there is none."""
        times = [self.ends[0][0]] if self.ends else []
        deadline = self.scheduler.find_next_deadline(self.state)
        times += [deadline] if deadline is not None else []
        if not times:
            return False
        self.now = max(self.now, min(times))
        while self.ends and self.ends[0][0] <= self.now:
            self.finish(heapq.heappop(self.ends)[1])
        return True


def live_through(seed: int, runs: int) -> Day:
    day = Day(seed)
    left = runs
    while left or day.state.runs.active or day.state.runs.queued:
        if left and day.rng.random() < 0.4:
            day.submit(day.plan_of(), user=day.rng.choice(list(GROUPS)))
            left -= 1
        if left and day.rng.random() < 0.2:
            day.book()
        if left and day.rng.random() < 0.05:
            day.rebook()
        if not left:  # what is booked again and again may leave no gap: it is given back in the end
            for name in [name for name, b in day.state.bookings.open.items() if b.rule]:
                day.do(CancelBooking(name, "op"))
                del day.booked[name]
        day.turn()
        if not day.go_on() and not left:
            raise AssertionError(f"seed {seed} hangs: {day.describe_stuck()}")
        day.turn()
    return day


@pytest.mark.parametrize(
    "seeds",
    [
        pytest.param((*range(6), 69, 192, 488), id="few"),
        pytest.param(range(6, 60), marks=pytest.mark.slow, id="many"),
        pytest.param(range(60, 1000), marks=[pytest.mark.full, pytest.mark.timeout(900)], id="all"),
    ],
)
def test_nothing_runs_into_a_booking_and_everything_ends(seeds: Sequence[int]) -> None:
    begun = 0
    for seed in seeds:
        day = live_through(seed, 25)
        begun += day.types().count("booking.began")
        day.check_log()
    assert begun > len(seeds), "bookings made no difference"


# -- whole labs ------------------------------------------------------------------------------------


class Intent(NamedTuple):
    """A booking that somebody makes: on what, from when to when (s from then), for whom."""

    target: str
    begins_s: float
    ends_s: float
    user: str


def plan_bookings(seed: int) -> list[Intent]:
    """Bookings one after the other, so that none is refused for another."""
    rng = random.Random(f"bookings/{seed}")
    names = [spec.name for spec in stand().workcell.modules]
    found, time = [], 60.0
    for _ in range(6):
        begins = time + rng.uniform(0, 1800)
        time = begins + rng.uniform(600, 3600)
        target = rng.choice([*names, stand().workcell.name])
        found.append(Intent(target, begins, time, rng.choice(["ada", "bo", ""])))
    return found


def run_with_bookings(seed: int, rates: FaultRates) -> int:
    """A mix of jobs while bookings come and go; how many began."""
    lab = SimulatedLab(stand(), seed, rates, meddles=[Meddle("j0/0", 0, lambda run: deeds())])

    def deeds() -> list[tuple[float, Command | str]]:
        assert lab.kernel is not None
        now = lab.kernel.clock.now_ns()
        return [
            (
                0.0,
                MakeBooking(
                    intent.target,
                    NewTerms(
                        begins=now + int(intent.begins_s * SECOND),
                        ends=now + int(intent.ends_s * SECOND),
                        user=intent.user,
                        maintenance=not intent.user,
                    ),
                    "op",
                    now,
                    True,
                ),
            )
            for intent in plan_bookings(seed)
        ]

    try:
        state = lab.run([pcr("j0", "ada"), *mix(seed, largest=4)[1:]], limit_s=5 * 86_400.0)
        assert lab.differences(state) == [], f"seed {seed}"
        assert hash_state(fold_again(lab.store.records)) == hash_state(state)
        return _check_against_log(lab.store.records)
    finally:
        lab.close()


def _check_against_log(records: Sequence[Record]) -> int:
    """Nothing was asked of a module while it was somebody else's; how many bookings began."""
    booked: dict[str, BookingMade] = {}
    users: dict[str, str] = {}
    begun = 0
    for record in records:
        event, at = decode(record.head.type, record.head.schema, record.payload), record.head.recorded_at
        if isinstance(event, BookingMade):
            booked[event.booking] = event
        elif isinstance(event, RunSubmitted):
            users[event.run] = event.user
        elif isinstance(event, ActionRequested) and event.attempt == 1 and event.exclusive:
            for other in booked.values():
                theirs = other.maintenance or other.user != users[event.run]
                here = other.target in (event.module, event.module.partition("/")[0])
                meets = other.begins <= at < other.ends
                assert not (theirs and here and meets) or event.name == "reset", (event, other)
        begun += record.head.type == "booking.began"
    return begun


@pytest.mark.slow
def test_whole_labs_with_bookings_lose_nothing_and_end() -> None:
    assert run_with_bookings(1, QUIET) > 0
    assert run_with_bookings(2, STORMY) > 0


@pytest.mark.full
@pytest.mark.parametrize("seed", range(3, 30))
def test_many_storms_with_bookings(seed: int) -> None:
    run_with_bookings(seed, STORMY)

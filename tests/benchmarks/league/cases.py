"""What is played in the league: families of cases, each made from its name and seed alone."""

from __future__ import annotations

import random
from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import pairwise

import msgspec
from msgspec.structs import replace

from labos.core.decide.experiments import StartExperiment
from labos.core.decide.runs import SubmitRun
from labos.core.effects import Move
from labos.core.ids import StationName
from labos.core.model import Plan, PlanStep, Window, Workcell
from tests.benchmarks.league import slab
from tests.benchmarks.league.play import Work
from tests.simulation.mixes import CELL, PLANS, stand
from tests.support.bench import full, module, move, needs, plan, station, step, take, workcell

RPL_STOCK = {name: (kind, count) for name, kind, count in stand().stock}
SEEDS = 3


class Case(msgspec.Struct, frozen=True):
    """Work for one workcell. ``best`` names the case whose best known schedule is also this one's: in which
    order the runs were submitted makes no difference to it. ``published_s`` is the shortest makespan that
    others have published (0: none). The last ``rest_s`` of a schedule do not count as work."""

    name: str
    family: str
    cell: Workcell
    stock: Mapping[StationName, tuple[str, int]]
    works: tuple[Work, ...]
    best: str = ""
    published_s: float = 0.0
    rest_s: float = 0.0

    @property
    def key(self) -> str:
        return self.best or self.name


def cases(*, quick: bool = False) -> Iterator[Case]:
    """All of them, or one small case of each family."""
    for family in (_mixes, _pcrs, _two_cyclers, _one_arm, _clocks, _job_shop, _slab):
        made = family()
        yield from ([next(made)] if quick else made)


# -- mixes of PCR and colour picker ------------------------------------------------------------------


def _pcr(cycle_s: float = 600.0, mix_s: float = 600.0) -> SubmitRun:
    return with_durations(PLANS["pcr"], {"Cycle": cycle_s, "Mix reactions": mix_s})


def with_durations(run: SubmitRun, seconds: Mapping[str, float]) -> SubmitRun:
    """The same run, with other durations of the steps of these keys."""
    return _with_steps(run, lambda s: replace(s, duration_s=seconds.get(s.key, s.duration_s)))


def _with_steps(run: SubmitRun, change: Callable[[PlanStep], PlanStep]) -> SubmitRun:
    return replace(run, plan=replace(run.plan, steps=tuple(map(change, run.plan.steps))))


def _picker(mixes: int, *, experiment: bool = True) -> Work:
    names = ["cp_newplate", *["cp_mixcolor"] * mixes, "cp_trashplate"]
    start = StartExperiment("colour picker", "bo", PLANS["cp_trashplate"].plan) if experiment else None
    return Work(tuple(PLANS[name] for name in names), start)


def _mixes() -> Iterator[Case]:
    for pcrs, pickers, mixes in ((2, 1, 3), (4, 1, 5), (8, 2, 5)):
        name = f"{pcrs} PCR + {pickers} picker × {mixes}"
        first = [Work((_pcr(),))] * pcrs
        then = [_picker(mixes)] * pickers
        yield _rpl(name, "mixes", [*first, *then])
        yield _rpl(f"{name}, pickers first", "mixes", [*then, *first], name)
        alone = [_picker(mixes, experiment=False)] * pickers
        yield _rpl(f"{name}, no experiment", "mixes", [*first, *alone], name)
        for seed in range(SEEDS):
            works = [*first, *then]
            random.Random(f"mix/{seed}").shuffle(works)
            yield _rpl(f"{name}, shuffled {seed}", "mixes", works, name)


def _rpl(name: str, family: str, works: Sequence[Work], best: str = "") -> Case:
    return Case(name, family, CELL.workcell, RPL_STOCK, tuple(works), best)


def _pcrs() -> Iterator[Case]:
    for count in (1, 2, 4, 8, 16):
        works = [Work((_to_waste(PLANS["pcr"]),))] * count
        yield _rpl(f"{count} PCR", "PCR alone", works)


def _to_waste(run: SubmitRun) -> SubmitRun:
    """The same run, whose plate does not go to the output, where 14 have room, but is thrown away."""

    def change(found: PlanStep) -> PlanStep:
        if found.key != "Move to output":
            return found
        moves = tuple(
            replace(e, target=StationName("rpl/wc.trash")) if isinstance(e, Move) else e
            for e in found.effects
        )
        return replace(found, effects=moves)

    return _with_steps(run, change)


def _two_cyclers() -> Iterator[Case]:
    for seed in range(SEEDS):
        works = two_cyclers(seed, share=True)
        yield _rpl(f"8 unlike PCR on two cyclers, seed {seed}", "two cyclers", works)


def two_cyclers(seed: int, *, share: bool) -> list[Work]:
    """Eight PCR of different lengths; every second one on the other cycler, or each on either of them."""
    rng = random.Random(f"two cyclers/{seed}")
    works = []
    for number in range(8):
        run = _pcr(rng.choice([1800.0, 3600.0, 5400.0, 7200.0]), rng.choice([300.0, 600.0, 1200.0, 2400.0]))
        other = _on_other_cycler(run.plan)
        if not share:
            run = replace(run, others=(other,))
        elif number % 2:
            run = replace(run, plan=other)
        works.append(Work((run,)))
    return works


def _on_other_cycler(found: Plan) -> Plan:
    text = msgspec.json.encode(found).decode()
    return msgspec.json.decode(text.replace("rpl/biometra", "rpl/biometra_192"), type=Plan)


# -- workcells of our own --------------------------------------------------------------------------


def _within(found: PlanStep, anchor: int, within_s: float) -> PlanStep:
    return replace(found, windows=(Window(anchor, 0.0, within_s),))


def _one_arm() -> Iterator[Case]:
    """Every plate is dosed and has to be read within two minutes; the one arm goes everywhere."""
    cell = workcell(
        [module("arm"), module("dose"), module("read")],
        [
            station("stack", "stack", 40),
            station("dose.nest", claim=True),
            station("read.nest", claim=True),
            station("trash", "waste", 99),
        ],
    )
    for count in (8, 32):
        steps = (
            step("arm", take("stack", "dose.nest"), duration_s=30.0),
            step("dose", needs("dose.nest"), duration_s=180.0),
            step("arm", move("dose.nest", "read.nest"), duration_s=30.0),
            _within(step("read", needs("read.nest"), duration_s=240.0), 1, 120.0),
            step("arm", move("read.nest", "trash"), duration_s=30.0),
        )
        works = (Work((SubmitRun(plan(*steps, name="dose and read"), "ada"),)),) * count
        yield Case(f"one arm, {count} plates, within 120 s", "one arm", cell, _stack(40), works)


def _stack(count: int) -> dict[StationName, tuple[str, int]]:
    return {StationName(full("stack")): ("plate", count)}


def _machines(count: int, arms: int, stock: int) -> Workcell:
    names = [f"m{number}" for number in range(count)]
    return workcell(
        [*(module(f"arm{number}") for number in range(arms)), *map(module, names)],
        [
            station("stack", "stack", stock),
            *(station(f"{name}.nest", claim=True) for name in names),
            station("trash", "waste", 99),
        ],
    )


def _way(machines: Sequence[int], seconds: Sequence[float], arm: Callable[[], str], move_s: float) -> Plan:
    """A plate's way from the stack over machines into the waste."""
    places = [f"m{number}.nest" for number in machines]
    steps = [step(arm(), take("stack", places[0]), duration_s=move_s)]
    for place, after, takes in zip(places, [*places[1:], "trash"], seconds, strict=True):
        steps.append(step(place.partition(".")[0], needs(place), duration_s=takes))
        steps.append(step(arm(), move(place, after), duration_s=move_s))
    return plan(*steps, name="way " + "-".join(map(str, machines)))


def _clocks() -> Iterator[Case]:
    """Plates go over four of five machines: from each to the next within a time."""
    for seed, count in ((0, 16), (0, 64), (1, 64)):
        rng = random.Random(f"clocks/{seed}")
        works = []
        for _ in range(count):
            machines = rng.sample(range(5), 4)
            seconds = [rng.choice([30.0, 60.0, 120.0, 240.0]) for _ in machines]
            way = _way(machines, seconds, lambda rng=rng: f"arm{rng.randrange(2)}", 15.0)  # type: ignore[misc]
            steps = list(way.steps)
            for before, after in pairwise(range(1, 8, 2)):
                steps[after] = _within(steps[after], before, 15.0 + rng.choice([0.0, 30.0, 60.0, 120.0]))
            works.append(Work((SubmitRun(replace(way, steps=tuple(steps)), "ada"),)))
        name = f"{count * 3} windows in chains of three, seed {seed}"
        yield Case(name, "windows", _machines(5, 2, 99), _stack(99), tuple(works))


def _job_shop() -> Iterator[Case]:
    """Every plate has to be on every machine, in its own order; where the next is in use, it stays."""
    for jobs, machines in ((4, 4), (6, 4), (6, 5), (8, 5)):
        for seed in range(SEEDS):
            rng = random.Random(f"job shop/{jobs}/{machines}/{seed}")
            works = []
            for _ in range(jobs):
                order = rng.sample(range(machines), machines)
                seconds = [float(10 * rng.randint(3, 40)) for _ in order]
                works.append(Work((SubmitRun(_way(order, seconds, lambda: "arm0", 10.0), "ada"),)))
            name = f"{jobs} jobs on {machines} machines, seed {seed}"
            yield Case(name, "job shop", _machines(machines, 1, 40), _stack(40), tuple(works))


def _slab() -> Iterator[Case]:
    """What others have published, for comparison."""
    for found in slab.INSTANCES:
        yield Case(
            found.name,
            "S-LAB",
            slab.cell_of(found),
            slab.stock(),
            slab.works_of(found),
            published_s=found.published * slab.MINUTE_S,
            rest_s=slab.MINUTE_S,
        )


__all__ = ["Case", "cases", "two_cyclers", "with_durations"]

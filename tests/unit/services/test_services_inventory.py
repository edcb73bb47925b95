"""What is left, and which run would be the first to find too little."""

from __future__ import annotations

from labos.core.decide.stock import LoadStation, Replenish, UnloadStation
from labos.core.ids import ModuleName, StationName
from labos.core.resources import LevelSet
from labos.services.inventory import Contents, LotLeft, count_inventory, list_shortfalls
from tests.support.bench import SECOND, Driver, consumes, full, plan, route, small, step

DEV = ModuleName(full("dev"))
STACK = StationName(full("stack"))
TODAY = "2026-06-01"


def make_sealing(lab: Driver, seconds: float = 10.0, **more: object) -> str:
    return lab.submit(plan(step("dev", consumes("foil", 2), duration_s=seconds), name="seal"), **more)


def make_with_foil(level: float) -> Driver:
    lab = small()
    lab.set_level(LevelSet(DEV, "foil", level, 100, "old"))
    return lab


def test_the_run_that_finds_too_little_is_named_with_its_time() -> None:
    lab = make_with_foil(5)
    runs = [make_sealing(lab) for _ in range(4)]
    found = count_inventory(lab.state, lab.now, TODAY)
    (foil,) = [left for left in found.resources if left.resource == "foil"]
    assert (foil.level, foil.promised) == (5, 8)
    assert foil.runs_out is not None
    assert (foil.runs_out.run, foil.runs_out.step) == (runs[2], "s0")
    assert foil.runs_out.at == lab.now + 20 * SECOND, "two others go first on the same device"
    assert found.runs_looked_at == 4
    assert [name for name, _ in list_shortfalls(found)] == [f"{DEV}:foil"]


def test_who_has_priority_uses_it_first() -> None:
    lab = make_with_foil(3)
    last, first = make_sealing(lab), make_sealing(lab, priority=5)
    assert first != last
    out = next(
        left.runs_out for left in count_inventory(lab.state, lab.now, TODAY).resources if left.runs_out
    )
    assert out.run == last


def test_what_is_done_is_not_counted_again() -> None:
    lab = make_with_foil(4)
    run = lab.submit(plan(*[step("dev", consumes("foil", 2))] * 2))
    lab.step(run)
    (foil,) = [
        left for left in count_inventory(lab.state, lab.now, TODAY).resources if left.resource == "foil"
    ]
    assert (foil.level, foil.promised, foil.runs_out) == (2, 2, None)


def test_lots_and_their_days() -> None:
    lab = make_with_foil(3)
    lab.do(Replenish(DEV, "foil", 5, "new", "2026-05-31"))
    (foil,) = [
        left for left in count_inventory(lab.state, lab.now, TODAY).resources if left.resource == "foil"
    ]
    assert foil.lots == (LotLeft("old", 3), LotLeft("new", 5, "2026-05-31", expired=True))


def test_stacks_by_type_and_lot_and_who_finds_them_empty() -> None:
    lab = small()
    lab.do(UnloadStation(STACK, "ada"))
    lab.do(LoadStation(STACK, "plate", 2, "L1"))
    lab.do(LoadStation(STACK, "plate", 1, "L2"))
    runs = [lab.submit(route("stack", "a", "trash")) for _ in range(4)]
    (stack,) = count_inventory(lab.state, lab.now, TODAY).stacks
    assert stack.contents == (Contents("plate", "L2", 1), Contents("plate", "L1", 2))
    assert (stack.count, stack.promised, stack.known) == (3, 4, True)
    assert stack.runs_out is not None
    assert stack.runs_out.run == runs[3]

"""Creating a lab, applying workcells, saying what stands where."""

from __future__ import annotations

import msgspec
import pytest

from labos.core.decide.lab import ApplyWorkcell, CreateLab, DeclareStation, StartKernel
from labos.core.ids import LabId
from labos.core.modules import VariableSet
from labos.core.resources import LevelSet, Lot
from tests.support.bench import (
    Driver,
    Workcell,
    module,
    move,
    needs,
    plan,
    route,
    small,
    small_cell,
    station,
    step,
    workcell,
)


def without(cell: Workcell, *names: str) -> Workcell:
    """The cell as a new file describes it, with some of its parts gone."""
    return workcell(
        [m for m in cell.modules if m.name.rpartition("/")[2] not in names],
        [s for s in cell.stations if s.name.rpartition("/")[2] not in names],
    )


def test_a_log_belongs_to_one_lab_and_epochs_only_rise() -> None:
    lab = Driver(small_cell(), pace=3.0)
    assert (lab.state.lab.id, lab.state.lab.name, lab.state.lab.pace) == ("lab-1", "test lab", 3.0)
    assert lab.reject(CreateLab(LabId("other"), "other")).code == "lab_exists"
    assert lab.reject(StartKernel(1, "0")).code == "old_epoch"
    lab.do(StartKernel(5, "0"))
    assert lab.state.lab.epoch == 5
    assert lab.reject(StartKernel(4, "0")).code == "old_epoch"


def test_a_workcell_is_applied_once_in_portions() -> None:
    cell = workcell([module("dev", levels={"tips": 8.0})], [station(f"n{i}") for i in range(95)])
    lab = Driver(cell, empty=False)
    assert lab.types().count("workcell.stations_applied") == 3
    assert len(lab.state.bench.stations) == 95
    assert lab.state.resources.find_left("cell/dev", "tips") == 8.0  # type: ignore[arg-type]
    assert lab.do(ApplyWorkcell(cell)) == []


def test_a_new_description_adds_changes_and_removes() -> None:
    lab = small()
    lab.stock("a", 1)
    lab.set_level(LevelSet("cell/dev", "tips", 3.0, 10.0))  # type: ignore[arg-type]
    lab.write(VariableSet("cell/dev", "lid", "closed"))  # type: ignore[arg-type]
    cell = small_cell()
    dev = msgspec.structs.replace(cell.modules[2], variables={"lid": "open", "lamp": "off"})
    changed = workcell(
        [*cell.modules[:2], dev, module("new")],
        [*(s for s in cell.stations if not s.name.startswith("cell/cam")), station("new.nest")],
    )
    lab.do(ApplyWorkcell(changed))
    state = lab.state
    assert "cell/cam" not in state.modules.by_name
    assert "cell/cam.nest" not in state.bench.stations
    assert "cell/cam" not in state.bench.by_module
    assert state.modules.by_name["cell/dev"].values == {"lid": "closed", "lamp": "off"}  # type: ignore[index]
    assert state.resources.find_left("cell/dev", "tips") == 3.0  # type: ignore[arg-type]
    assert state.bench.by_module["cell/new"] == ["cell/new.nest"]  # type: ignore[index]
    assert lab.at("a") == ["P1"]
    lab.check_log()


def test_a_station_may_get_another_module() -> None:
    lab = Driver(workcell([module("x"), module("y")], [station("x.n")]))
    moved = msgspec.structs.replace(station("x.n"), module="cell/y")
    lab.do(ApplyWorkcell(workcell([module("x"), module("y")], [moved])))
    assert lab.state.bench.by_module == {"cell/x": [], "cell/y": ["cell/x.n"]}


def test_what_labware_or_runs_depend_on_is_not_removed() -> None:
    lab = small()
    run = lab.submit(plan(step("cam"), step("arm", move("a", "b"))))
    action = lab.start(run)
    assert lab.reject(ApplyWorkcell(without(small_cell(), "cam", "cam.nest"))).code == "module_in_use"
    lab.finish(action)
    assert lab.reject(ApplyWorkcell(without(small_cell(), "b"))).code == "plan_in_use"
    assert "needs arm" in lab.reject(ApplyWorkcell(without(small_cell(), "arm"))).message
    lab.stock("c", 1)
    refusal = lab.reject(ApplyWorkcell(without(small_cell(), "c")))
    assert (refusal.code, refusal.remedy) == ("station_occupied", "Move the labware away first.")
    assert "P1" in refusal.message


def test_a_station_with_uncertain_labware_is_not_removed() -> None:
    lab = small()
    lab.stock("a", 1)
    run = lab.submit(route("a", "b"))
    lab.fail(lab.start(run))
    assert lab.reject(ApplyWorkcell(without(small_cell(), "b"))).code == "uncertain"


def test_a_capacity_below_what_stands_there_is_refused() -> None:
    lab = small()
    cell = small_cell()
    stations = [station("stack", "stack", 4) if s.name == "cell/stack" else s for s in cell.stations]
    refusal = lab.reject(ApplyWorkcell(workcell(cell.modules, stations)))
    assert refusal.code == "station_occupied"
    assert "holds 5, more than the 4" in refusal.message


def test_a_workcell_that_cannot_be_recorded_is_refused() -> None:
    cell = workcell([module("dev", config={"table": "x" * 70_000})], [])
    lab = Driver(workcell([module("arm")], []))
    assert lab.reject(ApplyWorkcell(cell)).code == "unfit"


def test_an_undeclared_station_is_unknown_not_empty() -> None:
    lab = Driver(small_cell(), empty=False)
    assert not lab.state.bench.stations["cell/a"].known  # type: ignore[index]
    lab.do(DeclareStation("cell/a"))  # type: ignore[arg-type]
    assert lab.state.bench.stations["cell/a"].known  # type: ignore[index]


def test_declaring_gives_names_to_labware_but_not_to_a_stack() -> None:
    lab = small(stock=3)
    assert lab.state.bench.stations["cell/stack"].stock == ["plate"] * 3  # type: ignore[index]
    lab.do(DeclareStation("cell/hotel", ("plate", "lid")))  # type: ignore[arg-type]
    assert lab.at("hotel") == ["P1", "P2"]
    assert lab.state.bench.labware["P2"].type == "lid"  # type: ignore[index]
    assert lab.owner("P1") == "shared"
    lab.stock("stack", 9)
    assert lab.state.bench.stations["cell/stack"].count == 9  # type: ignore[index]


@pytest.mark.parametrize(
    ("place", "contents", "code"),
    [
        ("nowhere", (), "no_station"),
        ("stack", ("plate",) * 10, "too_many"),
        ("a", ("plate", "plate"), "too_many"),
        ("cam.nest", ("lid",), "not_accepted"),
    ],
)
def test_declarations_that_cannot_be(place: str, contents: tuple[str, ...], code: str) -> None:
    refusal = small().reject(DeclareStation(f"cell/{place}", contents))  # type: ignore[arg-type]
    assert refusal.code == code


def test_what_is_known_or_under_way_is_not_overwritten() -> None:
    lab = small()
    lab.stock("a", 1)
    assert lab.reject(DeclareStation("cell/a")).code == "station_occupied"  # type: ignore[arg-type]
    run = lab.submit(route("stack", "b"))
    action = lab.start(run)
    refusal = lab.reject(DeclareStation("cell/b"))  # type: ignore[arg-type]
    assert "an arrival under way" in refusal.message
    assert lab.reject(DeclareStation("cell/stack")).code == "uncertain"  # type: ignore[arg-type]
    lab.finish(action)
    lab.stock("stack", 2)


def test_where_something_may_stand_nothing_is_declared() -> None:
    """Else the answer ``it is back`` would overfill the station, and no answer could be given."""
    lab = small()
    lab.stock("a", 1)
    run = lab.submit(route("a", "b"))
    lab.doubt(lab.start(run))
    assert lab.reject(DeclareStation("cell/a", ("plate",))).code == "uncertain"  # type: ignore[arg-type]
    lab.answer(lab.question(), "not_done")
    assert lab.at("a") == ["P1"]


def test_a_waste_is_emptied_by_declaring_it() -> None:
    lab = small()
    for _ in range(4):
        run = lab.submit(route("stack", "a", "trash"))
        lab.step(run)
        lab.step(run, 1)
    run = lab.submit(route("stack", "a", "trash"))
    lab.step(run)
    assert lab.code(run, 1) == "waste_full"
    lab.do(DeclareStation("cell/trash", ("plate",)))  # type: ignore[arg-type]
    assert lab.state.bench.stations["cell/trash"].count == 1  # type: ignore[index]
    lab.step(run, 1)
    assert lab.state.bench.stations["cell/trash"].level == 2  # type: ignore[index]
    assert lab.state.bench.labware == {}


def test_levels_have_bounds_and_a_module() -> None:
    lab = small()
    lab.set_level(LevelSet("cell/dev", "tips", 5.0, 8.0, "lot 7"))  # type: ignore[arg-type]
    assert lab.state.resources.levels["cell/dev:tips"].lots == [Lot("lot 7", 5.0)]


def test_needs_of_a_plan_count_as_dependence_too() -> None:
    lab = small()
    lab.submit(plan(step("dev", needs("cam.nest"))))
    assert lab.reject(ApplyWorkcell(without(small_cell(), "cam", "cam.nest"))).code == "plan_in_use"

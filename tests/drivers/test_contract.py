"""What every driver must keep, whatever the instrument."""

from __future__ import annotations

import asyncio
import importlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgspec
import pytest

import labos_drivers
from labos.clock import SystemClock, Uuid7Ids
from labos.core.effects import AnyEffect, Consumes, Move, Needs, Requires, Sets, Take, is_reported, resolve
from labos.core.ids import StationName
from labos.core.model import ActionSpec, Description
from labos.node import DeviceError, Node, Setup, World
from labos.node.journal import Journal
from labos.node.journal_file import FileJournalFile
from labos.node.server import NodeServer
from labos.spec.amounts import list_arguments
from labos.spec.describing import list_places, load_description
from labos.torture import find_declaration
from labos.torture.cases import cases_of, list_wrong_args
from tests.integration.node.bench import LAB, bench
from tests.integration.node.bench import Bench as Lab
from tests.integration.ports import free_endpoint

DRIVERS = {
    "a4s_sealer": "A4sSealer",
    "axis": "Axis",
    "barty": "Barty",
    "biometra": "Biometra",
    "brooks_peeler": "BrooksPeeler",
    "camera": "Camera",
    "chemspeed": "Chemspeed",
    "hidex": "Hidex",
    "inheco": "Inheco",
    "liconic": "Liconic",
    "mir": "MiR",
    "operator": "Operator",
    "ot2": "OT2",
    "pf400": "PF400",
    "pipette": "Pipette",
    "platecrane": "PlateCrane",
    "plc": "Plc",
    "sciclops": "Sciclops",
    "solo": "Solo",
    "tecan": "Tecan",
    "ur": "UR",
}

OFFERED = {
    "ot2": {"run_protocol"},
    "solo": {"run_protocol"},
    "chemspeed": {"open_lid", "close_lid", "run_program"},
    "a4s_sealer": {"seal"},
    "brooks_peeler": {"peel"},
    "biometra": {"open_lid", "close_lid", "run_program"},
    "liconic": {
        "get_current_temp",
        "get_target_temp",
        "set_target_temp",
        "get_current_humidity",
        "get_target_humidity",
        "set_target_humidity",
        "begin_shake",
        "end_shake",
        "load_plate",
        "unload_plate",
    },
    "camera": {"grab_image", "take_picture"},
    "hidex": {"open_lid", "close_lid", "run_assay"},
    "inheco": {"open_door", "close_door", "set_temperature", "stop_temperature", "begin_shake", "end_shake"},
    "pipette": {"initialise", "aspirate", "dispense", "eject_tip"},
    "tecan": {"measure_sample"},
    "platecrane": {"transfer", "remove_lid", "replace_lid"},
    "pf400": {"explore_workcell", "transfer", "remove_lid", "replace_lid"},
    "ur": {"transfer", "run_urp_program"},
    "sciclops": {"home", "transfer", "get_plate"},
    "mir": {"move", "dock"},
    "axis": {"home", "move_to", "read_position"},
    "plc": {"open", "close", "read_temperature"},
    "operator": {"carry_plate", "load", "replace", "do"},
    "barty": {"fill", "drain", "fill_ink_all_motors", "drain_ink_all_motors", "refill_ink"},
}

HERE = Path(labos_drivers.__file__).parent


def load(package: str) -> type[Node]:
    return getattr(importlib.import_module(f"labos_drivers.{package}"), DRIVERS[package])  # type: ignore[no-any-return]


def each_effect(about: Description) -> Iterator[tuple[ActionSpec, AnyEffect]]:
    for action in about.actions:
        for effect in action.effects:
            yield action, effect


def stations_in(effect: AnyEffect) -> list[str]:
    match effect:
        case Move(source=source, target=target):
            return [source, target]
        case Take(stack=stack, target=target):
            return [stack, target]
        case Needs(station=station):
            return [station] if station else []
    return []


@pytest.fixture(params=sorted(DRIVERS))
def package(request: pytest.FixtureRequest) -> str:
    return str(request.param)


@pytest.fixture
def about(package: str) -> Description:
    return load(package).describe()


def test_no_package_is_forgotten() -> None:
    assert {path.parent.name for path in HERE.glob("*/interface.py")} == set(DRIVERS)


def test_names_itself_as_its_package(package: str, about: Description) -> None:
    assert about.driver == package
    assert about.models
    assert about.description


def test_offers_the_actions_that_workflows_call(package: str, about: Description) -> None:
    assert not {name for name in OFFERED[package] if about.action(name) is None}


def test_actions_are_documented(about: Description) -> None:
    for action in about.actions:
        assert action.description.endswith((".", "``")), action.name
        assert action.duration_s > 0
        for arg in action.args:
            assert arg.type != "any", f"{action.name}.{arg.name} has no type"
            if arg.type in ("int", "float"):
                assert arg.unit, f"{action.name}.{arg.name} has no unit"
            elif arg.type != "station" and not arg.choices:
                assert arg.description, f"{action.name}.{arg.name} is not described"


def test_defaults_lie_within_limits(about: Description) -> None:
    for action in about.actions:
        for arg in action.args:
            if arg.required or arg.default is None:
                continue
            assert arg.minimum is None or arg.default >= arg.minimum
            assert arg.maximum is None or arg.default <= arg.maximum
            assert not arg.choices or arg.default in arg.choices


BY_NAME = {("tecan", "measure_sample", "tecan_iteration")}
"""Numbers that are part of a file's name: nothing moves, heats or is used up by how large they are."""


def test_numbers_have_both_limits(package: str, about: Description) -> None:
    """``test_actions_are_documented`` holds that they have a unit."""
    unbounded = [
        (package, action.name, arg.name)
        for action in about.actions
        for arg in action.args
        if arg.type in ("int", "float") and not arg.choices and None in (arg.minimum, arg.maximum)
    ]
    assert set(unbounded) <= BY_NAME


def test_what_is_beyond_a_limit_is_refused_by_the_node(tmp_path: Path) -> None:
    """Whoever asks: here nobody but a bus stands between the request and the node."""

    async def body() -> None:
        async with bench(tmp_path, free_endpoint()) as lab:
            for package in sorted(DRIVERS):
                server = await serve(lab, package)
                before = lab.world.last_motion()
                numbers = beyond(server.node, tmp_path)
                for position, (name, args, what) in enumerate(numbers, 1):
                    reply = await lab.kernel.start(f"a{position}", name, **args)
                    assert (reply.status, reply.transient) == ("refused", False), (package, name, what)
                    assert what.split()[0] in reply.why, (package, name, what)
                assert lab.world.last_motion() == before, package
                await server.close()

    asyncio.run(body())


async def serve(lab: Lab, package: str) -> NodeServer:
    """A driver's node on the bus, with a simulated device."""
    kind, told = load(package), find_declaration(load(package))
    setup = Setup("arm", "cell", told.settings, poses=told.poses, regrip=told.regrip, world=lab.world)
    journal = await Journal.open(FileJournalFile(lab.folder / package), Uuid7Ids())
    bus = await lab.bus()
    server = NodeServer(kind(setup), bus, LAB, journal, SystemClock(), Uuid7Ids(), settle_s=0.02)
    await server.start()
    lab.kernel.journal = journal.memory.id
    return server


def beyond(node: Node, folder: Path) -> Iterator[tuple[str, dict[str, Any], str]]:
    """Each call of each action with one number too small or too large, and what is wrong with it."""
    about = node.describe()
    for case in cases_of(about, find_declaration(type(node)), folder):
        spec = about.action(case.action)
        assert spec is not None
        for what, args in list_wrong_args(case, spec):
            if what.endswith(("its minimum", "its maximum")):
                yield spec.name, args, what


def test_no_two_things_bear_one_name(about: Description) -> None:
    actions = [name for action in about.actions for name in (action.name, *action.aliases)]
    assert len(actions) == len(set(actions))
    for action in about.actions:
        args = [name for arg in action.args for name in (arg.name, *arg.aliases)]
        assert len(args) == len(set(args)), action.name
    stations = [name for station in about.stations for name in (station.name, *station.aliases)]
    assert len(stations) == len(set(stations))


def test_effects_fill_in(about: Description) -> None:
    for action, effect in each_effect(about):
        args = {arg.name: arg.default if not arg.required else arg.minimum or arg.name for arg in action.args}
        if isinstance(effect, Consumes) and isinstance(effect.amount, str):
            decisive = list_arguments(effect.amount)
            assert decisive, action.name
            assert decisive <= args.keys(), action.name
            continue
        filled = msgspec.structs.asdict(resolve(effect, args, StationName))
        assert not [value for value in filled.values() if "{" in str(value) and not is_reported(value)], (
            action.name
        )


def test_effects_speak_of_what_is_there(about: Description) -> None:
    stations = {station.name for station in about.stations}
    for action, effect in each_effect(about):
        for station in stations_in(effect):
            assert "{" in station or station in stations, action.name
        if isinstance(effect, Requires | Sets) and effect.of == "module":
            assert effect.variable in about.variables, action.name
        if isinstance(effect, Consumes):
            amount = 1.0 if isinstance(effect.amount, str) else effect.amount
            assert about.levels.get(effect.resource, amount) >= amount > 0, action.name
            assert effect.resource in {**about.levels, **about.units}, action.name
        if isinstance(effect, Move | Take):
            assert about.manipulator, action.name
            assert "gripper" in stations, action.name


def test_rest_and_access_are_of_its_variables(about: Description) -> None:
    for station in about.stations:
        assert set(station.access) <= set(about.variables)
    assert set(about.rest) <= set(about.variables)


def test_describes_itself_in_json(about: Description) -> None:
    assert msgspec.json.decode(msgspec.json.encode(about), type=Description) == about


def test_the_description_file_agrees(package: str, about: Description) -> None:
    written = load_description(HERE / package / "description.yaml")
    assert written.driver == about.driver
    assert {name: place.kind for name, place in list_places(written).items()} == {
        station.name: station.kind for station in about.stations
    }


def test_starts_on_a_bench_and_stands_still(package: str, world: World) -> None:
    async def body() -> None:
        node = load(package)(Setup(name=package, workcell="w", world=world))
        await node.connect()
        assert await node.is_idle()
        msgspec.json.encode(await node.observe())
        msgspec.json.encode(await node.resources())
        await node.stop()
        await node.reset()
        await node.close()

    asyncio.run(body())


def test_says_what_to_do_when_there_is_no_bench(package: str) -> None:
    node = load(package)(Setup(name=package, workcell="w"))
    if package == "operator":
        return  # a person needs no device
    with pytest.raises(DeviceError, match="--simulate") as refused:
        asyncio.run(node.connect())
    assert refused.value.effects == "none"


def test_simulators_know_nothing_of_effects() -> None:
    for path in [*HERE.glob("*/simulator.py"), HERE / "_simulation.py", HERE / "_deck.py"]:
        assert "labos.core" not in path.read_text("utf-8"), path

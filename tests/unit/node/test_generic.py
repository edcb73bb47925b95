"""A module that is simulated by its description: what it does to the bench and what it refuses."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

from labos.core.model import Description, Station
from labos.errors import DeviceError
from labos.node.generic import GenericNode, extend_node, make_generic_node
from labos.node.node import Node, Setup, action
from labos.node.world import Crash, World
from labos.spec.about import About, Extends, add_reset, extend, make_description

PACE = 10_000.0

ARM = {
    "manipulator": True,
    "stations": {"gripper": {"kind": "gripper"}},
    "actions": {
        "carry": {
            "args": {"a": {"type": "station"}, "b": {"type": "station"}},
            "effects": [{"move": {"source": "{a}", "target": "{b}"}}],
        },
        "lift_lid": {
            "args": {"a": {"type": "station"}, "b": {"type": "station"}},
            "effects": [{"unlid": {"source": "{a}", "target": "{b}"}}],
        },
    },
}
PRESS = {
    "stations": {"nest": {"access": {"door": "open"}}},
    "variables": {"door": "open"},
    "actions": {
        "shut": {"effects": [{"sets": {"of": "module", "variable": "door", "value": "shut"}}]},
        "press": {
            "effects": [
                {"needs": {}},
                {"requires": {"of": "module", "variable": "door", "value": "shut"}},
                {"sets": {"of": "labware", "variable": "sealed", "value": True}},
                {"consumes": {"resource": "foil", "amount": 1}},
            ]
        },
        "read": {"effects": [{"needs": {}}, {"reads": {}}]},
    },
    "levels": {"foil": 3},
}


def describe(about: dict[str, Any]) -> Description:
    return add_reset(make_description(About.model_validate(about), "generic"))


def node_of(
    about: dict[str, Any], world: World | None, name: str = "press", pace: float = PACE
) -> GenericNode:
    node = make_generic_node(describe(about))(Setup(name, "cell", world=world, pace=pace))
    assert isinstance(node, GenericNode)
    return node


def do(node: Node, name: str, **args: Any) -> Any:
    return asyncio.run(node.methods()[name](**args))  # type: ignore[arg-type]


@pytest.fixture
def world() -> World:
    return World()


def test_an_arm_carries_what_stands_there(world: World) -> None:
    (plate,) = world.stock("press.nest", "plate96")
    do(node_of(ARM, world, "arm"), "carry", a="cell/press.nest", b="cell/wc.shelf")
    assert world.at("wc.shelf") == [plate]
    assert [motion.verb for motion in world.motions() if motion.device == "arm"][:2] == ["grip", "release"]


def test_a_lid_is_carried_and_its_plate_stays(world: World) -> None:
    (plate,) = world.stock("press.nest", "plate96+lid96")
    do(node_of(ARM, world, "arm"), "lift_lid", a="cell/press.nest", b="cell/wc.lids")
    assert (world.at("press.nest"), world.at("wc.lids")) == ([plate], [f"lid of {plate}"])


def test_what_goes_to_the_waste_is_gone(world: World) -> None:
    world.stock("press.nest", "plate96")
    do(node_of(ARM, world, "arm"), "carry", a="cell/press.nest", b="cell/wc.trash")
    assert world.list_contents() == {}


def test_a_hand_that_finds_nothing_crashes(world: World) -> None:
    with pytest.raises(Crash, match="grips empty air"):
        do(node_of(ARM, world, "arm"), "carry", a="cell/press.nest", b="cell/wc.shelf")


def test_a_door_keeps_hands_out_until_it_is_opened_again(world: World) -> None:
    press, arm = node_of(PRESS, world), node_of(ARM, world, "arm")
    world.stock("press.nest", "plate96")
    with pytest.raises(DeviceError, match="door is open, not shut") as told:
        do(press, "press")
    assert told.value.effects == "none"
    do(press, "shut")
    with pytest.raises(Crash, match="closed gate"):
        do(arm, "carry", a="cell/press.nest", b="cell/wc.shelf")


def test_it_remembers_its_door_after_a_restart(world: World) -> None:
    do(node_of(PRESS, world), "shut")
    again = node_of(PRESS, world)
    assert asyncio.run(again.observe()) == {"door": "shut"}
    assert world.is_shut("press.nest")


def test_it_works_on_what_stands_in_it_and_uses_things_up(world: World) -> None:
    press = node_of(PRESS, world)
    (plate,) = world.stock("press.nest", "plate96")
    world.supply("press", "foil", 1)
    do(press, "shut")
    do(press, "press")
    assert world.last(plate, "seal", "peel") == "seal"
    with pytest.raises(Crash, match="runs out of foil"):
        do(press, "press")


def test_it_tells_the_barcode_that_it_reads(world: World) -> None:
    (plate,) = world.stock("press.nest", "plate96")
    world.label(plate, "LB0815")
    assert do(node_of(PRESS, world), "read") == {"barcode": "LB0815"}


def test_stopped_in_mid_motion_it_holds_what_it_held_until_it_is_reset(world: World) -> None:
    slow = node_of(ARM, world, "arm", pace=1.0)
    world.stock("press.nest", "plate96")

    async def body() -> None:
        carrying = asyncio.ensure_future(slow.methods()["carry"](a="cell/press.nest", b="cell/wc.shelf"))  # type: ignore[arg-type]
        await asyncio.sleep(0)  # it has begun
        assert not await slow.is_idle()
        await slow.stop()
        with pytest.raises(DeviceError, match="stopped in mid-motion"):
            await carrying
        with pytest.raises(DeviceError, match="is stopped"):
            await slow.methods()["carry"](a="cell/press.nest", b="cell/wc.shelf")
        await slow.reset()
        assert await slow.is_idle()

    asyncio.run(body())


def test_a_question_is_answered_while_it_is_at_work(world: World) -> None:
    about = {"actions": {"bake": {"duration": 50}, "ask": {"exclusive": False, "duration": 0.01}}}
    oven = node_of(about, world, pace=1.0)

    async def body() -> None:
        baking = asyncio.ensure_future(oven.methods()["bake"]())  # type: ignore[arg-type]
        await asyncio.sleep(0)  # it has begun
        await oven.methods()["ask"]()  # type: ignore[misc]
        assert not await oven.is_idle()
        with pytest.raises(DeviceError, match="is busy"):
            await oven.methods()["bake"]()  # type: ignore[misc]
        baking.cancel()

    asyncio.run(body())


def test_it_takes_as_long_as_is_said(world: World) -> None:
    about = {"actions": {"wait": {"duration": 4.0}}}
    node = node_of(about, world, pace=100.0)

    async def body() -> float:
        loop = asyncio.get_running_loop()
        began = loop.time()
        await node.methods()["wait"]()
        return (loop.time() - began) * 100.0

    assert asyncio.run(body()) > 3.5


def test_without_a_bench_it_says_what_is_missing() -> None:
    with pytest.raises(DeviceError, match=r"only simulated.*interface") as told:
        node_of(PRESS, None)
    assert told.value.effects == "none"


class Oven(Node):
    """Bakes."""

    driver = "oven"
    stations = (Station("tray", access={"door": "open"}),)
    variables = {"door": "open"}
    baked: list[float] = []

    @action()
    async def bake(self, time: float, temperature: float = 100.0) -> None:
        self.baked.append(time)

    @action()
    def cool(self, rate: int = 1) -> str:
        return f"cooled by {rate}"


def make_offering(more: dict[str, Any], world: World) -> Node:
    description = extend(Oven.describe(), Extends.model_validate(more))
    return extend_node(Oven, description)(Setup("oven", "cell", world=world, pace=PACE))


def test_arguments_that_a_driver_does_not_know_are_kept_from_it(world: World) -> None:
    oven = make_offering(
        {"actions": {"bake": {"args": {"recipe": {}}}, "cool": {"args": {"why": {}}}}}, world
    )
    do(oven, "bake", time=3.0, recipe="cake.yaml")
    assert Oven.baked[-1] == 3.0
    assert asyncio.iscoroutinefunction(oven.methods()["bake"])
    assert oven.methods()["cool"](rate=2, why="hot") == "cooled by 2"
    assert [arg.name for arg in oven.describe().actions[0].args] == ["time", "temperature", "recipe"]


def test_an_action_that_a_driver_does_not_know_takes_its_time_and_no_more(world: World) -> None:
    oven = make_offering({"actions": {"grill": {"args": {"how": {}}, "duration": 2}}}, world)
    assert do(oven, "grill", how="well done") is None
    assert [motion.verb for motion in world.motions() if motion.device == "oven"] == ["grill"]


def test_an_action_that_replaces_the_drivers_is_not_asked_of_it(world: World) -> None:
    before = list(Oven.baked)
    oven = make_offering({"actions": {"bake": {"args": {"recipe": {}}, "replaces": True}}}, world)
    do(oven, "bake", recipe="bread")
    assert Oven.baked == before
    assert [arg.name for arg in oven.describe().actions[0].args] == ["recipe"]


def test_the_door_of_the_drivers_device_is_left_alone(world: World) -> None:
    world.gate("oven", "oven.tray", shut=True)
    make_offering({"actions": {"grill": {}}}, world).methods()
    assert world.is_shut("oven.tray"), "also when the node is started again"


def test_an_emergency_stop_ends_what_the_driver_does_not_know(world: World) -> None:
    oven = make_offering({"actions": {"grill": {"duration": 1_000_000}}}, world)
    grill = oven.methods()["grill"]

    async def body() -> None:
        grilling = asyncio.ensure_future(grill())  # type: ignore[arg-type]
        await asyncio.sleep(0)  # it has begun
        assert not await oven.is_idle()
        await oven.stop()
        with pytest.raises(DeviceError, match="stopped in mid-motion"):
            await grilling
        await oven.reset()
        assert await oven.is_idle()

    asyncio.run(body())

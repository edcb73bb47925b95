"""Barty's driver and a simulated pigpio daemon, which pigpio's own client drives too."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator
from typing import Any

import pytest

from labos.errors import DeviceError, LinkError, NotConnected, WrongDevice
from labos.link import TcpEnd
from labos.node import Setup, World
from labos_drivers.barty import Barty, protocol
from labos_drivers.barty import driver as barty_driver
from labos_drivers.barty.driver import Dose
from labos_drivers.barty.protocol import PINS
from labos_drivers.barty.wire import BartyOnWire
from tests.drivers.test_ot2_wire import keep_handles
from tests.drivers.wires import at_port, power_on, run, until
from tests.integration.link.far import answer_on


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(barty_driver, "POLL_S", 0.01)


@pytest.fixture
def pumps(world: World) -> Iterator[BartyOnWire]:
    with power_on(BartyOnWire, "barty", world) as device:
        yield device


def node_at(device: BartyOnWire, **config: Any) -> Barty:
    return at_port(Barty, "barty", device.address, key="host", config=config)


def list_pumped(world: World) -> list[tuple[int, float]]:
    return [(m.facts["pump"], m.facts["ml"]) for m in world.motions("pump")]


def test_ink_goes_into_the_reservoirs_and_back(pumps: BartyOnWire, world: World) -> None:
    async def body() -> None:
        handles = keep_handles()
        node = node_at(pumps)
        await node.connect()
        await node.fill([0, 2], amount=10)
        await node.refill_ink(["motor_4"])
        await node.drain([2], amount=4)
        assert await node.is_idle()
        assert await node.observe() == {}
        await node.close()
        assert len(set(handles)) == 3

    run(body)
    assert [pump for pump, _ in list_pumped(world)] == [0, 2, 3, 2]
    assert [ml for _, ml in list_pumped(world)] == pytest.approx([10, 10, 5, -4], rel=0.1)
    assert pumps.levels == [0] * 32
    assert len(pumps._scripts) == 1


def test_scripts_that_earlier_nodes_have_left_make_room(pumps: BartyOnWire, world: World) -> None:
    async def body() -> None:
        for _ in range(protocol.ROOM + 1):
            node = node_at(pumps)
            await node.connect()
            await node.fill([0], amount=0.1)
            await node.close()

    run(body)
    assert len(list_pumped(world)) == protocol.ROOM + 1
    assert len(pumps._scripts) == 1


@pytest.mark.parametrize(
    ("told", "amount", "why"),
    [
        ([4], 5.0, "no pump 4"),
        ([-1], 5.0, "no pump -1"),
        ([True], 5.0, "no pump True"),
        ([1.0], 5.0, r"no pump 1\.0"),
        (["0"], 5.0, "no pump 0"),
        ([], 5.0, "no pump"),
        ([1, 1], 5.0, "a pump twice"),
        ([1], 0.0, "not 0"),
        ([1], -5.0, "not -5"),
        ([1], 151.0, "not 151"),
        ([1], float("nan"), "not nan"),
    ],
)
def test_limits_are_refused_in_the_node(
    told: list[Any], amount: float, why: str, pumps: BartyOnWire, world: World
) -> None:
    async def body() -> None:
        node = node_at(pumps)
        await node.connect()
        for act in (node.fill, node.drain):
            with pytest.raises(DeviceError, match=why) as refused:
                await act(told, amount)
            assert refused.value.effects == "none"
        with pytest.raises(DeviceError, match="no motor"):
            await node.refill_ink(["motor_5"])
        await node.close()

    run(body)
    assert list_pumped(world) == []


def test_each_pump_has_its_rate_and_its_time(pumps: BartyOnWire, world: World) -> None:
    async def body() -> None:
        node = node_at(pumps, ml_per_s=[1.427, 0.7135, 1.427, 1.427])
        await node.connect()
        await node.fill([0, 1], amount=10)
        with pytest.raises(DeviceError, match="no pump runs longer than 120 s") as refused:
            await node.fill([1], amount=100)
        assert refused.value.effects == "none"
        await node.close()
        for rates in ([1.0], "fast", [1, 1, 1, 0]):
            with pytest.raises(DeviceError, match="no rates of 4 pumps"):
                await node_at(pumps, ml_per_s=rates).connect()

    run(body)
    # The slower one runs twice as long; here it is as fast as the others, and gives twice as much.
    (first, slow), (second, fast) = list_pumped(world)
    assert (first, second) == (1, 0)
    assert slow == pytest.approx(20, rel=0.1)
    assert fast == pytest.approx(10, rel=0.1)


def test_a_stop_is_a_stop(world: World) -> None:
    async def check_stop(device: BartyOnWire) -> None:
        node = node_at(device)
        await node.connect()
        work = asyncio.create_task(node.fill_all(60))
        await until(lambda: device.levels[PINS[3].enable] == 1)
        assert not await node.is_idle()
        await node.stop()
        assert await node.is_idle()
        with pytest.raises(DeviceError, match="stopped before the dose was done") as told:
            await work
        assert told.value.effects == "partial"
        with pytest.raises(DeviceError, match="was stopped"):
            await node.fill([0])
        await node.reset()
        await node.fill([0])
        await node.close()

    with power_on(BartyOnWire, "barty", world, pace=6) as device:
        run(lambda: check_stop(device))
    assert all(0 < ml < 59 for _, ml in list_pumped(world)[:4])


def test_a_pump_that_somebody_else_runs(pumps: BartyOnWire, world: World) -> None:
    async def body() -> None:
        node = node_at(pumps)
        await node.connect()
        pumps.press(PINS[1].enable)
        with pytest.raises(DeviceError, match="a pump runs already") as told:
            await node.fill([0])
        assert told.value.effects == "none"
        await node.reset()
        pumps.refuses = True
        with pytest.raises(DeviceError, match=r"does not take the dose \(error -57\)"):
            await node.fill([0])
        await node.close()

    run(body)


def test_the_pump_stops_by_itself_and_the_dose_is_taken_up(world: World) -> None:
    """The node dies in mid-dose: another one finds it by what was journalled."""

    async def body(device: BartyOnWire) -> None:
        handles = keep_handles()
        node = node_at(device)
        await node.connect()
        work = asyncio.create_task(node.fill([0, 1], amount=20))
        await until(lambda: device.levels[PINS[1].enable] == 1)
        device.end.unplug()
        device.end.plug()
        again = node_at(device)
        await again.connect()
        assert not await again.is_idle()
        await again.take_up("fill", handles[0])
        assert await again.is_idle()
        await again.take_up("fill", handles[0])
        await again.drain([0])
        # The script has given its place to the next dose: who asks later is told that nobody knows.
        with pytest.raises(DeviceError, match="has been restarted") as told:
            await again.take_up("fill", handles[0])
        assert told.value.effects == "unknown"
        with pytest.raises(DeviceError, match="nothing was started"):
            await again.take_up("fill", "")
        await again.close()
        work.cancel()
        await asyncio.gather(work, return_exceptions=True)
        await node.close()

    with power_on(BartyOnWire, "barty", world, pace=6) as device:
        run(lambda: body(device))
    assert [pump for pump, _ in list_pumped(world)] == [0, 1, 0]


def test_a_dose_that_was_stored_and_not_started_never_is(pumps: BartyOnWire, world: World) -> None:
    async def body() -> None:
        node = node_at(pumps)
        await node.connect()
        assert isinstance(node.device, barty_driver.BartyDriver)
        dose = await node.device.store([0], 3.0, fill=True)
        with pytest.raises(DeviceError, match="were not started") as told:
            await node.take_up("fill", str(dose))
        assert told.value.effects == "none"
        assert pumps._scripts == {}
        await node.device.store([0], 3.0, fill=True)
        other = Dose(0, dose.owner)
        with pytest.raises(DeviceError, match="were not started"):
            await node.take_up("fill", str(other))
        await node.close()

    run(body)
    assert list_pumped(world) == []


def test_a_lost_answer_leaves_no_doubt(
    pumps: BartyOnWire, world: World, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The answer to the start is lost: the script itself says that it began, and ended."""

    async def body() -> None:
        node = node_at(pumps)
        await node.connect()
        said = pumps.send

        def lossy(data: bytes) -> None:
            if data[:1] != bytes((protocol.PROCR,)):
                said(data)

        pumps.send = lossy  # type: ignore[method-assign]
        await node.fill([3], amount=5)
        await node.close()

    monkeypatch.setattr(barty_driver, "ANSWER_S", 1.0)
    run(body)
    assert len(list_pumped(world)) == 1


def test_nobody_there_and_somebody_else(world: World) -> None:
    with power_on(BartyOnWire, "barty", world) as device:
        address = device.address
    with pytest.raises(NotConnected):
        run(at_port(Barty, "barty", address, key="host").connect)
    question = protocol.make_command(protocol.PIGPV)
    others = (
        (protocol.HEADER.pack(protocol.PIGPV, 0, 0, -88), WrongDevice),
        (b"220 ready for something else\r\n", LinkError),
    )
    for says, error in others:
        end = TcpEnd()
        with answer_on(end, {b"": says}, stop=question), pytest.raises(error):
            run(at_port(Barty, "barty", f"127.0.0.1:{end.port}", key="host").connect)


def test_its_own_client_drives_the_simulated_daemon(pumps: BartyOnWire, world: World) -> None:
    """pigpio's Python client, unmodified: pins, a script that is stored, run, asked for and deleted."""
    pigpio = pytest.importorskip("pigpio", reason="pigpio is not installed (it is with the extra `test`)")
    host, _, port = pumps.address.partition(":")
    pi = pigpio.pi(host, int(port), show_errors=False)
    listener = pi._notify
    try:
        assert pi.connected
        assert pi.get_pigpio_version() == 79
        pi.write(27, 1)
        assert pi.read(27) == 1
        script = pi.store_script(b"m 17 w w 17 1 mils 3500 w 17 0 ld p0 1")
        assert pi.script_status(script) == (pigpio.PI_SCRIPT_HALTED, (0,) * 10)
        pi.run_script(script)
        while pi.script_status(script)[0] == pigpio.PI_SCRIPT_RUNNING:
            pass
        assert pi.script_status(script)[1][0] == 1
        pi.delete_script(script)
        with pytest.raises(pigpio.error, match="unknown script id"):
            pi.run_script(script)
    finally:
        pi.stop()
        listener.join(5)  # it closes its own socket
    assert list_pumped(world) == [(0, pytest.approx(5.0, rel=0.1))]


def test_simulated_behind_its_wire(world: World) -> None:
    async def body() -> None:
        node = Barty(Setup(name="barty", workcell="rpl", world=world, pace=200, wire=True))
        await node.connect()
        await node.drain_all()
        await node.close()

    run(body)
    assert [pump for pump, _ in list_pumped(world)] == [0, 1, 2, 3]


def test_a_state_of_a_dose_that_is_not_known_is_no_end(pumps: BartyOnWire) -> None:
    def runs_oddly(script: Any) -> int:
        script.status = 7
        return 0

    pumps._run = runs_oddly  # type: ignore[method-assign]

    async def body() -> None:
        node = node_at(pumps)
        await node.connect()
        with pytest.raises(DeviceError, match="in the state 7, which is not known") as told:
            await node.fill([0], amount=5)
        assert told.value.effects == "unknown"
        await node.close()

    run(body)

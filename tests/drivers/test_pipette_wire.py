"""The pipette's driver and a simulated pump, on a pseudo-terminal and at the arm's tool port."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from labos.errors import DeviceError, LinkError, NotConnected
from labos.link import BadFrame, PtyEnd, SerialWire, TcpEnd
from labos.node import Setup, World
from labos_drivers.pipette import Pipette, protocol
from labos_drivers.pipette import driver as pipette_driver
from labos_drivers.pipette.protocol import Frames
from labos_drivers.pipette.wire import PipetteOnWire
from tests.drivers.conftest import Bench, lab_seconds
from tests.drivers.test_ot2_wire import keep_handles
from tests.drivers.wires import at_port, power_on, run, setup_of, until
from tests.integration.link.far import answer_on


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pipette_driver, "POLL_S", 0.01)


@pytest.fixture
def port(tmp_path: Path) -> Path:
    return tmp_path / "pipette"


@pytest.fixture
def pump(world: World, port: Path) -> Iterator[PipetteOnWire]:
    with power_on(PipetteOnWire, "pipette", world, port) as device:
        yield device


def strokes(world: World) -> list[tuple[str, float]]:
    return [(m.verb, m.facts["ul"]) for m in world.motions() if m.verb in ("aspirate", "dispense")]


# -- frames ------------------------------------------------------------------------------------


def test_questions_and_answers_as_they_are_on_the_wire() -> None:
    frames = Frames()
    assert frames.pack(b"z1600A0A10z0R") == b"/1z1600A0A10z0R\r"
    assert protocol.write(True, 0) == b"\xff/0`\x03\r\n"
    assert protocol.write(False, 0) == b"\xff/0@\x03\r\n"
    for character, ready, error in (("g", True, 7), ("G", False, 7), ("o", True, 15), ("i", True, 9)):
        assert protocol.read(f"{character}".encode()) == (ready, error, "")
    buffer = bytearray(protocol.write(True, 0, "1600") + protocol.write(False, 0))
    assert protocol.read(frames.take(buffer) or b"") == (True, 0, "1600")
    assert frames.take(buffer) == b"@"
    assert frames.take(buffer) is None
    for noise in (b"/0\x03", b"/1`\x03", b"/0\xe0\x03", b"hello\x03", b"/0`\x011\x03"):
        with pytest.raises(BadFrame, match="is no answer of a pump"):
            frames.take(bytearray(noise))
    with pytest.raises(BadFrame, match="no end"):
        frames.take(bytearray(b"/0`" + b"1" * 600))


# -- the device --------------------------------------------------------------------------------


def test_draws_up_and_lets_out(pump: PipetteOnWire, world: World, port: Path) -> None:
    async def body() -> None:
        handles = keep_handles()
        node = at_port(Pipette, "pipette", port)
        await node.connect()
        await node.initialise()
        assert await node.aspirate(50.0) == 50.0
        assert await node.aspirate(10.0, speed=100) == 60.0
        assert await node.dispense(25.0) == 35.0
        assert await node.get_volume() == 35.0
        assert await node.is_idle()
        assert await node.observe() == {}
        assert handles == ["0:400", "400:480", "480:280"]
        await node.close()

    run(body)
    assert strokes(world) == [("aspirate", 50.0), ("aspirate", 10.0), ("dispense", 25.0)]
    assert pump.position == 280


def test_limits_are_refused_in_the_node(pump: PipetteOnWire, world: World, port: Path) -> None:
    async def body() -> None:
        node = at_port(Pipette, "pipette", port)
        await node.connect()
        await node.aspirate(150.0)
        with pytest.raises(
            DeviceError, match=r"150 of 200 µL are drawn up; 60 µL cannot be aspirated"
        ) as much:
            await node.aspirate(60.0)
        with pytest.raises(DeviceError, match=r"151 µL cannot be dispensed") as little:
            await node.dispense(151.0)
        with pytest.raises(DeviceError, match="has no ejector") as eject:
            await node.eject_tip()
        assert {told.value.effects for told in (much, little, eject)} == {"none"}
        await node.close()

    run(body)
    assert strokes(world) == [("aspirate", 150.0)]


def test_one_with_an_ejector(world: World, port: Path) -> None:
    async def body() -> None:
        node = at_port(Pipette, "pipette", port, config={"kind": "air_z"})
        await node.connect()
        assert await node.aspirate(700.0, speed=500.0) == pytest.approx(700, abs=0.2)
        await node.eject_tip()
        assert await node.get_volume() == 0.0
        await node.close()

    with power_on(PipetteOnWire, "pipette", world, port, told={"config": {"kind": "air_z"}}):
        run(body)
    assert len(world.motions("eject")) == 1


@pytest.mark.parametrize(
    ("config", "why"),
    [({"kind": "p300"}, "no pump of kind 'p300'"), ({"volume_ul": 0}, "`volume_ul:` is 0")],
)
def test_pumps_that_there_are_none_of(config: dict[str, Any], why: str) -> None:
    with pytest.raises(DeviceError, match=why):
        run(at_port(Pipette, "pipette", "/dev/null", config=config).connect)


def test_a_plunger_that_sticks_and_a_pump_without_power(
    pump: PipetteOnWire, world: World, port: Path
) -> None:
    async def body() -> None:
        node = at_port(Pipette, "pipette", port)
        await node.connect()
        pump.stuck = True
        with pytest.raises(DeviceError, match="pump error 9 when it moved: its plunger") as told:
            await node.aspirate(20.0)
        assert told.value.effects == "unknown"
        pump.stuck = False
        with pytest.raises(
            DeviceError, match=r"pump error 7 when it was told .*: it is not initialised"
        ) as off:
            await node.aspirate(20.0)
        assert off.value.effects == "none"
        await node.reset()
        assert await node.aspirate(20.0) == 20.0
        await node.close()

    run(body)
    assert strokes(world) == [("aspirate", 20.0)]


def test_a_stop_is_a_stop(world: World, port: Path) -> None:
    async def body(pump: PipetteOnWire) -> None:
        node = at_port(Pipette, "pipette", port)
        await node.connect()
        work = asyncio.create_task(node.aspirate(200.0, speed=10.0))
        await until(lambda: pump._compute_position() > 200)
        assert not await node.is_idle()
        await node.stop()
        with pytest.raises(DeviceError, match=r"has moved .* of 200 µL") as told:
            await work
        assert told.value.effects == "partial"
        with pytest.raises(DeviceError, match="was stopped"):
            await node.dispense(1.0)
        await node.reset()
        await node.aspirate(1.0, speed=100)
        await node.close()

    with power_on(PipetteOnWire, "pipette", world, port, pace=6) as device:
        run(lambda: body(device))
    (_, drawn), _ = strokes(world)
    assert 25 <= drawn < 200


def test_a_lost_answer_leaves_no_doubt(
    pump: PipetteOnWire, world: World, port: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The answer to the order is lost: where the plunger stands tells that it was heard."""
    monkeypatch.setattr(pipette_driver, "ANSWER_S", 1.0)

    async def body() -> None:
        node = at_port(Pipette, "pipette", port)
        await node.connect()
        assert await node.aspirate(30.0) == 30.0
        await node.close()

    quiet = Muted(pump, b"V")
    try:
        run(body)
    finally:
        quiet.close()
    assert quiet.swallowed == 1
    assert strokes(world) == [("aspirate", 30.0)]


def test_a_stroke_is_taken_up_again(world: World, port: Path) -> None:
    """Whoever began it is gone; what was journalled is enough."""

    async def body(pump: PipetteOnWire) -> None:
        gone = SerialWire(str(port))
        gone.open()
        gone.write(b"/1V160A1600R\r", 1.0)
        await until(lambda: pump._compute_position() > 100)
        gone.close()
        again = at_port(Pipette, "pipette", port)
        await again.connect()
        assert not await again.is_idle()
        assert await again.take_up("aspirate", "0:1600") == 200.0
        with pytest.raises(DeviceError, match="has moved 0 of 10 µL") as never:
            await again.take_up("dispense", "1600:1520")
        assert never.value.effects == "none"
        with pytest.raises(DeviceError, match="has moved 100 of 150 µL") as half:
            await again.take_up("aspirate", "800:2000")
        assert half.value.effects == "partial"
        pump.initialised = False
        with pytest.raises(DeviceError, match="pump error 7") as off:
            await again.take_up("aspirate", "0:1600")
        assert off.value.effects == "unknown"
        with pytest.raises(DeviceError, match="nothing was started"):
            await again.take_up("aspirate", "")
        await again.close()

    with power_on(PipetteOnWire, "pipette", world, port, pace=6) as device:
        run(lambda: body(device))
    assert strokes(world) == [("aspirate", 200.0)]


class Muted:
    """What a pump says to the first question that begins so is lost."""

    def __init__(self, pump: PipetteOnWire, begins: bytes) -> None:
        self._pump, self._begins, self.swallowed = pump, begins, 0
        self._answer = pump._answer
        pump._answer = self._lossy  # type: ignore[method-assign]

    def _lossy(self, text: str) -> bytes:
        answer = self._answer(text)
        if text.encode().startswith(self._begins) and not self.swallowed:
            self.swallowed += 1
            return b""
        return answer

    def close(self) -> None:
        self._pump._answer = self._answer  # type: ignore[method-assign]


def test_at_the_tool_port_of_an_arm(world: World) -> None:
    end = TcpEnd()
    device = PipetteOnWire(setup_of("pipette", world), end)
    device.start()

    async def body() -> None:
        node = at_port(Pipette, "pipette", f"{end.host}:{end.port}")
        await node.connect()
        assert await node.aspirate(10.0) == 10.0
        end.unplug()
        with pytest.raises(LinkError) as told:
            await node.dispense(5.0)
        assert told.value.effects == "none"
        end.plug()
        await node.close()

    try:
        run(body)
    finally:
        device.close()


def test_nobody_answers(port: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pipette_driver, "ANSWER_S", 0.2)
    with (
        answer_on(PtyEnd(port), {}, stop=b"\r"),
        pytest.raises(NotConnected, match="does not identify itself"),
    ):
        run(at_port(Pipette, "pipette", port).connect)


def test_on_the_bench(bench: Bench, world: World) -> None:
    async def body() -> None:
        node = await bench.start(Pipette, "pipette", config={"kind": "air_z"})
        await node.initialise()
        assert await node.aspirate(100.0) == 100.0
        assert await node.dispense(40.0) == 60.0
        assert await node.get_volume() == 60.0
        with pytest.raises(DeviceError, match="60 of 1000 µL are drawn up; 70 µL cannot be dispensed"):
            await node.dispense(70.0)
        await node.eject_tip()
        other = await bench.start(Pipette, "other")
        with pytest.raises(DeviceError, match="has no ejector"):
            await other.eject_tip()

    lab_seconds(body)
    assert strokes(world) == [("aspirate", 100.0), ("dispense", 40.0)]


def test_simulated_behind_its_wire(world: World) -> None:
    async def body() -> None:
        node = Pipette(Setup(name="pipette", workcell="rpl", world=world, pace=200, wire=True))
        await node.connect()
        assert await node.aspirate(10.0) == 10.0
        await node.close()

    run(body)

"""The a4S driver and a simulated a4S on a pseudo-terminal."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator
from pathlib import Path

import pytest

from labos.errors import DeviceError, LinkLost, NoReply, NotConnected
from labos.link import PtyEnd, keep_transcript, read_transcript
from labos.node import Setup, World
from labos_drivers.a4s_sealer import A4sSealer, protocol
from labos_drivers.a4s_sealer import driver as sealer_driver
from labos_drivers.a4s_sealer.protocol import Status, check_sum
from labos_drivers.a4s_sealer.wire import SealerOnWire
from tests.drivers.wires import at_port, power_on, run, until

# Records of a real device, as they were captured.
CAPTURED = [
    b"*T01:26:12=0224,0,0,00,00,188,000GD!",
    b"*T01:29:23=0432,0,2,00,00,188,000FL!",
    b"*T01:29:31=0588,0,2,00,00,188,000FA!",
    b"*Y00PM!",
    b"*Y01PL!",
    b"*N00AH!",
    b"*N01AG!",
]


@pytest.fixture
def port(tmp_path: Path) -> Path:
    return tmp_path / "sealer"


@pytest.fixture
def sealer(world: World, port: Path) -> Iterator[SealerOnWire]:
    with power_on(SealerOnWire, "sealer", world, port) as device:
        yield device


@pytest.mark.parametrize("record", CAPTURED)
def test_check_sums_are_those_of_real_devices(record: bytes) -> None:
    body = protocol.framing().take(bytearray(record))
    assert body is not None
    assert b"*" + body + check_sum(body) + b"!" == record
    if body.startswith(b"T"):
        assert Status.read(body).body() == body


def test_seals_a_plate(sealer: SealerOnWire, world: World, port: Path, tmp_path: Path) -> None:
    async def body() -> None:
        node = at_port(A4sSealer, "sealer", port)
        await node.connect()
        (plate,) = world.stock("sealer.default", "plate")
        await node.seal(time=2.5, temperature=170.0)
        assert [(m.plate, m.facts) for m in world.motions("seal")] == [
            (plate, {"time_s": 2.5, "temperature_c": 170})
        ]
        assert not world.is_shut("sealer.default")
        assert await node.is_idle()
        await node.close()

    with keep_transcript(tmp_path / "talk.txt"):
        run(body)
    sent = b"".join(record.data for record in read_transcript(tmp_path / "talk.txt") if record.mark == ">")
    assert sent == b"*00DT=0025zz!*00DH=0170zz!*00GS=zz!"


def test_waits_for_the_block_to_be_hot(world: World, port: Path) -> None:
    async def body() -> None:
        node = at_port(A4sSealer, "sealer", port)
        await node.connect()
        world.stock("sealer.default", "plate")
        await node.seal(temperature=60.0)
        assert 58 <= world.motions("seal")[0].facts["temperature_c"] <= 62
        await node.close()

    with power_on(SealerOnWire, "sealer", world, port, cold=True):
        run(body)


@pytest.mark.parametrize(
    ("what", "why"), [("has_roll", "no roll of foil"), ("door_is_shut", "cleaning door is open")]
)
def test_refuses_what_cannot_be_done(
    sealer: SealerOnWire, world: World, port: Path, what: str, why: str
) -> None:
    async def body() -> None:
        node = at_port(A4sSealer, "sealer", port)
        await node.connect()
        setattr(sealer, what, False)
        with pytest.raises(DeviceError, match=why) as told:
            await node.seal()
        assert told.value.effects == "none"
        assert world.motions("seal") == []
        await node.close()

    run(body)


@pytest.mark.parametrize("twice", [False, True])
def test_a_rejection_is_no_acceptance(sealer: SealerOnWire, world: World, port: Path, twice: bool) -> None:
    async def body() -> None:
        node = at_port(A4sSealer, "sealer", port)
        await node.connect()
        sealer.rejects_twice = twice
        sealer.system = protocol.FINISHED
        sealer.shuttle = protocol.SHUTTLE_MIDDLE  # it moves, so that it takes no cycle
        with pytest.raises(DeviceError, match="does not take the command GS") as told:
            await node.seal()
        assert told.value.effects == "none"
        await node.close()

    run(body)


def test_an_error_in_the_cycle_is_told_and_reset(sealer: SealerOnWire, world: World, port: Path) -> None:
    async def body() -> None:
        node = at_port(A4sSealer, "sealer", port)
        await node.connect()
        # Nothing is in the nest, which the device cannot see; it jams.
        with pytest.raises(DeviceError, match="sealer error 11") as told:
            await node.seal()
        assert told.value.effects == "unknown"
        with pytest.raises(DeviceError, match="error 11") as again:
            await node.seal()
        assert again.value.effects == "none"
        await node.reset()
        world.stock("sealer.default", "plate")
        await node.seal()
        assert len(world.motions("seal")) == 1
        await node.close()

    run(body)


def test_a_stop_is_not_promised_and_sends_nothing_more(
    sealer: SealerOnWire, world: World, port: Path
) -> None:
    async def body() -> None:
        node = at_port(A4sSealer, "sealer", port)
        await node.connect()
        world.stock("sealer.default", "plate")
        await node.stop()
        with pytest.raises(DeviceError, match="was stopped") as told:
            await node.seal()
        assert told.value.effects == "none"
        await node.reset()
        work = asyncio.create_task(node.seal())
        await until(lambda: sealer.system == protocol.SINGLE_CYCLE)
        with pytest.raises(DeviceError, match="takes no stop over its wire"):
            await node.stop()
        await work
        assert len(world.motions("seal")) == 1
        await node.close()

    run(body)


def test_unplugged_in_mid_cycle(sealer: SealerOnWire, world: World, port: Path) -> None:
    async def body() -> None:
        node = at_port(A4sSealer, "sealer", port)
        await node.connect()
        world.stock("sealer.default", "plate")
        work = asyncio.create_task(node.seal())
        await until(lambda: sealer.system == protocol.SINGLE_CYCLE)
        sealer.end.unplug()
        with pytest.raises(LinkLost) as told:
            await work
        assert told.value.effects == "unknown"
        with pytest.raises(NotConnected) as gone:
            await node.seal()
        assert gone.value.effects == "none"
        sealer.end.plug()
        await until(lambda: sealer.system in (protocol.FINISHED, protocol.IDLE))
        await node.reset()
        assert await node.is_idle()
        await node.close()

    run(body)


def test_who_is_no_sealer_is_not_driven(port: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sealer_driver, "RECORD_S", 0.2)
    end = PtyEnd(port)

    async def body() -> None:
        node = at_port(A4sSealer, "sealer", port)
        with pytest.raises(NotConnected, match="does not identify itself") as told:
            await node.connect()
        assert told.value.effects == "none"

    end.write(b"*ready:00,00,00\r\n")
    run(body)
    end.close()


def test_silence_is_no_idleness(world: World, port: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    async def body() -> None:
        with power_on(SealerOnWire, "sealer", world, port) as device:
            node = at_port(A4sSealer, "sealer", port)
            await node.connect()
            monkeypatch.setattr(sealer_driver, "RECORD_S", 0.2)
            device.do_at_once(device.forget_plans)
            with pytest.raises(NoReply):
                await node.is_idle()
            await node.close()

    run(body)


def test_simulated_behind_its_wire(world: World) -> None:
    async def body() -> None:
        node = A4sSealer(Setup(name="sealer", workcell="rpl", world=world, pace=200, wire=True))
        await node.connect()
        world.stock("sealer.default", "plate")
        await node.seal()
        assert len(world.motions("seal")) == 1
        await node.close()

    run(body)


def test_a_status_that_is_not_known_is_not_ready(sealer: SealerOnWire, world: World, port: Path) -> None:
    async def body() -> None:
        node = at_port(A4sSealer, "sealer", port)
        await node.connect()
        world.stock("sealer.default", "plate")
        sealer.system = 7
        assert not await node.is_idle()
        with pytest.raises(DeviceError, match="its status is 7, which is not known") as told:
            await node.seal()
        assert told.value.effects == "none"
        sealer.system, sealer.shuttle = protocol.IDLE, protocol.SHUTTLE_IN | protocol.SHUTTLE_OUT
        assert not await node.is_idle()
        await node.close()

    run(body)
    assert world.motions("seal") == []


def test_an_error_at_the_end_of_a_cycle_is_no_success(
    sealer: SealerOnWire, world: World, port: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    arrive = sealer._arrive

    def arrives(way: int) -> None:
        sealer.error = 31 if sealer.shuttle == protocol.SHUTTLE_MIDDLE and world.motions("seal") else 0
        arrive(way)

    monkeypatch.setattr(sealer, "_arrive", arrives)

    async def body() -> None:
        node = at_port(A4sSealer, "sealer", port)
        await node.connect()
        world.stock("sealer.default", "plate")
        with pytest.raises(DeviceError, match="sealer error 31") as told:
            await node.seal()
        assert told.value.effects == "unknown"
        await node.close()

    run(body)

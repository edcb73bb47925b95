"""The Infinite's driver and a simulated reader: on a pseudo-terminal, and behind pyusb, where PyLabRobot's
driver finds it too."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from labos.errors import DeviceError, Garbled, LinkError, NotConnected, WrongDevice
from labos.link import BadFrame, PtyEnd, UsbWire
from labos.node import Attachment, Setup, World
from labos.torture import torture
from labos_drivers.tecan import Tecan, protocol
from labos_drivers.tecan import driver as tecan_driver
from labos_drivers.tecan.protocol import Calibration, Frames, frame
from labos_drivers.tecan.simulator import absorbance
from labos_drivers.tecan.wire import TecanOnWire
from tests.drivers.wires import at_port, power_on, run, setup_of, until
from tests.integration.link.far import answer_on

PACE = 2000.0


@pytest.fixture
def port(tmp_path: Path) -> Path:
    return tmp_path / "tecan"


@pytest.fixture
def reader(world: World, port: Path) -> Iterator[TecanOnWire]:
    with power_on(TecanOnWire, "tecan", world, port, pace=PACE) as device:
        yield device


def spectra(result: Attachment | str) -> dict[str, list[float]]:
    """Optical densities by well."""
    assert isinstance(result, Attachment)
    assert isinstance(result.content, bytes)
    head, *lines = result.content.decode("utf-16-le").splitlines()
    assert head.startswith("*\t")
    return {well: [float(od) for od in told] for well, *told in (line.split("\t") for line in lines)}


# -- frames ------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "packed"),
    [
        ("A", "02 41 03 00 00 01 40 0d"),
        ("QQ", "02 51 51 03 00 00 02 01 0d"),
        ("MODE ABS", "02 4d 4f 44 45 20 41 42 53 03 00 00 08 72 0d"),
    ],
)
def test_questions_as_they_are_on_the_wire(text: str, packed: str) -> None:
    assert frame(text) == bytes.fromhex(packed)


def test_texts_and_numbers_come_in_any_pieces() -> None:
    calibration = protocol.write_calibration(450.0, Calibration(100, 50100, 80, 40080))
    measured = protocol.write_measurement(450.0, 0x0D02, 0x0D03)
    said = frame("ST") + b"".join(
        frame(f"{len(packet)},BIN:") + packet + bytes(4) for packet in (calibration, measured)
    )
    said += b"\x1b" + bytes(protocol.STATUS_SIZE - 1) + frame("ST")
    for size in (1, 2, 3, 7, len(said)):
        frames, buffer, taken = Frames(), bytearray(), []
        for at in range(0, len(said), size):
            buffer += said[at : at + size]
            while (message := frames.take(buffer)) is not None:
                taken.append(message)
        assert taken == [b"ST", b"\0" + calibration, b"\0" + measured, b"ST"], size
    assert protocol.is_calibration(calibration)
    assert protocol.is_measurement(measured)
    assert protocol.read_measurement(measured) == (450.0, [(0x0D02, 0x0D03)])


def test_noise_is_no_text() -> None:
    with pytest.raises(BadFrame, match="check sum"):
        Frames().take(bytearray(b"\x02SU\x03\x00\x00\x02\x06\x0d"))
    with pytest.raises(BadFrame, match="does not begin"):
        Frames().take(bytearray(b"ST" + frame("ST")))
    with pytest.raises(BadFrame, match="is no text"):
        Frames().take(bytearray(b"\x02S\xff\x03\x01\x00\x00\x00\x0d"))


def test_optical_densities() -> None:
    told = Calibration(100, 50100, 80, 40080)
    assert protocol.optical_density(told, [(50100, 40080)]) == 0.0
    assert protocol.optical_density(told, [(5100, 40080)]) == 1.0
    assert protocol.optical_density(told, [(5100, 40080), (5100, 40080)]) == 1.0
    assert protocol.optical_density(told, [(100, 40080)]) == 4.0
    with pytest.raises(ValueError, match="no light"):
        protocol.optical_density(told, [(100, 80)])
    with pytest.raises(ValueError, match="no light"):
        protocol.optical_density(told._replace(bright=100), [(100, 40080)])


# -- the device --------------------------------------------------------------------------------


def test_a_plate_is_measured(reader: TecanOnWire, world: World, port: Path) -> None:
    (plate,) = world.stock("tecan.default", "plate96")

    async def body() -> None:
        node = at_port(Tecan, "tecan", port)
        await node.connect()
        assert await node.observe() == {"gate": "open"}
        with pytest.raises(DeviceError, match="the gate is open") as told:
            await node.measure_sample()
        assert told.value.effects == "none"
        await node.close_gate()
        assert await node.observe() == {"gate": "closed", "labware": {"default": True}}
        result = await node.measure_sample(start=400.0, end=450.0, step=25.0, tecan_iteration=3)
        assert isinstance(result, Attachment)
        assert result.name == "tecan_3.asc"
        found = spectra(result)
        assert len(found) == 96
        for well in ("A1", "A12", "B1", "B12", "H12"):
            real = [absorbance(plate, well, nm) for nm in (400.0, 425.0, 450.0)]
            assert found[well] == pytest.approx(real, abs=0.02)
        assert await node.is_idle()
        await node.open_gate()
        assert not world.is_shut("tecan.default")
        await node.close()

    run(body)
    assert len(world.motions("read")) == 3 * 8
    assert {motion.plate for motion in world.motions("read")} == {plate}


def test_384_wells(reader: TecanOnWire, world: World, port: Path) -> None:
    (plate,) = world.stock("tecan.default", "plate384")

    async def body() -> None:
        node = at_port(Tecan, "tecan", port)
        await node.connect()
        await node.close_gate()
        found = spectra(await node.measure_sample(start=600.0, end=600.0, wells=384))
        assert len(found) == 384
        assert found["P24"] == pytest.approx([absorbance(plate, "P24", 600.0)], abs=0.02)
        await node.close()

    run(body)


def test_what_cannot_be_done_moves_nothing(reader: TecanOnWire, world: World, port: Path) -> None:
    async def body() -> None:
        node = at_port(Tecan, "tecan", port)
        await node.connect()
        await node.close_gate()
        with pytest.raises(DeviceError, match="no plate is on the carrier") as empty:
            await node.measure_sample()
        with pytest.raises(DeviceError, match="no stored methods") as method:
            await node.measure_sample("ECP-350-800")
        with pytest.raises(DeviceError, match="lies behind") as backwards:
            await node.measure_sample(start=500, end=400)
        with pytest.raises(DeviceError, match="are more than 800") as many:
            await node.measure_sample(start=230, end=1000, step=0.1)
        assert {told.value.effects for told in (empty, method, backwards, many)} == {"none"}
        await node.close()

    run(body)
    assert world.motions("read") == []


def test_no_light_and_a_refusal(reader: TecanOnWire, world: World, port: Path) -> None:
    world.stock("tecan.default", "plate96")

    async def body() -> None:
        node = at_port(Tecan, "tecan", port)
        await node.connect()
        await node.close_gate()
        reader.lamp_dead = True
        with pytest.raises(DeviceError, match="the lamp gave no light at 500 nm"):
            await node.measure_sample(start=500, end=500)
        reader.lamp_dead = False
        reader.refuses = True
        with pytest.raises(DeviceError, match=r"refuses 'ABSOLUTE MTP,OUT' \(-\)") as told:
            await node.open_gate()
        assert told.value.effects == "none"
        reader.refuses = False
        await node.reset()
        assert (await node.observe())["gate"] == "open"
        await node.close()

    run(body)


def test_stopped_between_two_rows(world: World, port: Path) -> None:
    world.stock("tecan.default", "plate96")

    async def body() -> None:
        node = at_port(Tecan, "tecan", port)
        await node.connect()
        await node.close_gate()
        work = asyncio.create_task(node.measure_sample())
        await until(lambda: bool(world.motions("read")))
        await node.stop()
        with pytest.raises(DeviceError, match="was stopped") as told:
            await work
        assert told.value.effects == "unknown"
        with pytest.raises(DeviceError, match="was stopped"):
            await node.open_gate()
        await node.reset()
        await node.close_gate()
        await node.close()

    with power_on(TecanOnWire, "tecan", world, port, pace=400):
        run(body)
    assert 0 < len(world.motions("read")) < 100


def test_a_carrier_that_jams(
    reader: TecanOnWire, world: World, port: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tecan_driver, "GATE_S", 1.0)

    async def body() -> None:
        node = at_port(Tecan, "tecan", port)
        await node.connect()
        reader.jammed = True
        with pytest.raises(LinkError) as told:
            await node.close_gate()
        assert told.value.effects == "unknown"
        assert not await node.is_idle()
        assert await node.observe() == {}
        await node.close()

    run(body)


def test_unplugged_in_mid_scan(world: World, port: Path) -> None:
    world.stock("tecan.default", "plate96")

    async def body(device: TecanOnWire) -> None:
        node = at_port(Tecan, "tecan", port)
        await node.connect()
        await node.close_gate()
        work = asyncio.create_task(node.measure_sample())
        await until(lambda: bool(world.motions("read")))
        device.end.unplug()
        with pytest.raises(LinkError) as told:
            await work
        assert told.value.effects == "unknown"
        with pytest.raises(NotConnected):
            await node.open_gate()
        await node.close()

    with power_on(TecanOnWire, "tecan", world, port, pace=400) as device:
        run(lambda: body(device))


def test_another_device(port: Path) -> None:
    with answer_on(PtyEnd(port), {b"": frame("HELLO")}, stop=frame("QQ")), pytest.raises(WrongDevice):
        run(at_port(Tecan, "tecan", port).connect)


def test_an_end_before_the_start_is_no_measurement() -> None:
    assert protocol.list_wavelengths(500, 499.5, 1) == []
    assert protocol.list_wavelengths(500, 500, 1) == [500.0]


def test_numbers_of_another_wavelength(reader: TecanOnWire, world: World, port: Path) -> None:
    world.stock("tecan.default", "plate96")
    said = reader._numbers

    def other(packet: bytes) -> None:
        said(packet if protocol.is_calibration(packet) else protocol.write_measurement(333.0, 9000, 40080))

    reader._numbers = other  # type: ignore[method-assign]

    async def body() -> None:
        node = at_port(Tecan, "tecan", port)
        await node.connect()
        await node.close_gate()
        with pytest.raises(Garbled, match="measured at 333 nm, not at 500 nm"):
            await node.measure_sample(start=500, end=500)
        await node.close()

    run(body)


def test_simulated_behind_its_wire(world: World) -> None:
    world.stock("tecan.default", "plate96")

    async def body() -> None:
        node = Tecan(Setup(name="tecan", workcell="rpl", world=world, pace=PACE, wire=True))
        await node.connect()
        await node.close_gate()
        assert len(spectra(await node.measure_sample(start=700, end=700))) == 96
        await node.close()

    run(body)


# -- behind pyusb ------------------------------------------------------------------------------


def usb_bus() -> Any:
    pytest.importorskip("usb", reason="pyusb is not installed (it is with the extra `usb`)")
    from tests.drivers.test_usb_wire import UsbBus

    return UsbBus(protocol.USB_VENDOR, protocol.USB_PRODUCT)


def test_at_its_bulk_endpoints(world: World, monkeypatch: pytest.MonkeyPatch) -> None:
    bus = usb_bus()
    monkeypatch.setattr(tecan_driver, "UsbWire", lambda *ids, **more: UsbWire(*ids, **more, backend=bus))
    (plate,) = world.stock("tecan.default", "plate96")
    device = TecanOnWire(setup_of("tecan", world, PACE), bus)
    device.start()

    async def body() -> None:
        node = Tecan(setup_of("tecan", None, 1.0, config={"port": "usb"}))
        await node.connect()
        await node.close_gate()
        found = spectra(await node.measure_sample(start=500, end=500))
        assert found["D6"] == pytest.approx([absorbance(plate, "D6", 500.0)], abs=0.02)
        bus.unplug()
        with pytest.raises(LinkError):
            await node.open_gate()
        await node.close()

    try:
        run(body)
    finally:
        device.close()


# It writes what it hears into a transcript of its own, as text, which numbers are not.
@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_pylabrobots_driver_opens_closes_and_reads(world: World, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("pylabrobot", reason="PyLabRobot is not installed (it is with the extra `test`)")
    libusb = pytest.importorskip("libusb_package", reason="PyLabRobot's extra `usb` is not installed")
    import usb.core
    from pylabrobot.plate_reading.tecan.infinite_backend import ExperimentalTecanInfinite200ProBackend
    from pylabrobot.resources import cor_96_wellplate_360uL_Fb

    bus = usb_bus()
    monkeypatch.setattr(libusb, "find", lambda **wanted: usb.core.find(backend=bus, **wanted))
    (plate,) = world.stock("tecan.default", "plate96")
    device = TecanOnWire(setup_of("tecan", world, 500.0), bus)
    device.start()

    async def body() -> list[list[float]]:
        backend = ExperimentalTecanInfinite200ProBackend()
        backend.io.packet_read_timeout = 1
        await backend.setup()
        await backend.open()
        await until(lambda: device.position == protocol.OUT)
        await backend.close(None)
        await until(lambda: device.position == protocol.IN)
        wells = cor_96_wellplate_360uL_Fb("plate")
        (read,) = await backend.read_absorbance(wells, wells.get_all_items(), wavelength=500)
        await backend.stop()
        return list(read["data"])

    try:
        read = run(body)
    finally:
        device.close()
    for row, column, well in ((0, 0, "A1"), (0, 11, "A12"), (1, 0, "B1"), (7, 11, "H12")):
        assert read[row][column] == pytest.approx(absorbance(plate, well, 500.0), abs=0.02)
    assert len(world.motions("read")) == 8


@pytest.mark.full
@pytest.mark.timeout(600)
def test_torture_in_the_midst_of_a_measurement() -> None:
    """Nothing that it sees tells how far a measurement has come: the badge rests on its carrier."""
    report = asyncio.run(torture(str(Path(__file__).with_name("tecan_measuring.py"))))
    assert (report.badge, [f for f in report.findings if f.verdict == "failed"]) == ("silver", [])


def test_a_carrier_that_is_not_known_to_be_in_is_not_moved_over(
    reader: TecanOnWire, world: World, port: Path
) -> None:
    world.stock("tecan.default", "plate")

    async def body() -> None:
        node = at_port(Tecan, "tecan", port)
        await node.connect()
        await node.close_gate()
        reader.position = "UNDEFINED"
        assert await node.observe() == {}
        with pytest.raises(DeviceError, match="its carrier is 'UNDEFINED', not IN") as told:
            await node.measure_sample(start=450, end=450)
        assert told.value.effects == "none"
        await node.close()

    run(body)
    assert world.motions("read") == []

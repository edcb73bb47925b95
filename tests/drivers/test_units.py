"""Which unit answers: a device is bound to its serial number, and a swapped one is refused."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

from labos.cli.app import group
from labos.errors import DeviceError, WrongDevice
from labos.node import World
from labos.node.unit import check_unit, keep_unit, read_known_unit
from labos.settings import Settings
from labos_drivers.axis import Axis
from labos_drivers.axis.wire import DriveOnSlcan
from labos_drivers.biometra import Biometra
from labos_drivers.biometra.wire import BiometraOnWire
from labos_drivers.brooks_peeler import BrooksPeeler
from labos_drivers.brooks_peeler.wire import PeelerOnWire
from labos_drivers.hidex import Hidex
from labos_drivers.hidex.wire import HidexOnWire
from labos_drivers.inheco import Inheco
from labos_drivers.inheco.wire import InhecoOnWire
from labos_drivers.mir import MiR
from labos_drivers.mir.wire import MiROnWire
from labos_drivers.ot2 import OT2
from labos_drivers.ot2.wire import OT2OnWire
from labos_drivers.pf400 import PF400
from labos_drivers.pf400.wire import PF400OnWire
from labos_drivers.ur import UR
from labos_drivers.ur.wire import UROnWire
from tests.drivers.wires import at_port, power_on, run, setup_of

DEVICES: list[tuple[Any, Any, str, dict[str, Any]]] = [
    (OT2, OT2OnWire, "url", {}),
    (MiR, MiROnWire, "url", {}),
    (PF400, PF400OnWire, "host", {}),
    (UR, UROnWire, "host", {"rtde": False}),
    (Inheco, InhecoOnWire, "port", {}),
    (Biometra, BiometraOnWire, "url", {}),
    (Hidex, HidexOnWire, "url", {}),
]


@pytest.mark.parametrize(
    ("driver", "wire", "key", "config"), DEVICES, ids=lambda each: getattr(each, "__name__", "")
)
def test_a_swapped_device_is_refused(
    driver: Any, wire: Any, key: str, config: dict[str, Any], world: World, tmp_path: Path
) -> None:
    unit = tmp_path / "rpl.it.unit"

    async def connect(device: Any, **more: Any) -> None:
        told = {"config": {**config, **more}, "unit_file": str(unit)}
        node = at_port(driver, "it", device.address, key=key, **told)
        try:
            await node.connect()
        finally:
            await node.close()

    with power_on(wire, "it", world) as device:
        first = device.serial
        run(lambda: connect(device))
        assert read_known_unit(unit) == first
        run(lambda: connect(device))
        device.serial = "ANOTHER.1"
        with pytest.raises(WrongDevice) as caught:
            run(lambda: connect(device))
        words = str(caught.value)
        assert f"{first} was expected, but ANOTHER.1 answers" in words
        assert "`labos node accept-unit rpl/it ANOTHER.1`" in words
        assert caught.value.effects == "none"
        keep_unit(unit, "ANOTHER.1")
        run(lambda: connect(device))
        with pytest.raises(WrongDevice, match=r"write `serial: ANOTHER.1` for rpl/it in the workcell file"):
            run(lambda: connect(device, serial=first))


@pytest.mark.parametrize(
    ("driver", "wire", "key", "config", "version"),
    [
        (OT2, OT2OnWire, "url", {}, "8.1.0"),
        (PF400, PF400OnWire, "host", {}, "TCS 3.0D4"),
        (UR, UROnWire, "host", {"rtde": False}, "URSoftware 5.12.2.1101534 (Jul 06 2022)"),
        (BrooksPeeler, PeelerOnWire, "port", {}, "1.4"),
        (Biometra, BiometraOnWire, "url", {}, "1.7"),
    ],
    ids=lambda each: getattr(each, "__name__", ""),
)
def test_a_device_tells_its_firmware(
    driver: Any, wire: Any, key: str, config: dict[str, Any], version: str, world: World
) -> None:
    async def main(device: Any) -> None:
        node = at_port(driver, "it", device.address, key=key, config=config)
        assert node.setup.firmware == ""
        try:
            await node.connect()
            assert node.setup.firmware == version
        finally:
            await node.close()

    with power_on(wire, "it", world) as device:
        run(lambda: main(device))


def test_a_swapped_drive_is_refused(world: World, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """By the identity object of CiA 301; a drive that has no number there is not bound."""
    unit = tmp_path / "rpl.stage.unit"

    async def connect(device: DriveOnSlcan) -> None:
        told = {"interface": "slcan", "channel": device.address, "bus": {"sleep_after_open": 0}}
        setup = setup_of("stage", None, 1.0, config=told, unit_file=str(unit))
        node = Axis.for_config(told)(setup)
        try:
            await node.connect()
        finally:
            await node.close()

    for serial in (0, 7001, 7002):
        monkeypatch.setattr(DriveOnSlcan, "serial", serial)
        with power_on(DriveOnSlcan, "stage", world) as device:
            if serial < 7002:
                run(partial(connect, device))
                assert unit.exists() == bool(serial)
                continue
            with pytest.raises(WrongDevice, match="7001 was expected, but 7002 answers"):
                run(partial(connect, device))


def test_a_unit_that_tells_nothing_is_refused_only_where_one_is_expected(tmp_path: Path) -> None:
    file = tmp_path / "unit"
    setup = setup_of("it", None, unit_file=str(file))
    check_unit(setup, None)
    assert not file.exists()
    check_unit(setup, 2010)
    with pytest.raises(
        WrongDevice, match=r"2010 was expected, but the connected device reports no serial number"
    ):
        check_unit(setup, "")
    file.write_text("half a rec")
    with pytest.raises(DeviceError, match=r"cannot be read .* remove the file"):
        check_unit(setup, 2010)


def test_a_simulated_device_is_not_bound(world: World, tmp_path: Path) -> None:
    file = tmp_path / "unit"
    check_unit(setup_of("it", world, config={"serial": "REAL"}, unit_file=str(file)), "SIMULATED")
    assert not file.exists()


def test_another_unit_is_accepted_by_a_command(tmp_path: Path) -> None:
    settings = Settings.make(str(tmp_path))
    settings.journals.mkdir()
    settings.journal("rpl/it").touch()
    setup = setup_of("it", None, unit_file=str(settings.unit("rpl/it")))
    check_unit(setup, "A1")
    said = CliRunner().invoke(group, ["node", "accept-unit", "rpl/it", "B2", "--home", str(tmp_path)])
    assert said.output == "rpl/it: B2 is accepted (it was A1). Reset the module.\n"
    check_unit(setup, "B2")
    CliRunner().invoke(group, ["node", "accept-unit", "rpl/it", "--home", str(tmp_path)])
    check_unit(setup, "C3")
    with pytest.raises(WrongDevice):
        check_unit(setup, "B2")

"""Drivers are found by name, file and folder, and one name means one class."""

from __future__ import annotations

import asyncio
import json
from pathlib import Path

import pytest

from labos.bootstrap import load_driver, load_drivers
from labos.cli.app import main
from labos.errors import BadInput, DeviceError
from labos.node import Node, Setup, World
from labos.spec.workcell import validate_workcell
from labos.torture import find_declaration, torture
from tests.support.lab_process import labos

OTHER = """
from labos.node import Node


class Stirrer(Node):
    '''Another one of that name.'''

    driver = {name!r}
"""


def install(folder: Path, package: str, name: str, value: str = "") -> None:
    """What an installer leaves behind: a module, and the list of what the package offers."""
    folder.mkdir(exist_ok=True)
    (folder / f"{package}.py").write_text(OTHER.format(name=name), "utf-8")
    info = folder / f"{package}-0.3.dist-info"
    info.mkdir()
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {package}\nVersion: 0.3\n", "utf-8")
    entry = f"[labos.drivers]\n{name} = {value or f'{package}:Stirrer'}\n"
    (info / "entry_points.txt").write_text(entry, "utf-8")


def test_a_name_that_two_packages_use_is_refused_wherever_it_is_asked_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    install(tmp_path, "rival_sealers", "a4s_sealer")
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(BadInput) as refused:
        load_driver("a4s_sealer")
    told = str(refused.value)
    assert "2 packages install a driver named 'a4s_sealer'" in told
    assert "labos-sdl" in told
    assert "rival_sealers 0.3 (rival_sealers:Stirrer)" in told
    assert "Uninstall one of them" in told
    found = load_drivers()
    assert "a4s_sealer" not in found.classes
    assert found.broken == {"a4s_sealer": told}
    assert load_driver("pf400") is found.classes["pf400"]
    cell = tmp_path / "cell.yaml"
    for key in ("driver: a4s_sealer", "model: a4s_sealer"):
        cell.write_text(f"labos: 1\nname: c\nmodules:\n  - {{name: sealer, {key}}}\n", "utf-8")
        (finding,) = [f for f in validate_workcell(cell, found.make_descriptions()) if f.severity == "error"]
        assert "cannot be used" in finding.message
        assert "rival_sealers" in finding.remedy


def test_a_class_that_is_listed_twice_is_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    install(tmp_path, "labos_before_it_was_renamed", "tecan", "labos_drivers.tecan:Tecan")
    monkeypatch.syspath_prepend(tmp_path)
    assert load_driver("tecan") is load_drivers().classes["tecan"]


def test_a_new_driver_takes_no_name_that_is_installed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["driver", "new", str(tmp_path / "tecan")]) == 1
    told = capsys.readouterr().err
    assert "A driver 'tecan' is already installed, by labos-sdl" in told
    assert not (tmp_path / "tecan").exists()


def test_what_a_file_in_a_package_needs_is_found_beside_it(tmp_path: Path) -> None:
    assert main(["driver", "new", str(tmp_path / "oat_heater")]) == 0
    node = load_driver(str(tmp_path / "oat_heater" / "labos_oat_heater" / "interface.py"))
    assert (node.__module__, node.driver) == ("labos_oat_heater.interface", "oat_heater")
    told = find_declaration(node)
    assert told.device is not None
    assert [case.action for case in told.cases] == ["work"]
    assert load_driver(str(tmp_path / "oat_heater" / "labos_oat_heater" / "interface.py")) is node


def test_what_a_file_alone_needs_is_found_beside_it(tmp_path: Path) -> None:
    (tmp_path / "lone_stirrer.py").write_text(OTHER.format(name="lone"), "utf-8")
    (tmp_path / "torture.py").write_text(
        "from labos.node import Torture\n\nTORTURE = Torture(left_out={'stop': 'it has none'})\n", "utf-8"
    )
    assert find_declaration(load_driver(str(tmp_path / "lone_stirrer.py"))).left_out == {
        "stop": "it has none"
    }


def test_a_file_whose_package_bears_a_loaded_name_is_not_mistaken_for_it(tmp_path: Path) -> None:
    folder = tmp_path / "labos_drivers" / "tecan"
    folder.mkdir(parents=True)
    for path in (folder.parent / "__init__.py", folder / "__init__.py"):
        path.touch()
    (folder / "interface.py").write_text(OTHER.format(name="tecan"), "utf-8")
    with pytest.raises(
        BadInput, match=r"as labos_drivers\.tecan\.interface: .* is already loaded with that name"
    ):
        load_driver(str(folder / "interface.py"))


@pytest.mark.timeout(120)
@pytest.mark.slow
def test_a_new_driver_is_tortured_by_its_file(tmp_path: Path) -> None:
    assert labos("driver", "new", str(tmp_path / "oat_cooker")).returncode == 0
    done = labos(
        *("driver", "torture", str(tmp_path / "oat_cooker" / "labos_oat_cooker" / "interface.py")),
        *("--check", "unplugged before", "--motion-s", "0.6", "--json"),
        timeout_s=100,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    findings = {f["check"]: f["verdict"] for f in json.loads(done.stdout)["findings"]}
    assert (findings["happy path"], findings["unplugged before"]) == ("passed", "passed")


def new_driver(folder: Path, name: str) -> type[Node]:
    assert main(["driver", "new", str(folder / name)]) == 0
    return load_driver(str(folder / name / f"labos_{name}" / "interface.py"))


def test_a_new_driver_says_what_its_configuration_lacks(tmp_path: Path) -> None:
    node = new_driver(tmp_path, "oat_mill")(Setup("mill", "corner"))
    with pytest.raises(DeviceError, match=r"mill: its configuration has no 'port'") as refused:
        asyncio.run(node.connect())
    assert refused.value.effects == "none"
    assert "`config: {port: /dev/serial/by-id/…}` for mill" in refused.value.remedy


def test_a_new_driver_does_not_touch_the_instrument_in_a_simulated_lab(tmp_path: Path) -> None:
    kind, world = new_driver(tmp_path, "oat_sieve"), World()
    world.stock("sieve.nest", "plate")

    async def body() -> None:
        setup = Setup("sieve", "corner", {"port": str(tmp_path / "the instrument")}, world=world, pace=100.0)
        node = kind(setup)
        await node.connect()
        assert await node.observe() == {"labware": {"nest": True}}
        await node.close()
        await node.connect()
        assert await node.is_idle()
        await node.close()

    asyncio.run(body())


def test_people_have_no_badge() -> None:
    with pytest.raises(BadInput, match="operator has no badge: a person carries out all its actions"):
        asyncio.run(torture("operator"))

"""The tool changer of the pendant drop, as the UR arm's page maps it: a real IOC over Channel Access locks
and unlocks it, between two moves of a simulated controller over TCP."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from labos.bootstrap import descriptions
from labos.core.effects import Sets
from labos.errors import DeviceError
from labos.node import World
from labos.spec.about import find_description
from labos.spec.workcell import parse_workcell
from labos_drivers.ur import UR
from labos_drivers.ur import driver as ur_driver
from labos_drivers.ur.wire import UROnWire
from tests.docs.markdown import DOCS, blocks
from tests.drivers.wires import at_port, power_on
from tests.integration.adapter.bench import Bench
from tests.integration.adapter.scenario import play
from tests.support.ioc import Ioc
from tests.support.needed import need

need("aioca", "epics")

run = partial(play, limit_s=110.0)
(PAGE,) = (b for b in blocks((DOCS / "drivers" / "ur.md").read_text("utf-8")) if b.title == "pendant.yaml")


@pytest.fixture(scope="module")
def ioc(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Ioc]:
    device = Ioc(tmp_path_factory.mktemp("epics"))
    try:
        yield device.start()
    finally:
        device.kill()


async def changer(here: Bench, ioc: Ioc) -> None:
    known = descriptions()
    cell = parse_workcell(PAGE.text, known).workcell
    (module,) = (m for m in cell.modules if m.name.endswith("changer"))
    about = find_description(module, known)
    assert about is not None
    assert [e for spec in about.actions for e in spec.effects if isinstance(e, Sets)]
    mapping = module.config["config"]["epics"]
    await here.process("epics_node", about, **{**ioc.config, "patience_s": 20.0}, epics=mapping)
    await here.idle()


def arm_config() -> dict[str, Any]:
    (module,) = (m for m in parse_workcell(PAGE.text, descriptions()).workcell.modules if m.driver == "ur")
    return {key: value for key, value in module.config["config"].items() if key != "host"}


def test_the_pipette_is_fetched_and_put_back(
    ioc: Ioc, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(ur_driver, "POLL_S", 0.005)
    world = World()

    async def scenario(here: Bench, device: UROnWire) -> None:
        await changer(here, ioc)
        arm = at_port(UR, "ur3", device.address, key="host", config=arm_config())
        await arm.connect()

        async def turn(action: str, name: str, bolt: str) -> None:
            await here.start(action, name)
            done = await here.outcome(action)
            assert (done.succeeded, done.effects) == (True, "all")
            assert (await here.kernel.admin("observe")).result == {"bolt": bolt}

        empty = {"labware": {"gripper": False}}
        await arm.dock()
        assert await arm.observe() == {**empty, "docked": True, "tool": ""}
        await turn("a1", "lock", "Locked")
        await arm.undock("pipette")
        assert await arm.observe() == {**empty, "docked": False, "tool": "pipette"}
        with pytest.raises(DeviceError, match="its docked is false; undock needs true") as away:
            await arm.undock("")
        assert away.value.effects == "none"
        await arm.dock()
        await turn("a2", "unlock", "Unlocked")
        await arm.undock("")
        assert await arm.observe() == {**empty, "docked": False, "tool": ""}
        # Told again, nothing is done again.
        assert (await here.start("a2", "unlock")).status == "finished"
        assert [len(ioc.truth(what)) for what in ("lock", "locked", "unlock", "unlocked")] == [1, 1, 1, 1]
        await arm.close()

    with power_on(UROnWire, "ur3", world, told={"config": arm_config()}, pace=200) as device:
        run(tmp_path, lambda here: scenario(here, device))
    assert [m.verb for m in world.motions() if "dock" in m.verb] == ["dock", "undock", "dock", "undock"]
    assert world.crashes() == []
    world.close()


@pytest.mark.full
def test_a_bolt_that_stays_is_told(ioc: Ioc, tmp_path: Path) -> None:
    """Without air the variable is written and nothing moves: what counts is the sensor."""

    async def scenario(here: Bench) -> None:
        air = {"start": {"pv": "Air", "value": 0}}
        known = descriptions()
        (module,) = (m for m in parse_workcell(PAGE.text, known).workcell.modules if m.driver != "ur")
        about = find_description(module, known)
        assert about is not None
        mapping = {**module.config["config"]["epics"]}
        lock = {**mapping["actions"]["lock"], "timeout": 1.0}
        mapping["actions"] = {"unlock": air, "lock": lock}
        await here.process("epics_node", about, **{**ioc.config, "patience_s": 20.0}, epics=mapping)
        await here.idle()
        before = len(ioc.truth("locked"))
        await here.start("a1", "unlock")  # switches the air off
        assert (await here.outcome("a1")).succeeded
        await here.start("a2", "lock")
        stuck = await here.status("a2", "interrupted")  # whether it is locked is asked of a person
        assert "did not end within 1 s" in stuck.why
        assert len(ioc.truth("locked")) == before

    run(tmp_path, scenario)

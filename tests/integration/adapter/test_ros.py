"""The adapter of ROS 2 nodes, with a real node of ``rclpy`` 9.1.2 (ROS Kilted) in a process of its own."""

from __future__ import annotations

import asyncio
import json
import os
import struct
import zlib
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import pytest
import yaml

from labos.adapter import describe_foreign
from labos.adapter._png import encode_png
from labos.core.model import ActionSpec, Arg, Description
from labos.errors import DeviceError
from labos.node.server import NodeServer
from tests.integration.adapter.bench import Bench
from tests.integration.adapter.scenario import LABEL, SPEED, TIME, play
from tests.integration.bus.contract import until
from tests.support.lab_process import labos
from tests.support.ros import NODE, SERVICE, WEI, RosProcess

run = partial(play, limit_s=110.0)
SHAKE = ActionSpec(name="shake", args=(SPEED, TIME, LABEL))
GROW = ActionSpec(name="grow", args=(Arg(name="order", type="int"),))
JAM = ActionSpec(name="jam")
DESCRIPTION = Description(driver="ros", version="", description="", actions=(SHAKE, JAM))
GROWING = Description(driver="ros", version="", description="", actions=(GROW,))
CAMERA = Description(driver="ros", version="", description="", actions=(ActionSpec(name="take_picture"),))

GOAL = {
    "actions": {
        "grow": {
            "action": f"{NODE}/grow",
            "type": "test_msgs/action/Fibonacci",
            "fields": {"order": "{order}"},
            "result": "sequence",
        }
    },
    "state": {"topic": f"{NODE}/state"},
}


@pytest.fixture(scope="module")
def foreign(tmp_path_factory: pytest.TempPathFactory) -> Iterator[RosProcess]:
    process = RosProcess("ros", tmp_path_factory.mktemp("ros"), 20 + os.getpid() % 80)
    try:
        yield process.start()
    finally:
        process.kill()


@pytest.fixture(autouse=True)
def on_loopback(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")


async def wei(here: Bench, foreign: RosProcess, **told: Any) -> NodeServer:
    server = await here.adapter("wei_ros_node", DESCRIPTION, **foreign.config, ros=WEI, **told)
    await here.idle()
    return server


async def bridge_of(server: NodeServer) -> Any:
    return server.node.bridge._process  # type: ignore[attr-defined]


@pytest.mark.full
def test_services_state_and_reset(foreign: RosProcess, tmp_path: Path) -> None:
    async def scenario(here: Bench) -> None:
        await wei(here, foreign)
        await here.start("a1", "shake", speed=300, label="everyday")
        done = await here.outcome("a1")
        assert (done.succeeded, done.effects, done.result) == (True, "all", "shaken")
        assert foreign.truth("shake")[-1] == {
            "what": "shake",
            "speed": 300,
            "time_s": 0.2,
            "label": "everyday",
        }
        assert (await here.start("a1", "shake", speed=300, label="everyday")).outcome == done
        await here.start("a2", "jam")
        failed = await here.outcome("a2")
        assert (failed.succeeded, failed.effects) == (False, "unknown")
        assert "The plate is stuck." in failed.error
        assert (await here.kernel.recover("a3")).succeeded
        await here.idle()
        assert len(foreign.truth("shake", label="everyday")) == 1

    run(tmp_path, scenario)


@pytest.mark.full
def test_a_goal_and_a_picture(foreign: RosProcess, tmp_path: Path) -> None:
    async def scenario(here: Bench) -> None:
        first = await here.adapter("ros_node", GROWING, **foreign.config, ros=GOAL)
        await here.idle()
        await here.start("a1", "grow", order=4)
        assert (await here.outcome("a1")).result == [0, 1, 2, 3]
        await here.start("a2", "grow", order=13)
        failed = await here.outcome("a2")
        assert (failed.succeeded, failed.effects) == (False, "unknown")
        assert "the goal was aborted" in failed.error
        assert [told["order"] for told in foreign.truth("grow")] == [4, 13]
        await first.close()
        await here.await_node_gone()
        await here.adapter("wei_ros_camera", CAMERA, **foreign.config)
        await here.idle()
        await here.start("a3", "take_picture")
        (image,) = (await here.outcome("a3")).result["files"].values()
        assert here.blobs.get(image["sha256"]) == encode_png(
            bytes([3, 2, 1, 6, 5, 4]), width=2, height=1, encoding="rgb8", step=6
        )

    run(tmp_path, scenario)


@pytest.mark.full
def test_it_says_what_it_offers(foreign: RosProcess) -> None:
    settings = [f"{key}={json.dumps(value)}" for key, value in {**foreign.config, "ros": WEI}.items()]
    options = [word for setting in settings for word in ("--config", setting)]
    said = labos("node", "about", "wei_ros_node", NODE, *options)
    assert said.returncode == 0, said.stderr
    assert list(yaml.safe_load(said.stdout)["about"]["actions"]) == ["shake", "jam"]
    described = asyncio.run(describe_foreign("wei_ros_node", {**foreign.config, "ros": WEI}))
    assert [action.name for action in described.actions] == ["shake", "jam"]


@pytest.mark.full
def test_a_node_that_is_not_there_is_an_error_and_moves_nothing(foreign: RosProcess, tmp_path: Path) -> None:
    async def scenario(here: Bench) -> None:
        nowhere = {**WEI, "action": {**SERVICE, "service": "/nobody/action_handler"}}
        await here.adapter("wei_ros_node", DESCRIPTION, **foreign.config, ros=nowhere)
        await here.in_error("does not answer in ROS")

    run(tmp_path, scenario)


@pytest.mark.full
@pytest.mark.timeout(200)
@pytest.mark.parametrize("action", ["shake", "grow"])
def test_the_node_is_killed_in_mid_action(tmp_path: Path, action: str) -> None:
    """And started again at once: nobody knows, and nothing is done twice."""
    foreign = RosProcess("ros", tmp_path / "ros", 110 + os.getpid() % 40).start()
    args = {"speed": 5, "time_s": 30.0, "label": "died"} if action == "shake" else {"order": 300}

    async def scenario(here: Bench) -> None:
        if action == "shake":
            await wei(here, foreign, patience_s=60.0)
        else:
            await here.adapter("ros_node", GROWING, **{**foreign.config, "patience_s": 60.0}, ros=GOAL)
            await here.idle()
        await here.start("a1", action, **args)
        await until(lambda: len(foreign.truth(action)) == 1, 20)
        await asyncio.sleep(0.5)  # it is seen to be busy
        foreign.kill()
        foreign.start()
        told = await here.status("a1", "interrupted", 60)
        assert "keeps no record" in told.why or "does not know the goal" in told.why
        await here.idle(60)
        assert (await here.start("a1", action, **args)).status == "interrupted"
        again = {**args, "time_s": 0.0} if action == "shake" else {"order": 1}
        await here.start("a2", action, **again)
        assert (await here.outcome("a2", 30)).succeeded
        assert len(foreign.truth(action)) == 2

    try:
        run(tmp_path, scenario)
    finally:
        foreign.kill()


@pytest.mark.full
@pytest.mark.parametrize("action", ["shake", "grow"])
def test_the_bridge_is_killed_in_mid_action(foreign: RosProcess, tmp_path: Path, action: str) -> None:
    """A service's answer is lost with it; a goal's result is asked for again."""

    def has_begun() -> bool:
        """Once, and only once."""
        which = {"label": "bridge"} if action == "shake" else {"order": 31}
        return len(foreign.truth(action, **which)) == 1

    async def scenario(here: Bench) -> None:
        if action == "shake":
            server = await wei(here, foreign)
            await here.start("a31", "shake", speed=2, time_s=3.0, label="bridge")
        else:
            server = await here.adapter(
                "ros_node", GROWING, **{**foreign.config, "patience_s": 30.0}, ros=GOAL
            )
            await here.idle()
            await here.start("a31", "grow", order=31)
        await until(has_begun, 20)
        (await bridge_of(server)).kill()
        if action == "shake":
            assert "bridge to ROS ended" in (await here.status("a31", "interrupted")).why
        else:
            assert (await here.outcome("a31", 40)).result == list(range(31))
        await here.idle(30)
        assert has_begun()

    run(tmp_path, scenario)


@pytest.mark.full
@pytest.mark.parametrize("action", ["shake", "grow"])
def test_the_adapter_is_killed_in_mid_action(foreign: RosProcess, tmp_path: Path, action: str) -> None:
    interface, description = ("wei_ros_node", DESCRIPTION) if action == "shake" else ("ros_node", GROWING)
    config = {**foreign.config, "patience_s": 30.0, "ros": WEI if action == "shake" else GOAL}

    def has_begun() -> bool:
        """Once, and only once."""
        which = {"label": "killed"} if action == "shake" else {"order": 61}
        return len(foreign.truth(action, **which)) == 1

    async def scenario(here: Bench) -> None:
        first = await here.process(interface, description, **config)
        await here.idle()
        args = {"speed": 4, "time_s": 6.0, "label": "killed"} if action == "shake" else {"order": 61}
        await here.start("a61", action, **args)
        await until(has_begun, 20)
        first.kill()
        await here.await_node_gone()
        await here.process(interface, description, **config)
        if action == "shake":
            assert "keeps no record" in (await here.status("a61", "interrupted", 40)).why
        else:
            assert (await here.outcome("a61", 40)).result == list(range(61))
        await here.idle(40)
        assert (await here.start("a61", action, **args)).status in ("interrupted", "finished")
        assert has_begun()

    run(tmp_path, scenario)


def test_raw_pictures_become_png() -> None:
    made = encode_png(bytes([9, 8, 7, 0, 6, 5, 4, 0]), width=1, height=2, encoding="bgr8", step=4)
    assert made[:8] == b"\x89PNG\r\n\x1a\n"
    size = struct.unpack(">I", made[33:37])[0]
    assert zlib.decompress(made[41 : 41 + size]) == b"\0\x07\x08\x09\0\x04\x05\x06"
    with pytest.raises(DeviceError, match="cannot be read"):
        encode_png(b"", width=1, height=1, encoding="bayer_rggb8", step=1)


def test_without_rclpy_the_remedy_is_told(tmp_path: Path) -> None:
    async def scenario(here: Bench) -> None:
        await here.adapter("wei_ros_node", DESCRIPTION, ros_node_address=NODE, ros_python="/nowhere/python3")
        await here.in_error("/nowhere/python3 of ROS cannot be started")

    run(tmp_path, scenario)

"""One workcell, one workflow: LabOS' own node and nodes of six other systems, each a real one."""

from __future__ import annotations

import copy
import json
import os
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest

from labos.node import World
from labos.settings import free_port
from labos_drivers.a4s_sealer.wire import SealerOnWire
from tests.drivers.wires import power_on
from tests.support.foreign import ForeignProcess
from tests.support.ioc import Ioc
from tests.support.lab_process import Up
from tests.support.protobuf import ProtobufProcess
from tests.support.ros import WEI, RosProcess
from tests.support.sila import SilaProcess

LABEL = "one of seven"
ABOUT: dict[str, Any] = {
    "stations": {"plate": {}},
    "actions": {
        "shake": {
            "args": {
                "speed": {"type": "int"},
                "time_s": {"type": "float", "default": 0.2},
                "label": {"type": "str", "default": ""},
            },
            "duration": 2,
        }
    },
}
SILA = {
    "actions": {"shake": {"name": "ShakePlate", "args": {"time_s": "Duration"}}},
    "sila": {"state": {"busy": {"property": "ShakingController.State", "is": "Shaking"}}},
}
MODE = {"mode": {"type": "str", "default": "Gentle"}}
EPICS = {
    "prefix": "SHAKER:",
    "actions": {
        "shake": {
            "set": [{"pv": "Speed", "value": "{speed}"}, {"pv": "Label", "value": "{label}"}],
            "start": {"pv": "Shake", "value": "{time_s}"},
        }
    },
    "state": {"busy": {"pv": "State", "is": "Shaking"}},
}


def about(name: str) -> dict[str, Any]:
    """What stands in the workcell file; a SiLA command wants all of its parameters."""
    written = copy.deepcopy(ABOUT)
    if name == "sila":
        written["actions"]["shake"]["args"] |= MODE
    return written


@pytest.fixture
def shakers(tmp_path: Path) -> Iterator[dict[str, tuple[ForeignProcess, str, dict[str, Any]]]]:
    """By name: the process, its interface, its config."""
    with ExitStack() as stack:

        def start(process: ForeignProcess) -> Any:
            stack.callback(process.kill)
            return process.start()

        wei = start(ForeignProcess("wei", tmp_path / "wei", free_port()))
        madsci = start(ForeignProcess("madsci", tmp_path / "madsci", free_port()))
        ros = start(RosProcess("ros", tmp_path / "ros", 160 + os.getpid() % 60))
        tcp = start(ProtobufProcess("protobuf", tmp_path / "protobuf", free_port()))
        ioc = start(Ioc(tmp_path / "epics"))
        sila = start(SilaProcess(tmp_path / "sila", encrypted=True))
        yield {
            "wei": (wei, "wei_rest_node", {"rest_node_address": wei.url}),
            "madsci": (madsci, "madsci_rest_node", {"node_url": madsci.url}),
            "ros": (ros, "wei_ros_node", {**ros.config, "ros": WEI}),
            "tcp": (tcp, "tcp_node", {"tcp_node_address": "127.0.0.1", "tcp_node_port": tcp.port}),
            "epics": (ioc, "epics_node", {**ioc.config, "epics": EPICS}),
            "sila": (sila, "sila_node", {**sila.config(), **SILA}),
        }


@pytest.fixture
def lab(tmp_path: Path) -> Iterator[Up]:
    up = Up(tmp_path / "lab", "--real", "--declare")
    up.environment["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    yield up
    up.clean_up()


@pytest.mark.full
@pytest.mark.timeout(300)
def test_one_workflow_over_nodes_of_seven_kinds(
    shakers: dict[str, tuple[ForeignProcess, str, dict[str, Any]]], lab: Up, tmp_path: Path
) -> None:
    port = tmp_path / "sealer"
    sealer = {"name": "sealer", "model": "A4S_sealer", "config": {"port": str(port)}}
    modules = [sealer] + [
        {"name": name, "interface": interface, "config": {**config, "poll_s": 0.2}, "about": about(name)}
        for name, (_, interface, config) in shakers.items()
    ]
    seal = {"name": "seal", "module": "sealer", "action": "seal", "args": {"time": 2.0}}
    steps = [seal] + [
        {"name": name, "module": name, "action": "shake", "args": {"speed": 300, "label": LABEL}}
        for name in shakers
    ]
    cell, flow = tmp_path / "corner.yaml", tmp_path / "flow.yaml"
    stock = {"sealer.default": {"plate96": 1}}
    cell.write_text(json.dumps({"labos": 1, "name": "rpl", "modules": modules, "stock": stock}))
    flow.write_text(json.dumps({"labos": 1, "name": "seven kinds", "steps": steps}))
    world = World(str(tmp_path / "world.sqlite"))
    world.stock("sealer.default", "plate")
    with power_on(SealerOnWire, "sealer", world, port):
        lab.start(str(cell))
        with lab.client() as client:
            run = client.submit(flow, user="ada")
            assert client.wait(run, timeout_s=120).status == "completed"
        assert lab.interrupt() == 0, lab.read_log()
    assert len(world.motions("seal")) == 1
    world.close()
    for name, (process, _, _) in shakers.items():
        assert len(process.truth("shake", label=LABEL)) == 1, name
    assert lab.types().count("action.succeeded") == 7
    assert "action.unknown" not in lab.types()

"""The adapter of WEI's ZeroMQ nodes. WEI ships no such node, only the client of its own; the node of these
tests is a real one on ``pyzmq`` 27.3.0 in a process of its own, and WEI's client drives it too."""

from __future__ import annotations

import subprocess
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from labos.errors import DeviceError
from labos.settings import free_port
from tests.integration.adapter.bench import Bench
from tests.integration.adapter.scenario import play
from tests.integration.bus.contract import until
from tests.support.cable import Cable
from tests.support.reader import ReaderProcess, describe_reader

pytest.importorskip("zmq", reason="needs labos-sdl[zmq]")

run = partial(play, limit_s=90.0)
DESCRIPTION = describe_reader("wei_zmq_node")
UNHEARD = b'{"action_handle": "measure", "action_vars": {"assay": "unheard"}}'
WEI_CLIENT = """
import sys
from types import SimpleNamespace as Table
from wei.core.interfaces.zmq_interface import ZmqInterface
module = Table(config={"zmq_node_address": "127.0.0.1", "zmq_node_port": int(sys.argv[1])})
print(*ZmqInterface.send_action(Table(action="measure", args={"assay": "by WEI"}), module))
"""


@pytest.fixture
def node(tmp_path: Path) -> Iterator[ReaderProcess]:
    process = ReaderProcess("zmq", tmp_path / "node", free_port())
    try:
        yield process.start()
    finally:
        process.kill()


@pytest.fixture
def cable(node: ReaderProcess) -> Iterator[Cable]:
    cable = Cable(node.port)
    yield cable
    cable.cut()


def where(port: int) -> dict[str, Any]:
    return {"zmq_node_address": "127.0.0.1", "zmq_node_port": port}


def test_measures_fails_and_loses_an_answer(node: ReaderProcess, cable: Cable, tmp_path: Path) -> None:
    async def scenario(here: Bench) -> None:
        await here.adapter("wei_zmq_node", DESCRIPTION, **where(cable.port))
        await here.idle()
        await here.start("a1", "measure", assay="blue")
        assert (await here.outcome("a1")).result == "/data/blue.csv"
        await here.start("a2", "measure", assay="lost", time_s=1.0)
        await until(lambda: node.list_measured() == ["blue", "lost"], 20)
        cable.cut()
        assert "line was cut" in (await here.status("a2", "interrupted")).why
        await here.in_error("does not answer")
        cable.mend()
        await here.idle()
        assert (await here.start("a2", "measure", assay="lost", time_s=1.0)).status == "interrupted"
        await here.start("a3", "measure", assay="jam")
        failed = await here.outcome("a3")
        assert (failed.succeeded, failed.effects) == (False, "unknown")
        assert "The drawer is stuck." in failed.error
        assert (await here.kernel.recover("a4")).succeeded
        assert node.list_measured() == ["blue", "lost"]

    run(tmp_path, scenario)


def test_a_node_that_stays_mute_is_not_waited_for_for_ever(node: ReaderProcess, tmp_path: Path) -> None:
    async def scenario(here: Bench) -> None:
        await here.adapter("wei_zmq_node", DESCRIPTION, **{**where(node.port), "patience_s": 0.5})
        await here.idle()
        await here.start("a1", "measure", assay="mute")
        assert "has not answered" in (await here.status("a1", "interrupted")).why
        await here.idle()
        assert (await here.start("a1", "measure", assay="mute")).status == "interrupted"
        assert node.list_measured() == ["mute"]

    run(tmp_path, scenario)


@pytest.mark.full
def test_weis_own_client_drives_the_same_node(node: ReaderProcess) -> None:
    command = [node.python, "-c", WEI_CLIENT, str(node.port)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert done.stdout.splitlines()[-1].strip() == "succeeded /data/by WEI.csv", done.stderr
    assert node.list_measured() == ["by WEI"]


@pytest.mark.full
def test_the_adapter_is_killed_in_mid_action(node: ReaderProcess, tmp_path: Path) -> None:
    async def scenario(here: Bench) -> None:
        first = await here.process("wei_zmq_node", DESCRIPTION, **where(node.port))
        await here.idle()
        await here.start("a1", "measure", assay="killed", time_s=4.0)
        await until(lambda: node.list_measured() == ["killed"], 20)
        first.kill()
        await here.await_node_gone()
        await here.process("wei_zmq_node", DESCRIPTION, **where(node.port))
        assert "restarted" in (await here.status("a1", "interrupted", 40)).why
        await here.idle(40)
        await here.start("a2", "measure", assay="next")
        assert (await here.outcome("a2")).succeeded
        assert node.list_measured() == ["killed", "next"]

    run(tmp_path, scenario)


@pytest.mark.full
def test_the_node_is_killed_in_mid_action(node: ReaderProcess, tmp_path: Path) -> None:
    """It is started again at once, and ZeroMQ, which connects again by itself, sends nothing a second time;
    nor what was meant for a node that was not there."""

    async def scenario(here: Bench) -> None:
        adapter = (await here.adapter("wei_zmq_node", DESCRIPTION, **where(node.port))).node
        await here.idle()
        await here.start("a1", "measure", assay="died", time_s=30.0)
        await until(lambda: node.list_measured() == ["died"], 20)
        node.kill()
        assert "line was cut" in (await here.status("a1", "interrupted")).why
        assert (await here.start("a1", "measure", assay="died", time_s=30.0)).status == "interrupted"
        await here.in_error("does not answer")
        with pytest.raises(DeviceError, match="does not answer") as raised:
            await adapter.exchange(UNHEARD, 60.0)
        assert raised.value.effects == "none"
        node.start()
        await here.idle(40)
        await here.start("a3", "measure", assay="next")
        assert (await here.outcome("a3")).succeeded
        assert node.list_measured() == ["died", "next"]

    run(tmp_path, scenario)

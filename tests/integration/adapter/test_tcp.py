"""The adapter of WEI's TCP nodes. WEI ships no such node, only the client of its own; the node of these
tests is a real one in a process of its own, and WEI's client drives it too."""

from __future__ import annotations

import subprocess
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from labos.settings import free_port
from tests.integration.adapter.bench import Bench
from tests.integration.adapter.scenario import play
from tests.integration.bus.contract import until
from tests.support.foreign import python_of
from tests.support.proxy import Proxy
from tests.support.reader import ReaderProcess, describe_reader

run = partial(play, limit_s=90.0)
DESCRIPTION = describe_reader("wei_tcp_node")
LONG = {"patience_s": 3600.0}

WEI_CLIENT = """
import sys
from types import SimpleNamespace as Table
from wei.core.interfaces.tcp_interface import TcpInterface
module = Table(config={"tcp_node_address": "127.0.0.1", "tcp_node_port": int(sys.argv[1])})
print(*TcpInterface.send_action(Table(action="measure", args={"assay": "by WEI"}), module))
"""


@pytest.fixture
def reader(tmp_path: Path) -> Iterator[ReaderProcess]:
    process = ReaderProcess("tcp", tmp_path / "node", free_port())
    try:
        yield process.start()
    finally:
        process.kill()


def where(port: int) -> dict[str, Any]:
    return {"tcp_node_address": "127.0.0.1", "tcp_node_port": port}


def test_measures_fails_and_loses_an_answer(reader: ReaderProcess, tmp_path: Path) -> None:
    proxy = Proxy(reader.port)

    async def scenario(here: Bench) -> None:
        await here.adapter("wei_tcp_node", DESCRIPTION, **where(proxy.port))
        await here.idle()
        await here.start("a1", "measure", assay="pieces")
        assert (await here.outcome("a1")).result == "/data/pieces.csv"
        proxy.lose_next(b"measure")
        await here.start("a2", "measure", assay="lost")
        assert "line was" in (await here.status("a2", "interrupted")).why
        assert (await here.start("a2", "measure", assay="lost")).status == "interrupted"
        await here.idle()
        await here.start("a3", "measure", assay="jam")
        failed = await here.outcome("a3")
        assert (failed.succeeded, failed.effects) == (False, "unknown")
        assert "The drawer is stuck." in failed.error
        assert reader.list_measured() == ["pieces", "lost"]
        assert (await here.kernel.recover("a4")).succeeded
        proxy.close()
        await here.in_error("does not answer")

    run(tmp_path, scenario)


def test_a_node_that_stays_mute_is_not_waited_for_for_ever(reader: ReaderProcess, tmp_path: Path) -> None:
    async def scenario(here: Bench) -> None:
        await here.adapter("wei_tcp_node", DESCRIPTION, **{**where(reader.port), "patience_s": 0.5})
        await here.idle()
        await here.start("a1", "measure", assay="mute")
        assert "has not answered" in (await here.status("a1", "interrupted")).why
        assert (await here.start("a1", "measure", assay="mute")).status == "interrupted"
        # What it can have worked by any measure is over.
        await here.idle()
        await here.start("a2", "measure", assay="next")
        assert (await here.outcome("a2")).succeeded
        assert reader.list_measured() == ["mute", "next"]

    run(tmp_path, scenario)


def test_a_device_that_may_still_work_is_busy(reader: ReaderProcess, tmp_path: Path) -> None:
    """After the adapter was killed nobody can tell whether it does; nothing else is sent to it meanwhile."""

    async def scenario(here: Bench) -> None:
        first = await here.process("wei_tcp_node", DESCRIPTION, **where(reader.port), **LONG)
        await here.idle()
        await here.start("a1", "measure", assay="mute")
        await until(lambda: reader.list_measured() == ["mute"], 20)
        first.kill()
        await here.await_node_gone()
        await here.process("wei_tcp_node", DESCRIPTION, **where(reader.port), **LONG)
        assert "restarted" in (await here.status("a1", "interrupted", 40)).why
        assert (await here.kernel.state()).status == "BUSY"
        early = await here.start("a2", "measure", assay="early")
        assert (early.status, "waiting for the device to stop" in early.why) == ("refused", True)
        looked = await here.kernel.admin("observe")
        assert (looked.done, "may still be carrying out" in looked.why) == (False, True)
        # Who resets it has seen that it stands still.
        assert (await here.kernel.recover("a3")).succeeded
        await here.idle()
        await here.start("a4", "measure", assay="next")
        assert (await here.outcome("a4")).succeeded
        assert reader.list_measured() == ["mute", "next"]

    run(tmp_path, scenario)


@pytest.mark.full
def test_the_adapter_is_killed_in_mid_action(reader: ReaderProcess, tmp_path: Path) -> None:
    """The module is busy until the action must be over by any measure, and then idle by itself."""

    async def scenario(here: Bench) -> None:
        first = await here.process("wei_tcp_node", DESCRIPTION, **where(reader.port))
        await here.idle()
        await here.start("a1", "measure", assay="killed", time_s=8.0)
        await until(lambda: reader.list_measured() == ["killed"], 20)
        first.kill()
        await here.await_node_gone()
        await here.process("wei_tcp_node", DESCRIPTION, **where(reader.port))
        assert "restarted" in (await here.status("a1", "interrupted", 40)).why
        await here.idle(40)
        again = await here.start("a1", "measure", assay="killed", time_s=8.0)
        assert again.status == "interrupted"
        await here.start("a2", "measure", assay="next")
        assert (await here.outcome("a2")).succeeded
        assert reader.list_measured() == ["killed", "next"]

    run(tmp_path, scenario)


@pytest.mark.full
def test_the_node_is_killed_in_mid_action(reader: ReaderProcess, tmp_path: Path) -> None:
    async def scenario(here: Bench) -> None:
        await here.adapter("wei_tcp_node", DESCRIPTION, **where(reader.port))
        await here.idle()
        await here.start("a1", "measure", assay="mute")
        await until(lambda: reader.list_measured() == ["mute"], 20)
        reader.kill()
        assert "line was" in (await here.status("a1", "interrupted")).why
        await here.in_error("does not answer")
        reader.start()
        await here.idle(40)
        assert (await here.start("a1", "measure", assay="mute")).status == "interrupted"
        await here.start("a2", "measure", assay="next")
        assert (await here.outcome("a2")).succeeded
        assert reader.list_measured() == ["mute", "next"]

    run(tmp_path, scenario)


@pytest.mark.full
def test_weis_own_client_drives_the_same_node(reader: ReaderProcess) -> None:
    python = python_of("wei")
    done = subprocess.run(
        [python, "-c", WEI_CLIENT, str(reader.port)], capture_output=True, text=True, timeout=60, check=False
    )
    assert done.stdout.splitlines()[-1].strip() == "succeeded /data/by WEI.csv", done.stderr
    assert reader.list_measured() == ["by WEI"]

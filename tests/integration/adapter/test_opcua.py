"""The adapter of OPC UA servers, with a real one on ``asyncua`` 2.1.0 in a process of its own."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from labos.settings import free_port
from tests.foreign.make import ROOT
from tests.integration.adapter.bench import Bench
from tests.integration.adapter.scenario import play, shaker
from tests.integration.bus.contract import until
from tests.support.cable import Cable
from tests.support.foreign import ForeignProcess
from tests.support.needed import need

need("asyncua", "opcua")

run = partial(play, limit_s=100.0)
DESCRIPTION = shaker("opcua_node")
SHAKE = {
    "set": [{"node": "Speed", "value": "{speed}"}],
    "start": {"node": "Shake", "value": ["{time_s}", "{label}"]},
    "result": {"speed": "Speed"},
}
MAPPING: dict[str, Any] = {
    "namespace": "http://lab.example/shaker",
    "prefix": "Shaker.",
    "actions": {
        "shake": SHAKE,
        "shake_by_id": {
            **SHAKE,
            "set": [{"node": "Speed", "value": "{speed}"}, {"node": "Job", "value": "{id}"}],
            "done": {"node": "Last", "is": "{id}"},
        },
        "travel": {
            "start": {"node": "Travel", "value": ["{target}"]},
            "done": [
                {"node": "Position", "near": "{target}", "within": 0.01},
                {"node": "State", "is": "Idle"},
            ],
            "result": "Position",
        },
    },
    "state": {
        "busy": {"node": "State", "is": ["Shaking", "Travelling"]},
        "error": {"node": "State", "is": "Error"},
        "why": "Why",
    },
    "reset": {"node": "Reset"},
    "observe": {"state": "State"},
}


class OpcuaProcess(ForeignProcess):
    """An OPC UA server."""

    says_up = "the server is up"

    def command(self) -> list[Path | str]:
        return [self.python, ROOT / "tests" / "foreign" / "opcua_node.py", str(self.port)]

    def environment(self) -> dict[str, str]:
        return {}


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[OpcuaProcess]:
    process = OpcuaProcess("opcua", tmp_path_factory.mktemp("opcua"), free_port())
    try:
        yield process.start()
    finally:
        process.kill()


@pytest.fixture
def cable(server: OpcuaProcess) -> Iterator[Cable]:
    cable = Cable(server.port)
    yield cable
    cable.cut()


async def adapter(here: Bench, port: int, **more: Any) -> Any:
    config = {"opcua_url": f"opc.tcp://127.0.0.1:{port}/", "opcua": MAPPING, "patience_s": 20.0, **more}
    process = await here.process("opcua_node", DESCRIPTION, **config)
    await here.idle()
    return process


def test_methods_variables_state_and_reset(server: OpcuaProcess, tmp_path: Path) -> None:
    async def scenario(here: Bench) -> None:
        await adapter(here, server.port)
        await here.start("a1", "shake", speed=300, label="everyday")
        done = await here.outcome("a1")
        assert (done.succeeded, done.effects, done.result) == (True, "all", {"speed": 300})
        assert server.truth("shake", label="everyday") == [
            {"what": "shake", "speed": 300, "label": "everyday"}
        ]
        await here.start("a2", "travel", target=3.0)
        assert (await here.outcome("a2")).result == 3.0
        await here.start("a3", "shake", speed=1, label="jam")
        failed = await here.outcome("a3")
        assert (failed.succeeded, failed.effects) == (False, "unknown")
        assert "The plate is stuck." in failed.error
        assert (await here.kernel.recover("a4")).succeeded
        await here.idle()
        assert (await here.kernel.admin("observe")).result == {"state": "Idle"}

    run(tmp_path, scenario)


@pytest.mark.full
@pytest.mark.parametrize("action", ["shake", "shake_by_id"])
def test_a_lost_answer_never_moves_twice(
    server: OpcuaProcess, cable: Cable, tmp_path: Path, action: str
) -> None:
    """The line is cut in mid-action, the device goes on: only what names the action can be found."""
    label = f"lost {action}"

    async def scenario(here: Bench) -> None:
        await adapter(here, cable.port)
        await here.start("a1", action, speed=2, time_s=6.0, label=label)
        await until(lambda: len(server.truth("shake", label=label)) == 1, 20)
        cable.cut()
        await here.in_error("here is no answer for")
        cable.mend()
        if action == "shake":
            assert "its callback was lost" in (await here.status("a1", "interrupted")).why
        else:
            assert (await here.outcome("a1", 40)).succeeded
        await here.idle(40)
        assert len(server.truth("shaken", label=label)) == 1
        again = await here.start("a1", action, speed=2, time_s=6.0, label=label)
        assert again.status == ("interrupted" if action == "shake" else "finished")
        await here.start("a2", action, speed=3, time_s=0.0, label=label)
        assert (await here.outcome("a2")).succeeded
        assert [told["speed"] for told in server.truth("shake", label=label)] == [2, 3]

    run(tmp_path, scenario)


@pytest.mark.full
def test_a_motion_is_waited_for_across_a_broken_line(
    server: OpcuaProcess, cable: Cable, tmp_path: Path
) -> None:
    """Its method was answered, and the server tells that it is the same one."""

    async def scenario(here: Bench) -> None:
        await adapter(here, cable.port)
        await here.start("a1", "travel", target=7.0)
        await until(lambda: len(server.truth("travel", target=7.0)) == 1, 20)
        await here.await_taken()
        cable.cut()
        await here.in_error("here is no answer for")
        cable.mend()
        assert (await here.outcome("a1", 40)).result == 7.0
        assert len(server.truth("travel", target=7.0)) == 1

    run(tmp_path, scenario)


@pytest.mark.full
@pytest.mark.parametrize("action", ["shake", "shake_by_id", "travel"])
def test_the_adapter_is_killed_in_mid_action(server: OpcuaProcess, tmp_path: Path, action: str) -> None:
    """Only what names the action, or was answered by a server that is still the same one, can be found."""
    args: dict[str, Any] = {"speed": 4, "time_s": 6.0, "label": f"killed {action}"}
    what, told = "shake", {"label": args["label"]}
    if action == "travel":
        what, args = "travel", {"target": 30.0}
        told = args

    async def scenario(here: Bench) -> None:
        first = await adapter(here, server.port)
        await here.start("a1", action, **args)
        await until(lambda: len(server.truth(what, **told)) == 1, 20)
        if action == "travel":
            await here.await_taken()
        first.kill()
        await here.await_node_gone()
        config = {"opcua_url": f"opc.tcp://127.0.0.1:{server.port}/", "opcua": MAPPING, "patience_s": 20.0}
        await here.process("opcua_node", DESCRIPTION, **config)
        if action == "shake":
            assert "restarted" in (await here.status("a1", "interrupted", 40)).why
        else:
            assert (await here.outcome("a1", 40)).succeeded
        await here.idle(40)
        assert len(server.truth(what, **told)) == 1

    run(tmp_path, scenario)


@pytest.mark.full
@pytest.mark.parametrize("action", ["shake", "travel"])
def test_the_server_is_killed_in_mid_motion(tmp_path: Path, action: str) -> None:
    server = OpcuaProcess("opcua", tmp_path / "server", free_port()).start()
    args = {"speed": 5, "time_s": 30.0, "label": "died"} if action == "shake" else {"target": 5.0}

    async def scenario(here: Bench) -> None:
        await adapter(here, server.port, patience_s=60.0)
        await here.start("a1", action, **args)
        await until(lambda: len(server.truth(action)) == 1, 20)
        server.kill()
        await here.in_error("here is no answer for")
        server.start()
        told = await here.status("a1", "interrupted", 60)
        assert "restarted" in told.why or "lost" in told.why
        await here.idle(60)
        assert (await here.start("a1", action, **args)).status == "interrupted"
        await here.start("a2", "shake", speed=6, time_s=0.0)
        assert (await here.outcome("a2")).succeeded
        moved = [told["what"] for told in server.truth() if told["what"] in ("shake", "travel")]
        assert moved == [action, "shake"]

    try:
        run(tmp_path, scenario)
    finally:
        server.kill()


@pytest.mark.full
@pytest.mark.parametrize("action", ["shake", "travel"])
def test_a_server_that_says_nothing_any_more(tmp_path: Path, action: str) -> None:
    """It is frozen in mid-motion, so that the line stays up: after `patience_s` the outcome is unknown."""
    server = OpcuaProcess("opcua", tmp_path / "server", free_port()).start()
    args = {"speed": 5, "time_s": 3.0, "label": "frozen"} if action == "shake" else {"target": 5.0}

    async def scenario(here: Bench) -> None:
        await adapter(here, server.port, patience_s=3.0)
        await here.start("a1", action, **args)
        await until(lambda: len(server.truth(action)) == 1, 20)
        server.send(signal.SIGSTOP)
        told = await here.status("a1", "interrupted", 60)
        assert told.why
        assert (await here.start("a2", "shake", speed=6, time_s=0.0, label="unheard")).status == "refused"
        server.send(signal.SIGCONT)
        await here.idle(60)
        assert (await here.start("a1", action, **args)).status == "interrupted"
        await here.start("a3", "shake", speed=6, time_s=0.0, label="after")
        assert (await here.outcome("a3")).succeeded
        moved = [told["what"] for told in server.truth() if told["what"] in ("shake", "travel")]
        assert moved == [action, "shake"]

    try:
        run(tmp_path, scenario)
    finally:
        server.send(signal.SIGCONT)
        server.kill()

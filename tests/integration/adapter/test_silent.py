"""Servers that take a connection and say nothing, at once or in the middle of a motion: every request ends,
and says which server was asked what, and how long nothing came."""

from __future__ import annotations

import asyncio
import re
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any

import pytest

from labos.adapter import _http, _opcua, _signals, _tcp, find_adapter_class, protobuf, ros, zeromq
from labos.adapter._opcua_security import access_of
from labos.adapter.sila import client, node
from labos.core.model import ActionSpec, Description
from labos.errors import DeviceError, OutcomeUnknown
from labos.node import Setup
from labos.node.node import Node, current_action
from tests.support.needed import need
from tests.support.silent import SilentServer

need("asyncua", "opcua")
pytest.importorskip("grpc", reason="needs labos-sdl[sila]")
pytest.importorskip("zmq", reason="needs labos-sdl[zmq]")

GO = Description(driver="x", version="", description="", actions=(ActionSpec("go", duration_s=0.02),))
SECONDS = re.compile(r"\d(\.\d)? s\b")
QUICK = {"poll_s": 0.05, "patience_s": 0.4}
MAPPED = {
    "action": {"path": "/go"},
    "state": {"path": "/state", "status": "status", "busy": ["BUSY"]},
    "reset": {"path": "/reset"},
    "stop": {"path": "/stop"},
}
SIGNALS = {"actions": {"go": {"start": {"node": "Go"}}}, "reset": {"node": "R"}, "observe": {"x": "X"}}


def configure(interface: str, port: int) -> dict[str, Any]:
    """The configuration of a module whose foreign node listens there."""
    url = f"http://127.0.0.1:{port}"
    tcp = {"tcp_node_address": "127.0.0.1", "tcp_node_port": port}
    return {
        "wei_rest_node": {"rest_node_address": url},
        "madsci_rest_node": {"node_url": url},
        "rest_node": {"rest_node_address": url, "rest": MAPPED},
        "wei_tcp_node": tcp,
        "wei_zmq_node": {"zmq_node_address": "127.0.0.1", "zmq_node_port": port},
        "tcp_node": tcp,
        "opcua_node": {"opcua_url": f"opc.tcp://127.0.0.1:{port}/", "opcua": SIGNALS},
        "sila_node": {"sila_address": f"127.0.0.1:{port}", "sila_insecure": True},
    }[interface]


@pytest.fixture(autouse=True)
def impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    for module in (_http, _opcua, protobuf, client):
        monkeypatch.setattr(module, "READ_S", 0.3)
    for module in (_tcp, zeromq, _signals):
        monkeypatch.setattr(module, "CONNECT_S", 0.5)
    monkeypatch.setattr(node, "START_S", 0.3)
    monkeypatch.setattr(node, "WATCH_S", 0.3)
    for name in ("WAIT_S", "ASK_S", "ANSWER_S"):
        monkeypatch.setattr(ros, name, 0.2)


def with_node(interface: str, config: dict[str, Any], use: Callable[[Any], Awaitable[None]]) -> None:
    async def main() -> None:
        current_action.set("A1")
        made: Node = find_adapter_class(interface, GO)(Setup("arm", "cell", {**QUICK, **config}))
        try:
            await made.connect()
            await asyncio.wait_for(use(made), 20.0)
        finally:
            await made.close()

    asyncio.run(main())


async def fails(work: Awaitable[Any], where: str, *, may_have_moved: bool) -> str:
    """How a request ends that nobody answers: with whom, and after how long."""
    with pytest.raises((DeviceError, OutcomeUnknown)) as caught:
        await work
    words = str(caught.value)
    assert where in words, words
    assert SECONDS.search(words) or "timed out" in words, words
    if may_have_moved:
        assert isinstance(caught.value, OutcomeUnknown), words
    else:
        assert isinstance(caught.value, DeviceError), words
        assert caught.value.effects == "none", words
    return words


@pytest.mark.parametrize(
    "interface", ["wei_rest_node", "madsci_rest_node", "rest_node", "tcp_node", "sila_node"]
)
def test_questions_to_a_server_that_says_nothing_end(interface: str) -> None:
    with SilentServer() as server:
        where = f"127.0.0.1:{server.port}"

        async def use(made: Any) -> None:
            await fails(made.is_idle(), where, may_have_moved=False)
            assert where in await made.trouble()

        with_node(interface, configure(interface, server.port), use)
        assert server.received.is_set()


def slowly(interface: str) -> Any:
    """An interface that waits as long as another one of these that goes the same way: it is a slow test."""
    return pytest.param(interface, marks=pytest.mark.slow)


DRIPS = {
    "in its header": b"HTTP/1.1 200 OK\r\nX-Long:",
    "in its body": b"HTTP/1.1 200 OK\r\nContent-Type: application/json\r\nContent-Length: 999999\r\n\r\n{",
}


@pytest.mark.parametrize("begins", DRIPS.values(), ids=list(DRIPS))
@pytest.mark.parametrize("interface", [slowly("wei_rest_node"), "madsci_rest_node", "rest_node"])
def test_an_answer_that_comes_byte_by_byte_ends(
    interface: str, begins: bytes, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It never falls silent, and never says anything."""
    monkeypatch.setattr(_http, "CONNECT_S", 1.0)
    with SilentServer(begins) as server:
        where = f"127.0.0.1:{server.port}"

        async def use(made: Any) -> None:
            with pytest.raises(DeviceError, match="too slow") as caught:
                await made.is_idle()
            assert caught.value.effects == "none"
            assert where in str(caught.value)
            if interface != "madsci_rest_node":
                with pytest.raises(OutcomeUnknown):
                    await made.methods()["go"]()

        with_node(interface, configure(interface, server.port), use)


@pytest.mark.parametrize(
    "interface", [slowly("wei_rest_node"), "rest_node", "wei_tcp_node", slowly("tcp_node")]
)
def test_an_action_that_was_sent_and_is_never_answered_is_unknown(interface: str) -> None:
    with SilentServer() as server:

        async def use(made: Any) -> None:
            await fails(made.methods()["go"](), f"127.0.0.1:{server.port}", may_have_moved=True)

        with_node(interface, configure(interface, server.port), use)


@pytest.mark.parametrize("interface", ["madsci_rest_node", "wei_zmq_node", "opcua_node", "sila_node"])
def test_an_action_that_could_not_be_sent_has_moved_nothing(interface: str) -> None:
    """These protocols hear the server before a start is sent."""
    with SilentServer() as server:

        async def use(made: Any) -> None:
            if interface == "opcua_node":
                where = f"opc.tcp://127.0.0.1:{server.port}/"
                assert f"Is {where} running? The connection reports: no answer within" in await made.trouble()
                with pytest.raises(DeviceError, match=r"here is no answer for Go.*127.0.0.1") as caught:
                    await made.methods()["go"]()
                assert caught.value.effects == "none"
                await fails(made.reset(), where, may_have_moved=False)
                return
            await fails(made.methods()["go"](), f"127.0.0.1:{server.port}", may_have_moved=False)

        with_node(interface, configure(interface, server.port), use)


def test_an_opcua_client_closes_at_whatever_moment(monkeypatch: pytest.MonkeyPatch) -> None:
    """Also when the time for an answer is over just then."""
    monkeypatch.setattr(_opcua, "READ_S", 0.05)
    monkeypatch.setattr(_opcua, "RETRY_S", 0.01)

    async def close(port: int, after_s: float) -> None:
        made = _opcua.UaChannels(f"opc.tcp://127.0.0.1:{port}/", "", access_of({}))
        made.watch("X", lambda _: None)
        await asyncio.sleep(after_s)
        await made.close()

    async def main(port: int) -> None:
        for _ in range(5):
            closing = [asyncio.ensure_future(close(port, 0.04 + n / 1000)) for n in range(40)]
            _, hanging = await asyncio.wait(closing, timeout=10.0)
            assert not hanging

    with SilentServer() as server:
        asyncio.run(main(server.port))


def test_a_ros_node_that_falls_silent_in_mid_motion() -> None:
    """Its services are offered still, and its goal was accepted."""
    bridge = str(Path(__file__).parents[2] / "support" / "silent_ros_bridge")
    goal = {"action": "/dock", "type": "lab_msgs/action/Dock"}
    service = {"service": "/home", "type": "std_srvs/srv/Trigger"}
    for call, name in ((goal, "/dock"), (service, "/home")):

        async def use(made: Any, name: str = name) -> None:
            assert not await made.trouble()
            await fails(made.methods()["go"](), name, may_have_moved=True)
            with pytest.raises(DeviceError, match=r"/reset: no answer within 0.2 s"):
                await made.reset()

        reset = {"service": "/reset", "type": "std_srvs/srv/Trigger"}
        with_node("ros_node", {"ros_python": bridge, "ros": {"action": call, "reset": reset}}, use)

"""What a foreign node says that is in no list, and what it does not say: no word of rest, of an empty place
or of success."""

from __future__ import annotations

import asyncio
import json
from collections.abc import Awaitable, Callable
from typing import Any

import pytest

from labos.adapter import find_adapter_class
from labos.adapter._channels import ChannelReading, Channels, is_fulfilled, leaves_open
from labos.adapter._signals import SignalNode
from labos.adapter.ros import RosNode
from labos.adapter.wei import find_levels
from labos.core.model import ActionSpec, Description
from labos.errors import DeviceError
from labos.node import Setup
from labos.spec.ros import RosMapping, make_wei_mapping
from labos.spec.signals import Condition

GO = Description(driver="x", version="", description="", actions=(ActionSpec("go"),))
INFO = {"actions": {"go": {"name": "go"}}, "module_version": "1"}
ABOUT = {"name": "x", "actions": [{"name": "go"}], "admin_commands": ["reset"]}


def ask(interface: str, answers: dict[str, Any], use: Callable[[Any], Awaitable[None]], **more: Any) -> None:
    """An adapter of a server that answers each path with the same JSON."""

    async def main() -> None:
        async def answer(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
            path = (await reader.readuntil(b"\r\n\r\n")).split()[1].decode()
            body = json.dumps(answers[path]).encode()
            writer.write(b"HTTP/1.1 200 OK\r\nConnection: close\r\nContent-Length: %d\r\n\r\n" % len(body))
            writer.write(body)
            await writer.drain()
            writer.close()

        server = await asyncio.start_server(answer, "127.0.0.1", 0)
        url = f"http://127.0.0.1:{server.sockets[0].getsockname()[1]}"
        config = {"rest_node_address": url, "node_url": url, "poll_s": 0.05, "patience_s": 0.4, **more}
        node = find_adapter_class(interface, GO)(Setup("arm", "cell", config))
        try:
            await node.connect()
            await use(node)
        finally:
            await node.close()
            server.close()

    asyncio.run(main())


@pytest.mark.parametrize(
    ("state", "idle", "says"),
    [
        ({"status": {"READY": True, "BUSY": False}}, True, ""),
        ({"State": "IDLE"}, True, ""),
        ("OK", True, ""),
        ({"status": {"ERROR": True, "BUSY": True}}, True, "in error"),
        ({"State": "UNKNOWN"}, False, "says UNKNOWN, which is not known to mean that it is idle"),
        ({"status": "SHAKING"}, False, "says SHAKING"),
        ({"status": {"READY": False, "BUSY": False}}, False, "says nothing of its status"),
        ({"status": {}}, False, "says nothing of its status"),
        ({"status": "BUSY"}, False, ""),
    ],
)
def test_a_node_of_wei(state: Any, idle: bool, says: str) -> None:
    async def use(node: Any) -> None:
        assert await node.is_idle() is idle
        trouble = await node.trouble()
        assert says in trouble if says else trouble == ""

    ask("wei_rest_node", {"/state": state, "/about": ABOUT}, use)


@pytest.mark.parametrize("status", [{}, {"ready": True}, {"busy": None}, {"busy": "no"}])
def test_a_node_of_madsci_that_does_not_say_that_it_is_not_busy(status: dict[str, Any]) -> None:
    async def use(node: Any) -> None:
        with pytest.raises(DeviceError, match="does not say `busy`"):
            await node.is_idle()
        assert "does not say `busy`" in await node.trouble()

    ask("madsci_rest_node", {"/status": status, "/info": INFO}, use)


@pytest.mark.parametrize(
    "told", [{}, None, {"success": None}, {"success": False, "errors": [{"message": "no"}]}]
)
def test_a_command_of_madsci_that_does_not_say_that_it_succeeded(told: Any) -> None:
    async def use(node: Any) -> None:
        assert await node.is_idle()
        with pytest.raises(DeviceError, match=r"^safety_stop: "):
            await node.stop()

    answers = {"/status": {"busy": False}, "/info": INFO, "/admin/safety_stop": told}
    ask("madsci_rest_node", answers, use)


@pytest.mark.parametrize(
    ("state", "idle", "says"),
    [
        ({"State": "STANDBY"}, True, ""),
        ({"State": "WORKS"}, False, ""),
        ({"State": "CALIBRATES"}, False, "reports 'CALIBRATES'; `rest: state` does not define"),
    ],
)
def test_a_device_by_a_mapping(state: dict[str, Any], idle: bool, says: str) -> None:
    told = {"path": "/state", "status": "State", "busy": ["WORKS"], "idle": ["STANDBY"]}

    async def use(node: Any) -> None:
        assert await node.is_idle() is idle
        trouble = await node.trouble()
        assert says in trouble if says else trouble == ""

    ask("rest_node", {"/state": state}, use, rest={"action": {"path": "/go"}, "state": told})


@pytest.mark.parametrize("answer", [{}, {"state": "WORKS"}, [], {"State": None}])
def test_a_device_that_tells_no_status_is_not_idle(answer: Any) -> None:
    told = {"path": "/state", "status": "State", "busy": ["WORKS"]}

    async def use(node: Any) -> None:
        with pytest.raises(DeviceError, match="tells no 'State'"):
            await node.is_idle()
        assert "tells no 'State'" in await node.trouble()

    ask("rest_node", {"/state": answer}, use, rest={"action": {"path": "/go"}, "state": told})


@pytest.mark.parametrize(
    ("said", "idle"),
    [("State: READY", True), ("COMPLETED", True), ("ERROR 7", True), ("BUSY", False), ("UNKNOWN", False)],
)
def test_a_node_of_ros(said: str, idle: bool) -> None:
    node = RosNode(Setup("arm", "cell", {}))
    node.mapping = RosMapping.model_validate(make_wei_mapping("/arm"))

    async def main() -> bool:
        node._on_state({"data": said})
        return await node.is_idle()

    assert asyncio.run(main()) is idle


RUNS = {"pv": "State", "is": ["RUN", 1]}
SURE = {**RUNS, "not": ["REST", 0]}
AT_5 = {"pv": "Height", "near": 5.0, "within": 0.5}
HEAVY = {"pv": "Weight", "minimum": 20.0}


@pytest.mark.parametrize(
    ("condition", "told", "holds", "is_open"),
    [
        (RUNS, ChannelReading(1), True, False),
        (RUNS, ChannelReading(7), False, False),
        (SURE, ChannelReading(1), True, False),
        (SURE, ChannelReading(3, "REST"), False, False),
        (SURE, ChannelReading(7), False, True),
        (SURE, ChannelReading(float("nan")), False, True),
        (AT_5, ChannelReading(5.2), True, False),
        (AT_5, ChannelReading(float("nan")), False, True),
        (AT_5, ChannelReading(float("inf")), False, True),
        (HEAVY, ChannelReading(float("nan")), False, True),
        (HEAVY, ChannelReading("heavy"), False, True),
        (HEAVY, ChannelReading(3.0), False, False),
    ],
)
def test_a_value_that_says_neither(
    condition: dict[str, Any], told: ChannelReading, holds: bool, is_open: bool
) -> None:
    meant = Condition.model_validate(condition)
    assert (is_fulfilled(meant, told), leaves_open(meant, told)) == (holds, is_open)


class Values(Channels):
    """A server that tells what stands here."""

    def __init__(self, values: dict[str, Any]) -> None:
        self.values = values

    def watch(self, name: str, changed: Callable[[ChannelReading | None], None]) -> None:
        changed(ChannelReading(self.values[name]))

    async def get(self, name: str, timeout_s: float) -> ChannelReading:
        return ChannelReading(self.values[name])

    async def put(self, name: str, value: Any, *, callback: bool, on: str = "") -> None:
        self.values[name] = value

    def why_silent(self) -> str:
        return ""

    async def close(self) -> None:
        """Nothing is held."""


@pytest.mark.parametrize(
    ("state", "weight", "idle", "labware"),
    [
        ("REST", 3.0, True, {"nest": False}),
        ("RUN", 30.0, False, {"nest": True}),
        ("CALIBRATES", float("nan"), False, {}),
    ],
)
def test_a_device_by_its_signals(state: str, weight: float, idle: bool, labware: dict[str, bool]) -> None:
    class Scale(SignalNode):
        table = "epics"
        described = GO

        def client(self, protocol: Any) -> Channels:
            return Values({"State": state, "Weight": weight, "Go": 0})

    mapping = {
        "actions": {"go": {"start": {"pv": "Go"}}},
        "state": {"busy": SURE},
        "labware": {"nest": HEAVY},
    }

    async def main() -> None:
        node = Scale(Setup("scale", "cell", {"epics": mapping}))
        await node.connect()
        assert (await node.is_idle(), await node.observe()) == (idle, {"labware": labware})
        await node.close()

    asyncio.run(main())


def test_a_level_that_is_no_number_is_none() -> None:
    told = {"a": 3, "b": float("nan"), "c": {"quantity": "inf"}, "d": True, "e": "4"}
    assert find_levels(told) == {"a": 3.0, "e": 4.0}

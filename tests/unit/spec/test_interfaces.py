"""Where a node is, from an address as people write it."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

from labos.adapter import describe_foreign
from labos.errors import BadInput, DeviceError
from labos.spec.interfaces import list_missing_keys, make_config_at


@pytest.mark.parametrize(
    ("interface", "address", "config"),
    [
        ("wei_rest_node", "http://barty:8000", {"rest_node_address": "http://barty:8000"}),
        ("madsci_rest_node", "http://barty:8000", {"node_url": "http://barty:8000"}),
        ("tcp_node", "reader:7001", {"tcp_node_address": "reader", "tcp_node_port": 7001}),
        ("wei_tcp_node", "::1:7001", {"tcp_node_address": "::1", "tcp_node_port": 7001}),
        ("sila_node", "shaker:50052", {"sila_address": "shaker:50052"}),
        ("wei_ros_node", "/std_ns/arm", {"ros_node_address": "/std_ns/arm"}),
        ("opcua_node", "opc.tcp://plc:4840", {"opcua_url": "opc.tcp://plc:4840"}),
        ("epics_node", "10.0.7.2", {"ca_address": "10.0.7.2"}),
    ],
)
def test_an_address_is_what_the_adapter_wants(interface: str, address: str, config: dict[str, Any]) -> None:
    assert make_config_at(interface, address) == config
    assert set(list_missing_keys(interface, config)) <= {"opcua", "epics"}


@pytest.mark.parametrize("address", ["reader", "reader:", "reader:http"])
def test_a_port_that_is_missing_is_said(address: str) -> None:
    with pytest.raises(BadInput, match="host:port"):
        make_config_at("tcp_node", address)


@pytest.mark.parametrize("interface", ["rest_node", "epics_node", "opcua_node", "wei_tcp_node"])
def test_a_protocol_without_descriptions_says_so(interface: str) -> None:
    with pytest.raises(DeviceError, match=r"do not describe their actions. Write `about:` yourself."):
        asyncio.run(describe_foreign(interface, {}))

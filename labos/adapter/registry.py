"""Which adapter serves which ``interface:``; modules are imported only when they are used."""

from __future__ import annotations

from collections.abc import Mapping
from importlib import import_module
from typing import Any

from labos.adapter._foreign import ForeignNode, adapt
from labos.core.model import Description
from labos.errors import BadInput, DeviceError
from labos.node.node import Node, Setup
from labos.spec.interfaces import REMEDY, explain_unreachable

ADAPTERS: Mapping[str, str] = {
    "wei_rest_node": "labos.adapter.wei:WeiRestNode",
    "madsci_rest_node": "labos.adapter.madsci:MadsciRestNode",
    "rest_node": "labos.adapter.rest:RestNode",
    "wei_tcp_node": "labos.adapter.tcp:WeiTcpNode",
    "wei_zmq_node": "labos.adapter.zeromq:WeiZmqNode",
    "tcp_node": "labos.adapter.protobuf:TcpNode",
    "epics_node": "labos.adapter.epics:EpicsNode",
    "opcua_node": "labos.adapter.opcua:OpcuaNode",
    "wei_ros_node": "labos.adapter.ros:WeiRosNode",
    "wei_ros_camera": "labos.adapter.ros:WeiRosCamera",
    "ros_node": "labos.adapter.ros:RosNode",
    "sila_node": "labos.adapter.sila:SilaNode",
    "madsci_sila_node": "labos.adapter.sila:MadsciSilaNode",
}

NOT_DESCRIBED = "Nodes with the interface {} do not describe their actions."


def find_adapter_class(interface: str, description: Description) -> type[Node]:
    """The node class that reaches a foreign node with this description. Raises BadInput."""
    return adapt(_find_adapter(interface), description)


async def describe_foreign(interface: str, config: dict[str, Any]) -> Description:
    """The description of a running foreign node by itself. Raises BadInput, DeviceError."""
    if _find_adapter(interface).foreign_description is ForeignNode.foreign_description:
        raise DeviceError(NOT_DESCRIBED.format(interface), effects="none", remedy="Write `about:` yourself.")
    node_class = find_adapter_class(interface, Description(driver=interface, version="", description=""))
    node = node_class(Setup("node", "foreign", config))
    assert isinstance(node, ForeignNode)
    await node.connect()
    try:
        return await node.foreign_description()
    finally:
        await node.close()


def _find_adapter(interface: str) -> type[ForeignNode]:
    if interface not in ADAPTERS:
        raise BadInput(explain_unreachable(interface) or "A native node needs no adapter.", remedy=REMEDY)
    module, _, name = ADAPTERS[interface].partition(":")
    found: type[ForeignNode] = getattr(import_module(module), name)
    return found

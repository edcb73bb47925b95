"""The interfaces to a module's node: the values of ``interface:``, and the settings that each needs.

The adapters themselves are in ``labos.adapter``; a module without an interface has a node of LabOS' own.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from labos.errors import BadInput

NATIVE = ("", "native")
"""The module has a node of LabOS' own."""

REACHED: Mapping[str, tuple[tuple[str, ...], ...]] = {
    "wei_rest_node": (("rest_node_address", "node_url"),),
    "madsci_rest_node": (("node_url", "rest_node_address"),),
    "wei_tcp_node": (("tcp_node_address", "tcp_address"), ("tcp_node_port", "tcp_port")),
    "wei_zmq_node": (("zmq_node_address",), ("zmq_node_port",)),
    "tcp_node": (("tcp_node_address",), ("tcp_node_port",)),
    "rest_node": (("rest_node_address", "node_url"), ("rest",)),
    "epics_node": (("epics",),),
    "opcua_node": (("opcua_url",), ("opcua",)),
    "wei_ros_node": (("ros_node_address", "ros_node"),),
    "wei_ros_camera": (("ros_node_address", "ros_node"),),
    "ros_node": (("ros",),),
    "sila_node": (("sila_address", "node_url"),),
    "madsci_sila_node": (("node_url", "sila_address"),),
}
"""The interfaces that have an adapter, and the keys of ``config`` that each needs (one of each group)."""

MAPPING_KEYS = ("rest", "epics", "opcua", "ros", "sila", "actions")
"""The keys of ``config`` with tables that map LabOS' actions to requests to the device."""

PLANNED: Mapping[str, str] = {
    "simulate_callback": "WEI's own simulation",
}
"""Interfaces in workcell files for which there is no adapter."""


def explain_unreachable(interface: str) -> str:
    """Why a module cannot be reached by this interface; empty if it can."""
    if interface in NATIVE or interface in REACHED:
        return ""
    protocol = f" ({PLANNED[interface]})" if interface in PLANNED else ""
    return f"There is no adapter for the interface {interface!r}{protocol}."


REMEDY = f"There are {', '.join(REACHED)}; `native` is LabOS' own node for the module's driver."


def list_missing_keys(interface: str, config: Mapping[str, Any]) -> list[str]:
    """The keys of ``config`` that an adapter needs and that are missing."""
    return [group[0] for group in REACHED.get(interface, ()) if not any(config.get(key) for key in group)]


def make_config_at(interface: str, address: str) -> dict[str, Any]:
    """The ``config`` of a node at this address: a URL, ``host:port``, or a name in ROS. Raises BadInput."""
    groups = REACHED.get(interface, ())
    if interface == "epics_node":
        return {"ca_address": address}
    if not groups or interface == "ros_node":
        return {}
    if len(groups) > 1 and groups[1][0].endswith("_port"):
        host, colon, port = address.rpartition(":")
        if not colon or not port.isdecimal():
            raise BadInput(f"{address!r} is no address of {interface}.", remedy="Write host:port.")
        return {groups[0][0]: host, groups[1][0]: int(port)}
    return {groups[0][0]: address}


def is_configured(interface: str, config: Mapping[str, Any]) -> bool:
    """Whether the settings of an interface are complete. Files of other labs also name drivers there, or
    leave the address out."""
    known = interface in REACHED or interface in PLANNED
    return known and not list_missing_keys(interface, config)

"""What the torture suite needs to know about all instruments behind a gateway."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from labos.node import Fault, World
from labos_drivers.gateway.wire import GatewayOnWire

WAITS = {
    "labos_drivers.gateway.driver:POLL_S": 0.05,
    "labos_drivers.gateway.driver:ANSWER_S": 2.0,
    "labos_drivers.gateway.driver:LOST_S": 5.0,
}


def config(address: str) -> Mapping[str, Any]:
    return {"url": address}


def _make_fail(gateway: GatewayOnWire[Any], world: World) -> None:
    gateway.hands.fails_with = "a dialog is on its screen"


def _take_away(gateway: GatewayOnWire[Any], world: World) -> None:
    for place, plates in world.list_contents().items():
        if place.startswith(f"{gateway.device.name}."):
            world.carry(plates[-1], "")


def _open_gate(gateway: GatewayOnWire[Any], world: World) -> None:
    gateway.device.open("default")


SOFTWARE_FAILS = Fault("its own software ends with an error", _make_fail)
NO_PLATE = Fault("no plate is there", _take_away)
OPEN = Fault("somebody has opened it by hand", _open_gate)

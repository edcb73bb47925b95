"""A simulated SWING behind the reference gateway."""

from __future__ import annotations

from labos_drivers.chemspeed.simulator import ChemspeedSimulator
from labos_drivers.gateway.wire import GatewayOnWire


class ChemspeedOnWire(GatewayOnWire[ChemspeedSimulator]):
    instrument = "chemspeed"
    kind = ChemspeedSimulator
    actions = {"open_lid": "open_gate", "close_lid": "close_gate", "run_program": "run_program"}
    sensors_after = {"open_lid": {"lid": "open"}, "close_lid": {"lid": "closed"}}

"""A simulated TRobot behind the reference gateway."""

from __future__ import annotations

from labos_drivers.biometra.simulator import BiometraSimulator
from labos_drivers.gateway.wire import GatewayOnWire


class BiometraOnWire(GatewayOnWire[BiometraSimulator]):
    instrument = "biometra"
    kind = BiometraSimulator
    actions = {"open_lid": "open_gate", "close_lid": "close_gate", "run_program": "run_program"}
    sensors_after = {"open_lid": {"lid": "open"}, "close_lid": {"lid": "closed"}}

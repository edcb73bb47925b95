"""A simulated Hidex Sense behind the reference gateway."""

from __future__ import annotations

from labos_drivers.gateway.wire import GatewayOnWire
from labos_drivers.hidex.simulator import HidexSimulator


class HidexOnWire(GatewayOnWire[HidexSimulator]):
    instrument = "hidex"
    kind = HidexSimulator
    actions = {
        "open": "open_gate",
        "close": "close_gate",
        "run_assay": "run_assay",
        "read_plate": "read_plate",
    }
    leave_files = ("run_assay",)

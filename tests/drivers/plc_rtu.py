"""The hatch on a serial line, for the torture suite."""

from __future__ import annotations

import msgspec

from labos_drivers.plc.interface import Plc
from labos_drivers.plc.torture import TORTURE as ON_TCP
from labos_drivers.plc.wire import HatchOnLine


class PlcOnLine(Plc):
    """The PLC of the hatch, over Modbus RTU."""


TORTURE = msgspec.structs.replace(
    ON_TCP,
    device=HatchOnLine,
    settings={"parity": "N", "late_s": 0.2},  # a pseudo-terminal knows no parity
)

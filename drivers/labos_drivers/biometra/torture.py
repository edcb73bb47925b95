"""The case, faults and settings of the TRobot for the torture suite."""

from __future__ import annotations

from labos.node import Case, Torture
from labos_drivers.biometra.wire import BiometraOnWire
from labos_drivers.gateway.torture import NO_PLATE, OPEN, SOFTWARE_FAILS, WAITS, config

TORTURE = Torture(
    device=BiometraOnWire,
    config=config,
    cases=(Case("run_program", {"program_n": 7}),),
    faults=(OPEN, NO_PLATE, SOFTWARE_FAILS),
    waits=WAITS,
)

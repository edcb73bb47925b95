"""The declaration of the SWING for the torture suite."""

from __future__ import annotations

from labos.node import Case, Torture
from labos_drivers.chemspeed.wire import ChemspeedOnWire
from labos_drivers.gateway.torture import OPEN, SOFTWARE_FAILS, WAITS, config

TORTURE = Torture(
    device=ChemspeedOnWire,
    config=config,
    cases=(Case("run_program", {"program": "closed_loop1"}),),
    faults=(OPEN, SOFTWARE_FAILS),
    waits=WAITS,
)

"""The declaration of the Hidex Sense for the torture suite."""

from __future__ import annotations

from labos.node import Case, Torture
from labos_drivers.gateway.torture import NO_PLATE, OPEN, SOFTWARE_FAILS, WAITS, config
from labos_drivers.hidex.wire import HidexOnWire

TORTURE = Torture(
    device=HidexOnWire,
    config=config,
    cases=(Case("run_assay", {"assay_name": "growth"}), Case("read_plate", {"assay_name": "growth"})),
    faults=(OPEN, NO_PLATE, SOFTWARE_FAILS),
    waits=WAITS,
)

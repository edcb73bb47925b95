"""What the torture suite needs to know about the SOLO."""

from __future__ import annotations

from labos.node import Case, Torture
from labos_drivers.gateway.torture import NO_PLATE, SOFTWARE_FAILS, WAITS, config
from labos_drivers.solo.protocol import POSITIONS, STEP_END
from labos_drivers.solo.wire import SoloOnWire

STEPS = (("GetTip", "Position1"), ("ShuckTip", "TipDisposal"))
LINES = [*["Empty"] * POSITIONS, *(line for step in STEPS for line in (*step, STEP_END))]
PROTOCOL = "".join(f"{line}\r\n" for line in LINES)

TORTURE = Torture(
    device=SoloOnWire,
    config=config,
    cases=(Case("run_protocol", files={"protocol_path": ("mix.hso", PROTOCOL)}),),
    faults=(NO_PLATE, SOFTWARE_FAILS),
    supplies={"tips": 1e6},
    waits=WAITS,
)

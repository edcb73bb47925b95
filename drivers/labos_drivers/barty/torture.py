"""The declaration of Barty for the torture suite."""

from __future__ import annotations

from labos.node import Case, Fault, Foreign, Torture, World
from labos_drivers.barty.protocol import PINS
from labos_drivers.barty.wire import BartyOnWire

HERE = "labos_drivers.barty.driver"


def _switch_pump_on(barty: BartyOnWire, world: World) -> None:
    barty.press(PINS[2].enable)


TORTURE = Torture(
    device=BartyOnWire,
    config=lambda address: {"host": address},
    cases=(
        Case("fill", {"pumps": [0, 2]}),
        Case("drain", {"pumps": [0]}),
        Case("refill_ink", {"motors": ["motor_2"]}),
    ),
    faults=(
        Fault.by_setting("the daemon has no room for a dose", "refuses"),
        Fault("somebody has switched a pump on", _switch_pump_on),
    ),
    foreign=(Foreign("pigpio's Python client", "1.78", "tests/drivers/test_barty_wire.py"),),
    motion="drain_all",
    waits={f"{HERE}:ANSWER_S": 1.5, f"{HERE}:LOST_S": 4.0, f"{HERE}:POLL_S": 0.05},
)

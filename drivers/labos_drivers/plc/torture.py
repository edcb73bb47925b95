"""What the torture suite has to know of the PLC behind the hatch."""

from __future__ import annotations

from labos.node import Case, Fault, Torture, World
from labos_drivers.plc.wire import Hatch, HatchOnTcp

HERE = "labos_drivers.plc.driver"


def _stand(open_: bool, hatch: Hatch, world: World) -> None:
    """Somebody pushes the door, which is out of gear at rest."""
    hatch.position = 1.0 if open_ else 0.0
    if world.is_shut(hatch.nest) == open_:
        world.gate("person", hatch.nest, shut=not open_)


def stands_open(hatch: Hatch, world: World) -> None:
    _stand(True, hatch, world)


def stands_closed(hatch: Hatch, world: World) -> None:
    _stand(False, hatch, world)


def _jam(hatch: Hatch, world: World) -> None:
    hatch.jammed = True


def _free(hatch: Hatch, world: World) -> None:
    hatch.jammed = False


def _reach_in(hatch: Hatch, world: World) -> None:
    hatch.curtain = True


def _step_back(hatch: Hatch, world: World) -> None:
    hatch.curtain = False


def _press(hatch: Hatch, world: World) -> None:
    hatch.emergency = True


def _release(hatch: Hatch, world: World) -> None:
    hatch.emergency = False


TORTURE = Torture(
    device=HatchOnTcp,
    config=lambda address: {"address": address},
    cases=(
        Case("open", {"speed": 50.0}, prepare=stands_closed),
        Case("close", {"speed": 50.0}, prepare=stands_open),
    ),
    faults=(
        Fault("the door is jammed", _jam, _free),
        Fault("somebody reaches into the light curtain", _reach_in, _step_back),
        Fault("the emergency stop is pressed", _press, _release),
    ),
    motion="close",
    waits={f"{HERE}:PATIENCE_S": 4.0},
)

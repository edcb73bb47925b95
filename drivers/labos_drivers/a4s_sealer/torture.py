"""What the torture suite has to know of the a4S."""

from __future__ import annotations

from labos.node import Case, Fault, Foreign, Torture, World
from labos_drivers.a4s_sealer.wire import SealerOnWire

HERE = "labos_drivers.a4s_sealer.driver"


def _use_up_foil(sealer: SealerOnWire, world: World) -> None:
    world.supply(sealer.name, "foil", -(world.find_level(sealer.name, "foil") or 0.0))


def _insert_roll(sealer: SealerOnWire, world: World) -> None:
    world.supply(sealer.name, "foil", 1000)


TORTURE = Torture(
    device=SealerOnWire,
    cases=(
        Case(
            "seal",
            {"time": 3.0, "temperature": 175.0},
            record=lambda args: {"time_s": args["time"], "temperature_c": args["temperature"]},
        ),
    ),
    faults=(
        Fault("out of foil", _use_up_foil, _insert_roll),
        Fault.by_setting("its cleaning door is open", "door_is_shut", to=False, back=True),
        Fault("an empty nest, in which it jams", lambda sealer, world: world.carry(_find_plate(sealer), "")),
    ),
    waits={
        f"{HERE}:RECORD_S": 4.0,
        f"{HERE}:BEGIN_S": 6.0,
        f"{HERE}:CYCLE_S": 10.0,
        f"{HERE}:SHUTTLE_S": 10.0,
    },
    foreign=(Foreign("PyLabRobot", "0.2.2", "tests/drivers/test_pylabrobot.py"),),
)


def _find_plate(sealer: SealerOnWire) -> str:
    return sealer.top(sealer.place("default"))

"""The declaration of the MiR for the torture suite."""

from __future__ import annotations

from labos.node import Case, Fault, Torture, World
from labos_drivers.mir import protocol
from labos_drivers.mir.wire import MiROnWire

HERE = "labos_drivers.mir.driver"


def _move_home(mir: MiROnWire, world: World) -> None:
    """A person drives the robot home, so that each motion has its full length."""
    mir.at = mir.positions["home"]


def _block_way(mir: MiROnWire, world: World) -> None:
    mir.fail("no path to the goal")


def _press_stop(mir: MiROnWire, world: World) -> None:
    mir.press_stop()


def _release_stop(mir: MiROnWire, world: World) -> None:
    mir.state = protocol.PAUSE


def _turn_key(mir: MiROnWire, world: World) -> None:
    mir.state = protocol.MANUAL


TORTURE = Torture(
    device=MiROnWire,
    config=lambda address: {"url": address},
    cases=(
        Case("move", {"target": "bench"}, prepare=_move_home),
        Case("move", {"target": "the moon"}, prepare=_move_home, refused="there is no position"),
        Case("dock", {"target": "dock"}, prepare=_move_home),
    ),
    faults=(
        Fault("it finds no way", _block_way),
        Fault.by_setting("something stands in its way", "is_blocked"),
        Fault("its emergency stop is pressed", _press_stop, _release_stop),
        Fault("its key is turned to manual", _turn_key, _release_stop),
    ),
    settings={"positions": {"home": [0.0, 0.0], "bench": [36.0, 8.0], "dock": [10.0, 2.0]}},
    motion="move",
    waits={
        f"{HERE}:ANSWER_S": 3.0,
        f"{HERE}:LOST_S": 6.0,
        f"{HERE}:DRIVE_S": 30.0,
        f"{HERE}:POLL_S": 0.05,
    },
)

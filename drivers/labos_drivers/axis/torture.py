"""What the torture suite has to know of the drive."""

from __future__ import annotations

from labos.node import Case, Fault, Foreign, Torture, World
from labos_drivers.axis.wire import DriveOnSlcan

HERE = "labos_drivers.axis.driver"
START, GOAL = 100.0, 300.0


def at_start(drive: DriveOnSlcan, world: World) -> None:
    """Somebody turns the spindle by hand."""
    drive.stands = drive.table.counts(START) + (drive._origin if drive.homed else 0.0)


def _block(drive: DriveOnSlcan, world: World) -> None:
    drive.blocked = True


def _free(drive: DriveOnSlcan, world: World) -> None:
    drive.blocked = False


def _heat(drive: DriveOnSlcan, world: World) -> None:
    drive.hot = True


def _cool(drive: DriveOnSlcan, world: World) -> None:
    drive.hot = False


TORTURE = Torture(
    device=DriveOnSlcan,
    config=lambda address: {"channel": address, "interface": "slcan", "bus": {"sleep_after_open": 0}},
    cases=(
        Case("home", prepare=at_start),
        Case("move_to", {"position": GOAL}, prepare=at_start),
    ),
    faults=(
        Fault("something is in its way", _block, _free),
        Fault("it is too hot", _heat, _cool),
    ),
    motion="move_to",
    waits={f"{HERE}:PATIENCE_S": 4.0},
    foreign=(Foreign("canopen", "2.4", "tests/drivers/test_axis_wire.py"),),
)

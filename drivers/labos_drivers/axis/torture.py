"""The declaration of the axis for the torture suite."""

from __future__ import annotations

from labos.node import Case, Fault, Foreign, Torture, World
from labos_drivers.axis.wire import DriveOnSlcan

HERE = "labos_drivers.axis.driver"
START, GOAL = 100.0, 300.0


def put_at_start(drive: DriveOnSlcan, world: World) -> None:
    """A person turns the spindle by hand until the axis is at ``START``."""
    drive.stands = drive.table.counts(START) + (drive._origin if drive.homed else 0.0)


TORTURE = Torture(
    device=DriveOnSlcan,
    config=lambda address: {"channel": address, "interface": "slcan", "bus": {"sleep_after_open": 0}},
    cases=(
        Case("home", prepare=put_at_start),
        Case("move_to", {"position": GOAL}, prepare=put_at_start),
    ),
    faults=(
        Fault.by_setting("something is in its way", "blocked"),
        Fault.by_setting("it is too hot", "hot"),
    ),
    motion="move_to",
    waits={f"{HERE}:PATIENCE_S": 4.0},
    foreign=(Foreign("canopen", "2.4", "tests/drivers/test_axis_wire.py"),),
)

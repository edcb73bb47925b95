"""The cases, faults and settings of the OT-2 for the torture suite."""

from __future__ import annotations

from weakref import WeakKeyDictionary

from labos.node import Case, Fault, Foreign, Setup, Torture, World
from labos_drivers.ot2.wire import Disk, OT2OnWire

HERE = "labos_drivers.ot2.driver"
PROTOCOL = """\
metadata = {"apiLevel": "2.12"}


def run(protocol):
    protocol.comment(str(LABOS["destination_wells"]))
"""


_disks: WeakKeyDictionary[World, Disk] = WeakKeyDictionary()


def _robot(setup: Setup) -> OT2OnWire:
    """A simulated robot with the disk that it had before it was switched off. It does not run protocols with
    Opentrons' software, so that its motions take the time that the suite wants."""
    assert setup.world is not None
    return OT2OnWire(setup, disk=_disks.setdefault(setup.world, Disk()), simulate="")


def _open_door(robot: OT2OnWire, world: World) -> None:
    robot.open_door()


def _shut_door(robot: OT2OnWire, world: World) -> None:
    robot.shut_door()


def _empty_deck(robot: OT2OnWire, world: World) -> None:
    world.carry(robot.top(robot.place("deck1")), "")


TORTURE = Torture(
    device=_robot,
    config=lambda address: {"url": address},
    cases=(
        Case(
            "run_protocol",
            {"color_A_volumes": [10.0, 20.0], "destination_wells": ["A1", "A2"]},
            files={"config_path": ("mix.py", PROTOCOL)},
        ),
        Case("resume_run", refused="no run waits"),
    ),
    faults=(
        Fault("its front door is open", _open_door, _shut_door),
        Fault.by_setting("a command of the protocol fails", "fails_with", to="No tip detected.", back=""),
        Fault("an empty deck, into which it drives its tips", _empty_deck),
        Fault.by_setting("it has not started up yet", "starting"),
    ),
    supplies={"color_A": 1e6},
    waits={
        f"{HERE}:POLL_S": 0.05,
        f"{HERE}:ANSWER_S": 2.0,
        f"{HERE}:UPLOAD_S": 2.0,
        f"{HERE}:CREATE_S": 2.0,
        f"{HERE}:HOME_S": 4.0,
        f"{HERE}:LOST_S": 5.0,
    },
    foreign=(
        Foreign(
            "opentrons_simulate", "8.8.2, which runs the protocols", "tests/drivers/test_ot2_software.py"
        ),
    ),
)

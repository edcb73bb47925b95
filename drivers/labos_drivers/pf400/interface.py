"""The actions of the PF400."""

from __future__ import annotations

from typing import Annotated

from labos.core.ids import StationName
from labos.node import Move, Param, Place, Relid, Requires, Sets, Station, Unlid, action
from labos_drivers._arm import GRIPPER, SOURCE, TARGET
from labos_drivers._simulation import await_answer
from labos_drivers._wired import OnBenchOrWire
from labos_drivers.pf400.driver import PF400Driver
from labos_drivers.pf400.simulator import PF400Simulator
from labos_drivers.pf400.wire import PF400OnWire

Grip = Annotated[
    str,
    Param(
        choices=("", "narrow", "wide"),
        description="side of the plate the fingers close on; empty: as taught",
    ),
]


Kind = Annotated[str, Param(description="type of what is carried; filled in by the lab")]
PlateKind = Annotated[str, Param(description="type of the plate that the lid is on; filled in by the lab")]
Slow = Annotated[bool, Param(description="at a crawl, as on the first move to a newly taught place")]

Column = Annotated[bool, Param(description="the column too; hold it, it may sink")]

Approach = Annotated[
    str, Param(description="taught place through which the arm comes and leaves; empty: as configured")
]
Deck = Annotated[
    str, Param(place=True, description="where the grip is changed; empty: at the module's `regrip`")
]
Wide = Annotated[bool, Param(description="as far as for the wide grip, not the narrow one")]

HELD = Requires("module", "free", False)
DECK = StationName("{rotation_deck}")


class PF400(OnBenchOrWire):
    """Four-axis plate arm on a rail. While it is ``free`` a person guides it by hand, and nothing else
    moves it."""

    driver = "pf400"
    models = ("pf400", "PreciseFlex 400", "PreciseFlex 400SXL")
    manipulator = True
    variables = {"free": False}
    rest = {"free": False}
    stations = (Station("gripper", kind="gripper"),)
    devices = (PF400Simulator, PF400OnWire, PF400Driver)
    device: PF400Simulator | PF400Driver

    @action(
        Move(SOURCE, TARGET, "{source_plate_rotation}", "{target_plate_rotation}", DECK),
        HELD,
        duration_s=30,
        aliases=("move",),
    )
    async def transfer(
        self,
        source: Place,
        target: Place,
        source_plate_rotation: Grip = "",
        target_plate_rotation: Grip = "",
        slow: Slow = False,
        labware_type: Kind = "",
        source_approach: Approach = "",
        target_approach: Approach = "",
        rotation_deck: Deck = "",
    ) -> None:
        """Carry a plate from one station to another."""
        grips, through = (source_plate_rotation, target_plate_rotation), (source_approach, target_approach)
        await self.device.carry(
            source, target, *grips, labware_type, slow=slow, through=through, turn_at=rotation_deck
        )

    @action(Move(SOURCE, GRIPPER, "{source_plate_rotation}"), HELD, duration_s=18)
    async def pick_plate(
        self,
        source: Place,
        source_plate_rotation: Grip = "",
        labware_type: Kind = "",
        source_approach: Approach = "",
    ) -> None:
        """Take a plate into the hand, where it stays until it is put down."""
        await self.device.pick(source, source_plate_rotation, labware_type, source_approach)

    @action(
        Move(GRIPPER, TARGET, target_grip="{target_plate_rotation}"),
        HELD,
        duration_s=18,
        aliases=("place_plate",),
    )
    async def put_down(
        self,
        target: Place,
        target_plate_rotation: Grip = "",
        labware_type: Kind = "",
        target_approach: Approach = "",
    ) -> None:
        """Put down the plate that is in the hand."""
        await self.device.put_down(target, labware_type, target_approach)

    @action(HELD, duration_s=5)
    async def open_fingers(self, wide: Wide = False) -> None:
        """Open the fingers in the air: only after a person has seen that they hold nothing."""
        await self.device.open_fingers(wide)

    @action(Unlid(SOURCE, TARGET, "{source_plate_rotation}", "{target_plate_rotation}"), HELD, duration_s=30)
    async def remove_lid(
        self,
        source: Place,
        target: Place,
        source_plate_rotation: Grip = "",
        target_plate_rotation: Grip = "",
        labware_type: Kind = "",
        plate_type: PlateKind = "",
    ) -> None:
        """Take the lid off the plate at ``source`` and put it into the nest ``target``."""
        grips = source_plate_rotation, target_plate_rotation
        await self.device.unlid(source, target, *grips, labware_type, plate_type)

    @action(Relid(SOURCE, TARGET, "{source_plate_rotation}", "{target_plate_rotation}"), HELD, duration_s=30)
    async def replace_lid(
        self,
        source: Place,
        target: Place,
        source_plate_rotation: Grip = "",
        target_plate_rotation: Grip = "",
        labware_type: Kind = "",
        plate_type: PlateKind = "",
    ) -> None:
        """Put the lid from the nest ``source`` onto the plate at ``target``."""
        grips = source_plate_rotation, target_plate_rotation
        await self.device.relid(source, target, *grips, labware_type, plate_type)

    @action(HELD, duration_s=60, safe_to_repeat=True)
    async def explore_workcell(self) -> None:
        """Visit the taught locations with an empty hand."""
        await self.device.explore()

    @action(Sets("module", "free", True), duration_s=2, safe_to_repeat=True)
    async def free_mode(self, column: Column = False) -> None:
        """Let a person guide the arm by hand, with an empty hand: shoulder, elbow, wrist and rail yield."""
        await self.device.free(column)

    @action(Sets("module", "free", False), duration_s=20, safe_to_repeat=True)
    async def end_free_mode(self) -> None:
        """Hold the arm again, then straight up and folded, at a crawl: step back before."""
        await self.device.hold()

    @action(exclusive=False, safe_to_repeat=True)
    async def read_pose(self) -> list[float]:
        """Where the joints are, as ``labos teach`` takes them."""
        return await await_answer(self.device.read_pose())

    @action(Sets("module", "free", False), duration_s=20, recovers=True)
    async def reset(self) -> None:
        """Power on, homed if it is not, straight up and folded; free mode ends."""
        await super().reset()

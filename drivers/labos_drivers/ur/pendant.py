"""The pendant drop experiment, with an electronic pipette on a tool changer: a drop hangs from its tip.

The arm fetches the pipette from its dock. It mixes two liquids in a well, and draws this sample up. It puts
the pipette back into the dock, where a drop is formed at its tip and measured. Then it fetches the pipette
again, discards the tip and puts the pipette back. Each of these is an action, with a program that was taught
on the controller.

Sources: the paper's section on the pendant drop; AD-SDL/8IDI_workcell,
droplet_workcell/workflows/demo.yaml and the driver beside it.
"""

from __future__ import annotations

from typing import Annotated

from labos.core.ids import StationName
from labos.node import Consumes, Needs, Param, Place, Requires, Sets, action
from labos_drivers._wired import OnBenchOrWire
from labos_drivers.ur.driver import URDriver
from labos_drivers.ur.simulator import URSimulator

PIPETTE, SAMPLE = "pipette", "sample"
TIPS_EACH = 2
"""One for each of the two liquids."""

AWAY = Requires("module", "docked", False)
BARE = Requires("module", "tool", "")
WORN = Requires("module", "tool", PIPETTE)

Tool = Annotated[
    str, Param(choices=("", PIPETTE), description="what it wears then; empty: its own gripper alone")
]
Well = Annotated[str, Param(description="the well in which the sample is mixed, as A1")]
Liquid = Annotated[str, Param(description="the vial that this liquid is in, as the programs name it")]


class PendantDrop(OnBenchOrWire):
    """``tool`` is what the arm wears in the place of its own gripper, ``tip`` what hangs at the pipette.

    The tool changer is worked by the programs of ``pick_pipette`` and ``place_pipette``. Where it is a module
    of its own, it is locked or unlocked between ``dock`` and ``undock``: ``docked`` is the arm meanwhile."""

    variables = {"tool": "", "tip": "", "docked": False}
    rest = {"tool": "", "tip": "", "docked": False}
    levels = {"tips": 96}
    device: URSimulator | URDriver

    @action(AWAY, BARE, Sets("module", "tool", PIPETTE), duration_s=40)
    async def pick_pipette(self) -> None:
        """Fetch the pipette from its dock, and lock the tool changer."""
        await self.device.pendant("pick_pipette")

    @action(AWAY, WORN, Sets("module", "tool", ""), duration_s=40)
    async def place_pipette(self) -> None:
        """Put the pipette into its dock, and unlock the tool changer."""
        await self.device.pendant("place_pipette")

    @action(AWAY, Sets("module", "docked", True), duration_s=20)
    async def dock(self) -> None:
        """Bring the halves of the tool changer together in the pipette's dock, and stay there."""
        await self.device.pendant("dock")

    @action(
        Requires("module", "docked", True),
        Sets("module", "docked", False),
        Sets("module", "tool", "{tool}"),
        duration_s=20,
    )
    async def undock(self, tool: Tool = "") -> None:
        """Leave the dock, with the pipette if the tool changer was locked, without it if it was unlocked."""
        await self.device.pendant("undock", tool=tool)

    @action(
        AWAY,
        WORN,
        Requires("module", "tip", ""),
        Needs(StationName("{plate}")),
        Consumes("tips", TIPS_EACH),
        Sets("module", "tip", SAMPLE),
        duration_s=60,
    )
    async def create_sample(self, plate: Place, well: Well, liquid_1: Liquid, liquid_2: Liquid) -> None:
        """Mix two liquids in a well of the plate, with a fresh tip for each, and draw the mixture up."""
        await self.device.pendant(
            "create_sample", plate=plate, well=well, liquid_1=liquid_1, liquid_2=liquid_2
        )

    @action(AWAY, BARE, Requires("module", "tip", SAMPLE), duration_s=60)
    async def run_droplet(self) -> None:
        """Let a drop hang from the docked pipette's tip while it is measured, and draw it up again."""
        await self.device.pendant("run_droplet")

    @action(AWAY, WORN, Requires("module", "tip", SAMPLE), Sets("module", "tip", ""), duration_s=30)
    async def dispose_tip(self) -> None:
        """Throw the pipette's tip into the bin, with what is in it."""
        await self.device.pendant("dispose_tip")

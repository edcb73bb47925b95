"""The actions of the Chemspeed."""

from __future__ import annotations

from typing import Annotated

from labos.node import Param, Requires, Sets, Station, Transfers, action
from labos_drivers._wired import OnBenchOrWire
from labos_drivers.chemspeed.driver import ChemspeedDriver
from labos_drivers.chemspeed.simulator import ChemspeedSimulator
from labos_drivers.chemspeed.wire import ChemspeedOnWire

MONOMERS = ("monomer_A", "monomer_B", "monomer_C")

Volumes = Annotated[
    list[float] | None,
    Param(unit="µL", description="of that monomer's solution, a volume for each well"),
]


class Chemspeed(OnBenchOrWire):
    """Synthesis platform under a hood."""

    driver = "chemspeed"
    models = ("chemspeed", "chemspeed_swing")
    stations = (Station("default", access={"lid": "open"}),)
    variables = {"lid": "open"}
    rest = {"lid": "open"}
    follows = ("open_lid", "close_lid", "run_program")
    devices = (ChemspeedSimulator, ChemspeedOnWire, ChemspeedDriver)
    device: ChemspeedSimulator | ChemspeedDriver

    @action(
        Sets("module", "lid", "open"), duration_s=6, safe_to_repeat=True, aliases=("open", "open_chemspeed")
    )
    async def open_lid(self) -> None:
        """Open the hood."""
        await self.device.open_gate()

    @action(
        Sets("module", "lid", "closed"),
        duration_s=6,
        safe_to_repeat=True,
        aliases=("close", "close_chemspeed"),
    )
    async def close_lid(self) -> None:
        """Close the hood."""
        await self.device.close_gate()

    @action(
        Requires("module", "lid", "closed"),
        *(Transfers(monomer, "{wells}", f"{{{monomer}_volumes}}") for monomer in MONOMERS),
        duration_s=3600,
        aliases=("run_protocol", "run_chemspeed"),
    )
    async def run_program(
        self,
        program: Annotated[
            str, Param(aliases=("name_protocol", "program_name"), description="an AutoSuite program")
        ],
        wells: Annotated[
            list[str] | None, Param(description="wells of the plate that the program fills, as [A1, A2]")
        ] = None,
        monomer_A_volumes: Volumes = None,  # noqa: N803
        monomer_B_volumes: Volumes = None,  # noqa: N803
        monomer_C_volumes: Volumes = None,  # noqa: N803
        chain_lengths: Annotated[
            list[float] | None, Param(unit="1", description="units in a chain, a number for each well")
        ] = None,
    ) -> None:
        """Run a program to its end; the hood must be closed.

        A program that makes polymers to measure reads what each well is to get."""
        given = dict(zip(MONOMERS, (monomer_A_volumes, monomer_B_volumes, monomer_C_volumes), strict=True))
        volumes = {monomer: doses for monomer, doses in given.items() if doses is not None}
        await self.device.run_program(program, wells or (), volumes, chain_lengths or ())

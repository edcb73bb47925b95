"""The node of the OT-2: its stations, resources and actions."""

from __future__ import annotations

from typing import Annotated, Any, ClassVar

from labos.core.counts import Counter
from labos.node import Consumes, Draws, Needs, Param, Requires, Station, Transfers, action
from labos_drivers._wired import OnBenchOrWire
from labos_drivers.ot2.driver import OT2Driver
from labos_drivers.ot2.simulator import SLOTS, OT2Simulator
from labos_drivers.ot2.tips import count_used_tips, values_of
from labos_drivers.ot2.wire import OT2OnWire

Volumes = Annotated[
    list[float] | None,
    Param(unit="µL", description="a volume for each destination well, for the protocol to use"),
]

LIQUIDS = ("color_A", "color_B", "color_C", "color_D", "red", "green", "blue", "water")


class OT2(OnBenchOrWire):
    """Liquid handler with eleven deck slots."""

    driver = "ot2"
    models = ("ot2",)
    stations = tuple(Station(slot, kind="deck") for slot in SLOTS)
    levels = {"tips": 960}
    units = dict.fromkeys(LIQUIDS, "uL")
    follows, not_started = ("run_protocol",), "no run was started"
    devices = (OT2Simulator, OT2OnWire, OT2Driver)
    counters: ClassVar[dict[str, Counter]] = {"tips": count_used_tips}
    device: OT2Simulator | OT2Driver

    # The tips are those under `resources:` in the protocol, else the counted ones, else one column (8).
    @action(
        Needs(),
        Requires("labware", "sealed", False),
        Requires("labware", "lidded", False),
        Consumes("tips", "{file:config_path:resources.tips|8}"),
        *(Consumes(liquid, f"{{{liquid}_volumes.sum}}") for liquid in LIQUIDS),
        *(Transfers(liquid, "{destination_wells}", f"{{{liquid}_volumes}}", liquid) for liquid in LIQUIDS),
        Draws("{source_wells}", "{source_volumes}"),
        duration_s=600,
        duration_from="{file:config_path:resources.seconds|600}",
        aliases=("run protocol",),
    )
    async def run_protocol(
        self,
        config_path: Annotated[
            str, Param(file=True, aliases=("protocol_path", "protocol"), description="the protocol to run")
        ],
        use_existing_resources: Annotated[
            bool, Param(description="go on with the tips of the last run")
        ] = False,
        color_A_volumes: Volumes = None,  # noqa: N803 (as public workflows spell it)
        color_B_volumes: Volumes = None,  # noqa: N803
        color_C_volumes: Volumes = None,  # noqa: N803
        color_D_volumes: Volumes = None,  # noqa: N803
        red_volumes: Volumes = None,
        green_volumes: Volumes = None,
        blue_volumes: Volumes = None,
        water_volumes: Volumes = None,
        destination_wells: Annotated[
            list[str] | None, Param(description="wells that receive the volumes, in the same order")
        ] = None,
        source_wells: Annotated[
            list[str] | None, Param(description="wells of the plate that the protocol draws from")
        ] = None,
        source_volumes: Annotated[
            list[float] | None, Param(unit="µL", description="what it draws from each of them, in all")
        ] = None,
        variables: Annotated[
            dict[str, Any] | None, Param(aliases=("vars",), description="other values for the protocol")
        ] = None,
        parameters: Annotated[
            dict[str, Any] | None,
            Param(
                aliases=("run_time_parameters",), description="values of the protocol's run-time parameters"
            ),
        ] = None,
    ) -> dict[str, Any]:
        """Run a protocol on what stands on the deck; the result names the robot's run."""
        volumes = {
            "color_A": color_A_volumes,
            "color_B": color_B_volumes,
            "color_C": color_C_volumes,
            "color_D": color_D_volumes,
            "red": red_volumes,
            "green": green_volumes,
            "blue": blue_volumes,
            "water": water_volumes,
        }
        dispensed = {liquid: amounts for liquid, amounts in volumes.items() if amounts}
        if isinstance(self.device, OT2Simulator):
            drawn = dict(zip(source_wells or [], source_volumes or [], strict=False))
            return await self.device.run_protocol(
                config_path, dispensed, destination_wells or [], drawn, variables or {}
            )
        values = values_of(
            {
                "variables": variables,
                **{f"{liquid}_volumes": amounts for liquid, amounts in volumes.items()},
                "destination_wells": destination_wells,
                "source_wells": source_wells,
                "source_volumes": source_volumes,
                "use_existing_resources": use_existing_resources,
            }
        )
        run = await self.device.prepare(config_path, values, parameters)
        await self.note_handle(run)
        return await self.device.carry_out(run)

    @action(exclusive=False, recovers=True, duration_s=2)
    async def resume_run(self) -> None:
        """Go on with a run that waits for a person: paused, or after an error that was mended."""
        await self.device.resume_run()

    async def trouble(self) -> str:
        """What the run waits for; empty if it does not wait."""
        waits_for = self.device.waits_for if isinstance(self.device, OT2Driver) else ""
        return f"{waits_for[0].upper()}{waits_for[1:]} (resume_run, or the robot's App)." if waits_for else ""

"""The node of the a4S sealer: its stations, resources and actions."""

from __future__ import annotations

from typing import Annotated

from labos.node import Consumes, Needs, Param, Requires, Sets, Station, action
from labos_drivers._wired import OnBenchOrWire
from labos_drivers.a4s_sealer.driver import SealerDriver
from labos_drivers.a4s_sealer.simulator import SealerSimulator
from labos_drivers.a4s_sealer.wire import SealerOnWire


class A4sSealer(OnBenchOrWire):
    """Heat sealer that presses foil onto a plate."""

    driver = "a4s_sealer"
    models = ("A4S_sealer", "a4s_sealer")
    stations = (Station("default"),)
    levels = {"foil": 1000}
    devices = (SealerSimulator, SealerOnWire, SealerDriver)
    device: SealerSimulator | SealerDriver

    @action(
        Needs(),
        Requires("labware", "sealed", False),
        Requires("labware", "lidded", False),
        Sets("labware", "sealed", True),
        Consumes("foil", 1),
        duration_s=25,
        duration_from="22 + {time}",
    )
    async def seal(
        self,
        time: Annotated[float, Param(unit="s", minimum=0, maximum=999.9, aliases=("seal_time",))] = 3.0,
        temperature: Annotated[float, Param(unit="°C", minimum=50, maximum=200, aliases=("temp",))] = 175.0,
    ) -> None:
        """Seal the plate in the nest."""
        await self.device.seal(time, temperature)

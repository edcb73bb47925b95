"""The node of the incubator: its station, variables and actions."""

from __future__ import annotations

from typing import Annotated, Any

from labos.node import Claims, Needs, Param, Releases, Requires, Sets, Station, action
from labos_drivers._simulation import await_answer
from labos_drivers._wired import OnBenchOrWire
from labos_drivers.inheco.driver import InhecoDriver
from labos_drivers.inheco.simulator import InhecoSimulator
from labos_drivers.inheco.wire import InhecoOnWire

Celsius = Annotated[float, Param(unit="°C", minimum=4, maximum=80, aliases=("temp",))]
Rpm = Annotated[float, Param(unit="rpm", minimum=396, maximum=1800, aliases=("speed_rpm", "frequency"))]
Millimetres = Annotated[float, Param(unit="mm", minimum=0.1, maximum=3.0)]


class Inheco(OnBenchOrWire):
    """Incubator for one plate on a drawer, with a shaker under it."""

    driver = "inheco"
    models = ("inheco", "inheco_incubator", "inheco_incubator_shaker")
    stations = (Station("default", access={"door": "open"}),)
    variables = {"door": "closed", "shaking": False}
    rest = {"door": "closed", "shaking": False}
    devices = (InhecoSimulator, InhecoOnWire, InhecoDriver)
    device: InhecoSimulator | InhecoDriver

    @action(
        Requires("module", "shaking", False),
        Sets("module", "door", "open"),
        duration_s=6,
        safe_to_repeat=True,
        aliases=("open",),
    )
    async def open_door(self) -> None:
        """Bring the drawer out."""
        await self.device.open_gate()

    @action(
        Requires("module", "shaking", False),
        Sets("module", "door", "closed"),
        duration_s=7,
        safe_to_repeat=True,
        aliases=("close",),
    )
    async def close_door(self) -> None:
        """Take the drawer in; the incubator feels whether a plate is on it."""
        await self.device.close_gate()

    @action(
        Claims("temperature", "{temperature}"),
        duration_s=1,
        safe_to_repeat=True,
        aliases=("set_target_temperature",),
    )
    async def set_temperature(self, temperature: Celsius) -> None:
        """Heat to a temperature, and keep it; it takes its time to get there."""
        await await_answer(self.device.set_temperature(temperature))

    @action(Releases("temperature"), duration_s=1, safe_to_repeat=True)
    async def stop_temperature(self) -> None:
        """Switch the heater off."""
        await await_answer(self.device.stop_temperature())

    @action(duration_s=1, safe_to_repeat=True, exclusive=False)
    async def get_temperature(self) -> float:
        """The temperature at the plate, in °C."""
        return await await_answer(self.device.read_temperature())

    @action(duration_s=1, safe_to_repeat=True, exclusive=False)
    async def get_status(self) -> dict[str, Any]:
        """Door, plate (null: unknown), shaker, heater, temperatures in °C, error flags."""
        return await await_answer(self.device.read_status())

    @action(
        Needs(),
        Requires("module", "door", "closed"),
        Sets("module", "shaking", True),
        duration_s=2,
        safe_to_repeat=True,
        aliases=("start_shaker", "shake"),
    )
    async def begin_shake(self, speed: Rpm = 600.0, amplitude: Millimetres = 2.0) -> None:
        """Shake the plate in circles, until ``end_shake``."""
        await self.device.begin_shake(speed, amplitude)

    @action(Sets("module", "shaking", False), duration_s=3, safe_to_repeat=True, aliases=("stop_shaker",))
    async def end_shake(self) -> None:
        """Stop shaking, and wait until the plate no longer moves."""
        await self.device.end_shake()

    @action(Sets("module", "door", "closed"), Sets("module", "shaking", False), duration_s=10, recovers=True)
    async def reset(self) -> None:
        """Initialise the incubator: its drawer closes, its shaker stops."""
        await super().reset()

"""The node of the Liconic incubator: its stations, variables and actions."""

from __future__ import annotations

from typing import Annotated

from labos.core.ids import StationName
from labos.node import Move, Param, Requires, Sets, Station, action
from labos_drivers._arm import GRIPPER
from labos_drivers._simulation import await_answer
from labos_drivers._wired import OnBenchOrWire
from labos_drivers.liconic.driver import LiconicDriver
from labos_drivers.liconic.simulator import SLOTS, STACKERS, LiconicSimulator, slot_name
from labos_drivers.liconic.wire import LiconicOnWire

SHELVES = StationName("slots")
EXCHANGE = StationName("exchange")
SLOT = StationName(slot_name("{stacker}", "{slot}"))

Stacker = Annotated[int, Param(unit="1", minimum=1, maximum=STACKERS)]
Slot = Annotated[int, Param(unit="1", minimum=1, maximum=SLOTS, description="level, from below")]
Celsius = Annotated[float, Param(unit="°C", minimum=4, maximum=60, aliases=("temp",))]
Percent = Annotated[float, Param(unit="%RH", minimum=0, maximum=100)]


class Liconic(OnBenchOrWire):
    """Shaking incubator that stores plates in stackers and hands them out."""

    driver = "liconic"
    models = ("liconic", "stx88")
    manipulator = True
    stations = (
        Station("exchange", kind="exchange", claim=False),
        *(
            Station(slot_name(stacker, slot), kind="hotel", claim=False)
            for stacker in range(1, STACKERS + 1)
            for slot in range(1, SLOTS + 1)
        ),
        Station("gripper", kind="gripper"),
    )
    stations = (*stations, Station("slots", kind="hotel", capacity=SLOTS, claim=False))
    variables = {"shaking": False, "target_temp": 22.0, "target_humidity": 40.0}
    devices = (LiconicSimulator, LiconicOnWire, LiconicDriver)
    device: LiconicSimulator | LiconicDriver

    @action(Requires("module", "shaking", False), Move(EXCHANGE, SLOT), duration_s=20)
    async def load_plate(self, stacker: Stacker, slot: Slot) -> None:
        """Take the plate from the exchange into a slot."""
        await self.device.load_plate(stacker, slot)

    @action(Requires("module", "shaking", False), Move(SLOT, EXCHANGE), duration_s=18)
    async def unload_plate(self, stacker: Stacker, slot: Slot) -> None:
        """Bring the plate from a slot to the exchange."""
        await self.device.unload_plate(stacker, slot)

    @action(
        Requires("module", "shaking", False),
        Move(EXCHANGE, SHELVES),
        Sets("labware", "slot", "{result.slot}"),
        duration_s=20,
    )
    async def store(self) -> dict[str, str]:
        """Take the plate from the exchange into a slot that the device chooses and reports."""
        return {"slot": await self.device.store()}

    @action(
        Requires("module", "shaking", False),
        Move(SHELVES, EXCHANGE),
        Sets("labware", "slot", ""),
        duration_s=18,
    )
    async def retrieve(
        self, slot: Annotated[str, Param(description="as reported by ``store``")] = "{labware.slot}"
    ) -> None:
        """Bring a stored plate to the exchange; without a slot, from where this plate was stored."""
        await self.device.retrieve(slot)

    @action(Move(GRIPPER, EXCHANGE), duration_s=10)
    async def put_down(self) -> None:
        """Bring the plate that an interrupted move left on the shovel to the exchange."""
        await self.device.empty_shovel()

    @action(duration_s=1, safe_to_repeat=True, exclusive=False)
    async def get_current_temp(self) -> float:
        """The temperature inside, in °C."""
        return await await_answer(self.device.read_temperature())

    @action(duration_s=1, safe_to_repeat=True, exclusive=False)
    async def get_target_temp(self) -> float:
        """The temperature set, in °C."""
        return await await_answer(self.device.read_target_temperature())

    @action(Sets("module", "target_temp", "{temperature}"), duration_s=1, safe_to_repeat=True)
    async def set_target_temp(self, temperature: Celsius) -> None:
        """Set the temperature; it takes its time to get there."""
        await await_answer(self.device.set_temperature(temperature))

    @action(duration_s=1, safe_to_repeat=True, exclusive=False)
    async def get_current_humidity(self) -> float:
        """The humidity inside, in % RH."""
        return await await_answer(self.device.read_humidity())

    @action(duration_s=1, safe_to_repeat=True, exclusive=False)
    async def get_target_humidity(self) -> float:
        """The humidity set, in % RH."""
        return await await_answer(self.device.read_target_humidity())

    @action(Sets("module", "target_humidity", "{humidity}"), duration_s=1, safe_to_repeat=True)
    async def set_target_humidity(self, humidity: Percent) -> None:
        """Set the humidity; it takes its time to get there."""
        await await_answer(self.device.set_humidity(humidity))

    @action(Sets("module", "shaking", True), duration_s=1, safe_to_repeat=True)
    async def begin_shake(
        self, shaker_speed: Annotated[int, Param(unit="1", minimum=1, maximum=50, aliases=("speed",))] = 10
    ) -> None:
        """Shake all stackers, at a speed of the device's own scale."""
        await await_answer(self.device.shake(shaker_speed))

    @action(Sets("module", "shaking", False), duration_s=1, safe_to_repeat=True)
    async def end_shake(self) -> None:
        """Stop shaking."""
        await await_answer(self.device.shake(0))

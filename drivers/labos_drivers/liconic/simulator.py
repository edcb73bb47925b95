"""A simulated STX88 incubator, without a wire."""

from __future__ import annotations

from typing import Any

from labos.node import DeviceError, Setup
from labos_drivers._simulation import Settling, Simulated

STACKERS = 3
SLOTS = 22
OWN = 4
"""The last stacker, in which the device itself chooses the slot."""
SETTLES_S = 600.0


def slot_name(stacker: int | str, slot: int | str) -> str:
    return f"stacker{stacker}_slot{slot}"


class LiconicSimulator(Simulated):
    """A shovel moves plates between the transfer station and the slots. The controller keeps no inventory:
    ``store`` and ``retrieve`` look at the simulated bench."""

    def __init__(self, setup: Setup) -> None:
        super().__init__(setup)
        self.temperature = Settling(22.0, SETTLES_S, self.read_clock)
        self.humidity = Settling(40.0, SETTLES_S, self.read_clock)
        self.shaking = 0

    def read_temperature(self) -> float:
        return round(self.temperature.now(), 1)

    def read_target_temperature(self) -> float:
        return self.temperature.goal

    def set_temperature(self, celsius: float) -> None:
        self.temperature.aim(celsius)

    def read_humidity(self) -> float:
        return round(self.humidity.now(), 1)

    def read_target_humidity(self) -> float:
        return self.humidity.goal

    def set_humidity(self, percent: float) -> None:
        self.humidity.aim(percent)

    def shake(self, speed: int) -> None:
        if self.moving:
            raise DeviceError(
                f"{self.name} is moving a plate.", effects="none", remedy="Wait until it is idle."
            )
        self.shaking = speed

    async def load_plate(self, stacker: int, slot: int) -> None:
        await self._shovel("exchange", slot_name(stacker, slot), 20)

    async def unload_plate(self, stacker: int, slot: int) -> None:
        if self.top(self.place("exchange")):
            raise self.make_refusal("a plate stands on the transfer station", "Take it away.")
        await self._shovel(slot_name(stacker, slot), "exchange", 18)

    async def store(self) -> str:
        """Move the plate from the transfer station into the lowest free slot of the last stacker; returns the
        slot's name. Raises DeviceError if no slot is free."""
        for number in range(1, SLOTS + 1):
            slot = slot_name(OWN, number)
            if not self.world.at(self.place(slot)):
                await self._shovel("exchange", slot, 20)
                return slot
        raise self.make_refusal(f"stacker {OWN} is full", "Take a plate out first.")

    async def retrieve(self, slot: str) -> None:
        """Move the plate from the slot that ``store`` returned to the transfer station. Without a slot, move
        the only plate of the last stacker. Raises DeviceError if it does not hold exactly one."""
        if not slot:
            full = [s for s in (slot_name(OWN, n) for n in range(1, SLOTS + 1)) if self.top(self.place(s))]
            if len(full) != 1:
                raise self.make_refusal(
                    f"there are {len(full)} plates in stacker {OWN}, and no slot is given", "Name the slot."
                )
            (slot,) = full
        await self._shovel(slot, "exchange", 18)

    async def empty_shovel(self) -> None:
        with self.motion():
            await self.take_time(10)
            self.world.release(self.name, self.place("exchange"))

    async def _shovel(self, source: str, target: str, nominal_s: float) -> None:
        with self.motion():
            if self.shaking:
                self.world.crash(self.name, self.place(source), "moves a plate while it shakes")
            self.world.enter(self.name, self.place(source))
            await self.take_time(0.4 * nominal_s)
            if source != "exchange" and self.top(self.place(source)):
                self.world.work(self.name, "cool", self.place(source), at_h=self.read_clock() / 3600)
            self.world.grip(self.name, self.place(source))
            await self.take_time(0.3 * nominal_s)
            self.world.enter(self.name, self.place(target))
            self.world.release(self.name, self.place(target))
            if target != "exchange":
                warm = {"at_h": self.read_clock() / 3600, "celsius": self.temperature.goal}
                self.world.work(self.name, "incubate", self.place(target), **warm)
            await self.take_time(0.3 * nominal_s)

    def observe(self) -> dict[str, Any]:
        """Whether it shakes, and what the plate sensors of the shovel and the transfer station see."""
        return {
            "shaking": bool(self.shaking),
            "labware": {
                "exchange": bool(self.top(self.place("exchange"))),
                "gripper": bool(self.find_held_plate()),
            },
        }

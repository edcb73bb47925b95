"""A simulated incubator shaker on the bench."""

from __future__ import annotations

from typing import Any

from labos.node import Setup
from labos_drivers._simulation import Gated, Settling

ROOM_C = 22.0
SETTLES_S = 300.0
OPENS_S, CLOSES_S = 6.0, 7.0


class InhecoSimulator(Gated):
    """The simulated incubator: a drawer, closed as shipped, with a heater and a shaker under the plate."""

    variable = "door"

    def __init__(self, setup: Setup) -> None:
        super().__init__(setup)
        self.shut_at_start(*self.behind)
        self.target_c: float | None = None
        self.shaking = False
        self._block = Settling(ROOM_C, SETTLES_S, self.read_clock)

    async def open_gate(self) -> None:
        self.gate_s = OPENS_S
        await super().open_gate()

    async def close_gate(self) -> None:
        self.gate_s = CLOSES_S
        await super().close_gate()

    def set_temperature(self, celsius: float) -> None:
        self.target_c = celsius
        self._block.aim(celsius)

    def stop_temperature(self) -> None:
        self.target_c = None
        self._block.aim(ROOM_C)

    def read_temperature(self) -> float:
        return round(self._block.now(), 1)

    async def begin_shake(self, rpm: float, amplitude_mm: float) -> None:
        with self.motion():
            self.check_closed()
            await self.take_time(2)
            self.world.work(self.name, "shake", self.place("default"), rpm=rpm, mm=amplitude_mm)
            self.shaking = True

    async def end_shake(self) -> None:
        with self.motion():
            await self.take_time(3)
            self.shaking = False

    def read_status(self) -> dict[str, Any]:
        """The status. ``plate`` is None while the drawer is open, because the plate is not detected then."""
        plate = bool(self.top(self.place("default"))) if self.is_closed() else None
        return {
            "door": "closed" if self.is_closed() else "open",
            "plate": plate,
            "shaking": self.shaking,
            "heating": self.target_c is not None,
            "temperature": self.read_temperature(),
            "target": self.target_c,
            "errors": 0,
        }

    def reset(self) -> None:
        super().reset()
        self.shaking = False
        self.shut(*self.behind)

    def observe(self) -> dict[str, Any]:
        status = self.read_status()
        labware = {} if status["plate"] is None else {"default": status["plate"]}
        return {"door": status["door"], "shaking": self.shaking, "labware": labware}

"""A shaker on a serial line, and all that the torture suite needs to know of it."""

from __future__ import annotations

import asyncio
import time
from typing import Annotated, Any

from labos.link import DeviceOnLine, FarEnd, Link, SerialWire, Terminated
from labos.node import (
    Case,
    Consumes,
    DeviceError,
    Fault,
    Needs,
    Node,
    Param,
    Setup,
    Station,
    Torture,
    World,
    action,
    under_way,
)

ANSWER_S = 1.0


class Shaker(Node):
    """Orbital shaker that greases itself, and feels whether it shakes."""

    driver = "shaker"
    stations = (Station("plate"),)
    levels = {"grease": 100}

    async def connect(self) -> None:
        self.line = Link(SerialWire(self.setup.config["port"]), Terminated(b"\r\n"))
        await asyncio.to_thread(self.line.open)

    def ask(self, question: str) -> str:
        return self.line.exchange(question.encode(), ANSWER_S).decode("ascii", "replace")

    async def is_idle(self) -> bool:
        return await asyncio.to_thread(self.ask, "STAT") == "IDLE"

    async def reset(self) -> None:
        await asyncio.to_thread(self.ask, "RESET")

    async def stop(self) -> None:
        if await asyncio.to_thread(self.ask, "HALT") != "OK":
            raise DeviceError("It does not stop.")

    async def resources(self) -> dict[str, float]:
        return {"grease": float(await asyncio.to_thread(self.ask, "GREASE"))}

    @action(Needs("plate"), Consumes("grease", 1), duration_s=60)
    def shake(self, speed: Annotated[float, Param(unit="rpm", minimum=200, maximum=2000)] = 800.0) -> None:
        """Shake the plate for a minute."""
        answer = self.ask(f"SHAKE {speed:.0f}")
        if answer == "LOCKED":
            raise DeviceError("Its drive is locked.", effects="none", remedy="Unlock it.")
        if answer != "OK":
            raise DeviceError(f"It answers {answer}.")
        with under_way():
            while (state := self.ask("STAT")) == "BUSY":
                time.sleep(0.02)
            if state != "IDLE":
                raise DeviceError(f"It says {state} in the place of IDLE.")


class ShakerOnLine(DeviceOnLine):
    """Shakes, greases, halts when it is told to."""

    def __init__(self, setup: Setup, end: FarEnd | None = None) -> None:
        super().__init__(setup, end)
        self.state, self.locked = "IDLE", False

    def obey(self, line: str) -> None:
        match line.split():
            case ["STAT"]:
                self.tell(self.state)
            case ["GREASE"]:
                self.tell(f"{self.world.left(self.name, 'grease'):g}")
            case ["HALT" | "RESET" as order]:
                halted = self.state == "BUSY" and order == "HALT"
                self.forget_plans()
                self.state = "HALTED" if halted else "IDLE"
                self.tell("OK")
            case ["SHAKE", speed] if self.state == "IDLE" and not self.locked:
                self.state = "BUSY"
                self.after(60, lambda: self._end(float(speed)))
                self.tell("OK")
            case ["SHAKE", _]:
                self.tell("LOCKED")
            case _:
                self.tell("WHAT")

    def _end(self, speed_rpm: float) -> None:
        self.world.use(self.name, "grease", 1)
        self.world.work(self.name, "shake", self.place("plate"), speed_rpm=speed_rpm)
        self.state = "IDLE"


def lock(shaker: Any, world: World) -> None:
    shaker.locked = True


def unlock(shaker: Any, world: World) -> None:
    shaker.locked = False


TORTURE = Torture(
    device=ShakerOnLine,
    cases=(Case("shake", {"speed": 900.0}),),
    faults=(Fault("its drive is locked", lock, unlock),),
)

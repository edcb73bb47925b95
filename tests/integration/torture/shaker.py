"""A shaker on a serial line, and all that the torture suite needs to know of it.

As its manual would have it: ``STAT`` goes on to say IDLE for 0.2 s after a start; it counts what it has done
since it was switched on; it takes oil in tenths of a microlitre; it warns of its grease whenever it likes.
"""

from __future__ import annotations

import asyncio
import time
from typing import Annotated, Any

from labos.link import DeviceOnLine, FarEnd, Link, SerialWire, Terminated
from labos.node import (
    Case,
    Consumes,
    Crash,
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
    assume_motion,
)

ANSWER_S, START_S, MOTION_S = 1.0, 1.0, 10.0
FAULTS = {"FAULT 7": "its drive is blocked", "FAULT 9": "its motor is hot"}


class Shaker(Node):
    """Orbital shaker that greases itself, and feels whether it shakes."""

    driver = "shaker"
    stations = (Station("plate"),)
    levels = {"grease": 100}

    async def connect(self) -> None:
        self.line = Link(
            SerialWire(self.setup.config["port"]),
            Terminated(b"\r\n"),
            unasked=lambda said: said.startswith(b"*"),
        )
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
    def shake(
        self,
        speed: Annotated[float, Param(unit="rpm", minimum=200, maximum=2000)] = 800.0,
        time: Annotated[float, Param(unit="s", minimum=10, maximum=90)] = 60.0,
    ) -> None:
        """Shake the plate."""
        before = self.count_done()
        self.start(f"SHAKE {speed:.0f} {time:.1f}")
        with assume_motion():
            self.await_end(before)

    @action(Needs("plate"), duration_s=20)
    def oil(self, volume: Annotated[float, Param(unit="µL", minimum=1, maximum=500)]) -> None:
        """Drop oil onto the plate."""
        before = self.count_done()
        self.start(f"OIL {volume * 10:.0f}")
        with assume_motion():
            self.await_end(before)

    @action(exclusive=False, duration_s=1)
    def count(self) -> int:
        """How often it has done something since it was switched on."""
        return self.count_done()

    def count_done(self) -> int:
        answer = self.ask("COUNT")
        if not answer.isdecimal():
            raise DeviceError(f"It answers {answer} when it is asked for its count.", effects="none")
        return int(answer)

    def start(self, order: str) -> None:
        answer = self.ask(order)
        if answer == "LOCKED":
            raise DeviceError("Its drive is locked.", effects="none", remedy="Unlock it.")
        if answer != "OK":
            raise DeviceError(f"It answers {answer}.")

    def await_end(self, before: int) -> None:
        begun = asked = time.monotonic()
        while (state := self.ask("STAT")) in ("BUSY", "IDLE"):
            if state == "IDLE" and self.count_done() == before + 1:
                return
            # What counts is when it was asked: on a busy computer its answer is read late.
            if state == "IDLE" and asked - begun > START_S:
                raise DeviceError("It rests, and has not done it: was it switched off?")
            if asked - begun > MOTION_S:
                raise DeviceError(f"It is still at work after {MOTION_S:g} s.")
            time.sleep(0.02)
            asked = time.monotonic()
        raise DeviceError(f"It says {state}: {FAULTS.get(state, 'nobody knows what that means')}.")


class ShakerOnLine(DeviceOnLine):
    """Shakes, greases, oils, halts when it is told to."""

    def __init__(self, setup: Setup, end: FarEnd | None = None) -> None:
        super().__init__(setup, end)
        self.state, self.locked, self.count = "IDLE", False, 0

    def obey(self, line: str) -> None:
        match line.split():
            case ["STAT"]:
                self.send_line(self.state)
            case ["COUNT"]:
                self.send_line(f"{self.count}")
            case ["GREASE"]:
                self.send_line(f"{self.world.find_level(self.name, 'grease'):g}")
            case ["HALT" | "RESET" as order]:
                halted = self.state == "BUSY" and order == "HALT"
                self.forget_plans()
                self.state = "HALTED" if halted else "IDLE"
                self.send_line("OK")
            case ["SHAKE" | "OIL", *_] if self.state != "IDLE" or self.locked:
                self.send_line("LOCKED")
            case ["SHAKE", speed, seconds]:
                self._begin(float(seconds), lambda: self._end_shake(float(speed), float(seconds)))
            case ["OIL", tenths]:
                self._begin(20, lambda: self._end_oil(float(tenths) / 10))
            case _:
                self.send_line("WHAT")

    def fail(self, state: str) -> None:
        """It stands still, as over a blocked drive, if it was moving."""
        if self.state == "BUSY":
            self.forget_plans()
            self.state = state

    def damage(self, crash: Crash) -> None:
        self.state = "FAULT 7"

    def _begin(self, seconds: float, end: Any) -> None:
        self.after(2, lambda: setattr(self, "state", "BUSY"))
        self.after(2 + seconds, end)
        self.send_line("OK")

    def _end_shake(self, speed_rpm: float, time_s: float) -> None:
        self.world.use(self.name, "grease", 1)
        self.world.work(self.name, "shake", self.place("plate"), speed_rpm=speed_rpm, time_s=time_s)
        self.state, self.count = "IDLE", self.count + 1

    def _end_oil(self, volume_ul: float) -> None:
        self.world.work(self.name, "oil", self.place("plate"), volume_ul=volume_ul)
        self.state, self.count = "IDLE", self.count + 1


def lock(shaker: Any, world: World) -> None:
    shaker.locked = True
    shaker.fail("FAULT 7")


def unlock(shaker: Any, world: World) -> None:
    shaker.locked = False


def heat(shaker: Any, world: World) -> None:
    shaker.locked = True
    shaker.fail("FAULT 9")


TORTURE = Torture(
    device=ShakerOnLine,
    cases=(
        Case(
            "shake",
            {"speed": 900.0, "time": 50.0},
            record=lambda args: {"speed_rpm": args["speed"], "time_s": args["time"]},
        ),
        Case("oil", {"volume": 25.0}, record=lambda args: {"volume_ul": args["volume"]}),
    ),
    faults=(Fault("its drive is locked", lock, unlock), Fault("its motor is hot", heat, unlock)),
    unasked=(b"*WARN GREASE LOW\r\n",),
    motion="shake",
)

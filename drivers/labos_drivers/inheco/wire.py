"""A simulated incubator shaker, the lowest of its stack, at the far end of a serial line."""

from __future__ import annotations

import re
from collections.abc import Callable

from labos.link import FarEnd
from labos.node import Crash, Setup
from labos_drivers._onwire import OnWire
from labos_drivers._simulation import Settling
from labos_drivers.inheco import protocol
from labos_drivers.inheco.simulator import CLOSES_S, OPENS_S, ROOM_C, SETTLES_S

FREE = ("RTS", "RDA", "RDS", "RLW", "RFV", "RSE", "RHE", "RTT", "RAT", "REF", "REE", "AID")
"""What it answers before it is initialised."""

HEATER_FLAG = 1 << 8
STARTS_S, RUNS_DOWN_S = 1.0, 2.0


class InhecoOnWire(OnWire):
    """The simulated device. ``started``: it was switched on and initialised before; otherwise its first
    answer reports a reset. ``jammed``: its drawer does not complete a motion. ``heater_broken``: it does not
    heat."""

    serial = "2100.0123"

    def __init__(self, setup: Setup, end: FarEnd | None = None, *, started: bool = True) -> None:
        super().__init__(setup, end)
        self.jammed = self.heater_broken = False
        self.kind = protocol.MP_SHAKER
        self.shaker = "0"
        self.heats = False
        self.target = 370
        self._initialised, self._reports_reset = started, not started
        self.shut_at_start("default")
        self.drawer = "0" if self.world.is_shut(self.place("default")) else "1"
        self.plate_known = started
        self._block = Settling(ROOM_C, SETTLES_S, self.now_s)
        self._set = (30, 30, 100, 100, 90)
        self._run = self._set
        self._received = b""

    def pull(self, *, open_: bool) -> None:
        """A person moves the drawer by hand."""
        self.drawer = "1" if open_ else "0"
        self.world.gate("somebody", self.place("default"), shut=not open_)

    # -- receiving ---------------------------------------------------------------------------

    def receive(self, data: bytes) -> None:
        self._received += data
        while self._received and len(self._received) > self._received[0] > 3:
            size = self._received[0] + 1  # the length does not include its own byte
            frame, self._received = self._received[:size], self._received[size:]
            self._take(frame)
        if self._received and self._received[0] <= 3:
            self._received = b""  # noise

    def _take(self, frame: bytes) -> None:
        if frame[1] != 0x30 + protocol.USUAL_ID:
            return  # the command is for another stack
        text = frame[3:-1].decode("ascii", "replace")
        if frame[-1] != protocol.check_sum(frame[:-1]) or frame[2] != 0xC0 + len(text):
            self._answer("", 4)
        elif match := re.fullmatch(r"T0(\d)([A-Z]{3})(.*)", text):
            floor, name, arguments = match.groups()
            self._answer(*(self._obey(name, arguments) if floor == "0" else ("", 14)))
        else:
            self._answer("", protocol.BAD_COMMAND)

    def _answer(self, text: str, error: int) -> None:
        self.send(protocol.make_answer(text, error))

    def _obey(self, name: str, arguments: str) -> tuple[str, int]:
        if self._reports_reset:
            self._reports_reset = False
            return "", protocol.RESET
        if not self._initialised and name not in FREE:
            return "", protocol.NOT_INITIALISED
        if name.startswith("R"):
            return self._report(name, arguments)
        orders: dict[str, Callable[[], int]] = {
            "AID": self._initialise,
            "AOD": lambda: self._drive("1"),
            "ACD": lambda: self._drive("0"),
            "ASE": lambda: self._shake(arguments),
            "SSP": lambda: self._set_shaker(arguments),
            "STT": lambda: self._set_target(arguments),
            "SHE": lambda: self._heat(arguments == "1"),
        }
        return ("", orders[name]()) if name in orders else ("", protocol.BAD_COMMAND)

    def _report(self, name: str, arguments: str) -> tuple[str, int]:
        if name == "RDS" and self.drawer == "":
            return "", protocol.BETWEEN
        reports = {
            "RTS": self.kind,
            "RDA": "1",
            "RDS": self.drawer,
            "RLW": self._sense_plate(),
            "RSE": self.shaker,
            "RHE": str(int(self.heats)),
            "RTT": str(self.target),
            "RAT": str(round(self.compute_temperature() * 10)),
            "REF": str(HEATER_FLAG * self.heater_broken),
            "RFV": self.serial if arguments == "2" else "V3.0",
            "REE": "0" if self._initialised and self.plate_known else "1" if self._initialised else "3",
        }
        return (reports[name], protocol.OK) if name in reports else ("", protocol.BAD_COMMAND)

    def _sense_plate(self) -> str:
        if self.drawer != "0":
            return "8"
        if not self.plate_known:
            return "7"
        return protocol.PLATE if self.top(self.place("default")) else protocol.NO_PLATE

    # -- carrying commands out ---------------------------------------------------------------

    def _initialise(self) -> int:
        self.forget_plans()
        self._initialised = True
        self.shaker, self.heats = "0", False
        self._aim()
        return self._drive("0")

    def _drive(self, goal: str) -> int:
        if self.shaker != "0":
            return protocol.NOT_EXECUTABLE
        if self.drawer != goal:
            self.drawer = ""
            self.world.enter(self.name, self.name)
            if goal == "0":
                self.shut("default")
            if not self.jammed:
                self.after(OPENS_S if goal == "1" else CLOSES_S, lambda: self._arrive(goal))
        return protocol.OK

    def _arrive(self, goal: str) -> None:
        self.drawer = goal
        self.world.leave(self.name)
        if goal == "1":
            self.open("default")
        else:
            self.plate_known = True

    def _set_target(self, arguments: str) -> int:
        if not arguments.isdecimal() or not 0 <= int(arguments) <= 800:
            return protocol.BAD_OPERAND
        self.target = int(arguments)
        self._aim()
        return protocol.OK

    def _heat(self, on: bool) -> int:
        self.heats = on and not self.heater_broken
        self._aim()
        return protocol.OK

    def _aim(self) -> None:
        self._block.aim(self.target / 10 if self.heats else ROOM_C)

    def compute_temperature(self) -> float:
        return self._block.now()

    def _set_shaker(self, arguments: str) -> int:
        if not re.fullmatch(r"\d+(,\d+){4}", arguments):
            return protocol.BAD_OPERAND
        values = tuple(map(int, arguments.split(",")))
        x_mm, y_mm, x_hz, y_hz, phase = values
        if max(x_mm, y_mm) > 30 or not all(66 <= hz <= 300 for hz in (x_hz, y_hz)) or phase > 360:
            return protocol.BAD_OPERAND
        self._set = x_mm, y_mm, x_hz, y_hz, phase
        return protocol.OK

    def _shake(self, how: str) -> int:
        if how == "0":
            if self.shaker == protocol.SHAKES:
                self.shaker = protocol.RUNS_DOWN
                self.after(RUNS_DOWN_S, self._come_to_rest)
            return protocol.OK
        if self.drawer != "0":
            return protocol.NOT_EXECUTABLE
        if how == "1" and self._sense_plate() != protocol.PLATE:
            return protocol.LABWARE
        if how not in ("1", "ND"):
            return protocol.BAD_OPERAND
        if self.shaker == "0":
            self._run = self._set
            self.after(STARTS_S, self._begin)
        return protocol.OK

    def _begin(self) -> None:
        self.shaker = protocol.SHAKES
        place = self.place("default")
        x_mm, _, x_hz, *_ = self._run
        self.world.work(
            self.name, "shake", place if self.top(place) else "", rpm=round(x_hz * 6), mm=x_mm / 10
        )

    def _come_to_rest(self) -> None:
        self.shaker = "0"

    def damage(self, crash: Crash) -> None:
        """Does nothing, because the incubator does not notice a collision."""

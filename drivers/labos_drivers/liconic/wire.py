"""A simulated STX at the far end of a serial line: a PLC that controls a shovel."""

from __future__ import annotations

import re

from labos.link import FarEnd
from labos.node import Crash, Setup
from labos_drivers._onwire import OnLine
from labos_drivers._simulation import Settling
from labos_drivers.liconic import protocol
from labos_drivers.liconic.simulator import SETTLES_S, slot_name

TARGETS = {protocol.TEMPERATURE_NOW: protocol.TEMPERATURE, protocol.HUMIDITY_NOW: protocol.HUMIDITY}
EXPORT_BLOCKED, NO_PLATE, GENERAL = 13, 16, 1


class LiconicOnWire(OnLine):
    """The state and the behaviour of the device. ``started``: it is switched on and initialised. ``stale_s``:
    for this time after a start (lab s), its ready flag shows the old state, also if it was reset before."""

    line_end = b"\r"

    def __init__(self, setup: Setup, end: FarEnd | None = None, *, started: bool = True) -> None:
        super().__init__(setup, end)
        self.ready = started
        self.words = {protocol.TEMPERATURE: 220, protocol.HUMIDITY: 400}
        self.shakes = False
        self.stale_s = 0.0
        self.initialised = 0
        self._is_open = False
        self._error = 0
        self._climate = {word: Settling(value, SETTLES_S, self.now_s) for word, value in self.words.items()}

    def power_cycle(self) -> None:
        """Switch off and on. The connection is closed then, and the device is not initialised."""
        self._is_open = self.ready = False

    # -- receiving ---------------------------------------------------------------------------

    def obey(self, line: str) -> None:
        self.send(self._answer(line).encode() + protocol.ANSWER_END)

    def _answer(self, line: str) -> str:
        if line == "CR":
            self._is_open = True
            return "CC"
        if not self._is_open:
            return "E1"
        if line == "CQ":
            self._is_open = False
            return "CF"
        if match := re.fullmatch(r"RD DM(\d+)", line):
            return f"{self._read_word(int(match[1])):05d}"
        if match := re.fullmatch(r"WR DM(\d+) (\d{1,5})", line):
            return self._write(int(match[1]), int(match[2]))
        if match := re.fullmatch(r"RD (\d+)", line):
            return str(int(self._read_relay(int(match[1]))))
        if match := re.fullmatch(r"(ST|RS) (\d+)", line):
            return self._order(int(match[2]), match[1] == "ST")
        return "E1"

    def _read_relay(self, number: int) -> bool:
        match number:
            case protocol.READY:
                return self.ready
            case protocol.ERROR:
                return bool(self._error)
            case protocol.SHAKING:
                return self.shakes
            case protocol.ON_STATION:
                return bool(self.top(self.place("exchange")))
            case protocol.ON_SHOVEL:
                return bool(self.find_held_plate())
        return False

    def _read_word(self, number: int) -> int:
        if number == protocol.ERROR_CODE:
            return self._error
        if number in TARGETS:
            return round(self._climate[TARGETS[number]].now())
        return self.words.get(number, 0)

    def _write(self, number: int, value: int) -> str:
        if number in TARGETS:
            return "E4"
        if number in self._climate:
            self._climate[number].aim(value)
        self.words[number] = value
        return "OK"

    def _order(self, relay: int, value: bool) -> str:
        slot = slot_name(self.words.get(protocol.STACKER, 0), self.words.get(protocol.SLOT, 0))
        match relay:
            case protocol.RESET:
                self.forget_plans()
                self._error = 0
                if not self.stale_s:
                    self.ready = False
            case protocol.INITIALISE if self.stale_s:
                self.after(self.stale_s, self._initialise, exact=True)
            case protocol.INITIALISE:
                self._initialise()
            case protocol.SHAKING:
                self.shakes = value
            case protocol.IMPORT if self.ready:
                self._begin("exchange", slot, 20)
            case protocol.EXPORT if self.ready:
                if self._read_relay(protocol.ON_STATION):
                    self._fail(EXPORT_BLOCKED)
                else:
                    self._begin(slot, "exchange", 18)
            case protocol.SHOVEL_OUT if self.ready:
                self.ready = False
                self.after(8, lambda: self._place("exchange", 2))
        return "OK"

    def _initialise(self) -> None:
        def finish_initialising() -> None:
            self.initialised += 1
            self._become_ready()

        self.ready = False
        self.after(15, finish_initialising)

    # -- carrying commands out ---------------------------------------------------------------

    def _begin(self, source: str, target: str, nominal_s: float) -> None:
        self.ready = False
        if self.shakes:
            self.world.crash(self.name, self.place(source), "moves a plate while it shakes")
        self.world.enter(self.name, self.place(source))
        self.after(0.4 * nominal_s, lambda: self._pick(source, target, nominal_s))

    def _pick(self, source: str, target: str, nominal_s: float) -> None:
        if not self.top(self.place(source)):
            self._fail(NO_PLATE)
            return
        if source != "exchange":
            self.world.work(self.name, "cool", self.place(source), at_h=self.read_clock() / 3600)
        self.world.grip(self.name, self.place(source))
        self.after(0.3 * nominal_s, lambda: self._place(target, 0.3 * nominal_s))

    def _place(self, target: str, back_s: float) -> None:
        self.world.enter(self.name, self.place(target))
        self.world.release(self.name, self.place(target))
        if target != "exchange":
            warm = {"at_h": self.read_clock() / 3600, "celsius": self.words[protocol.TEMPERATURE] / 10}
            self.world.work(self.name, "incubate", self.place(target), **warm)
        self.after(back_s, self._become_ready)

    def _become_ready(self) -> None:
        self.ready = True
        self.world.leave(self.name)

    def _fail(self, code: int) -> None:
        self._error = code
        self._become_ready()

    def damage(self, crash: Crash) -> None:
        self.forget_plans()
        self._error = GENERAL

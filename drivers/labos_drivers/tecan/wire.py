"""A simulated Infinite 200 M, with a pipe for bytes instead of its USB endpoints."""

from __future__ import annotations

import re

from labos.link import FarEnd
from labos.node import Crash, Setup
from labos_drivers._onwire import OnWire
from labos_drivers.tecan import protocol
from labos_drivers.tecan.protocol import GRIDS, Calibration, frame
from labos_drivers.tecan.simulator import optics_of

CALIBRATION = Calibration(dark=120, bright=50120, reference_dark=80, reference_bright=40080)
SETTINGS = re.compile(
    r"MODE (ABS|LUM|FI\.TOP|FI\.BOTTOM)|(EXCITATION|EMISSION|TIME|GAIN|READS|POSITION|MIRROR) CLEAR"
    r"|(READS|TIME|GAIN|POSITION|EXCITATION|EMISSION) \S+|SCAN DIRECTION=(ALTUP|UP)|BEAM DIAMETER=\d+"
    r"|RATIO LABELS=1|KEYLOCK (ON|OFF)|TERMINATE|CHECK \S+"
)
GATE_S, MOVE_S, INIT_S, REFERENCE_S, WELL_S = 4.0, 0.3, 8.0, 2.0, 0.5


class TecanOnWire(OnWire):
    """The simulated device. It answers questions at once, and carries out commands one after the other. Its
    lamp may be dead (``lamp_dead``), its carrier ``jammed``, or it ``refuses`` every command. The carrier
    needs ``gate_s`` (lab seconds) to move out or in."""

    def __init__(self, setup: Setup, end: FarEnd | None = None, *, gate_s: float = GATE_S) -> None:
        super().__init__(setup, end)
        self._gate_s = gate_s
        self.busy = self._is_stuck = self.jammed = self.lamp_dead = self.refuses = False
        self.sensor = "UNDEFINED"
        self.position = protocol.IN if self.world.is_shut(self.place("default")) else protocol.OUT
        if self.position == protocol.IN:
            self._update_sensor()
        self._nm = 0.0
        self._at = (0, 0)
        self._received = b""
        self._waiting: list[str] = []

    def push(self) -> None:
        """A person pushes the carrier in by hand; the plate sensor is not read."""
        self.position, self.sensor = protocol.IN, "UNDEFINED"
        self.world.gate("somebody", self.place("default"), shut=True)

    def pull(self) -> None:
        """A person pulls the carrier out by hand."""
        self.position = protocol.OUT
        self.world.gate("somebody", self.place("default"), shut=False)

    def free(self) -> None:
        """A person frees the carrier. If it was stuck in a motion, it stays there, on standby."""
        self.jammed = False
        if self._is_stuck:
            self._is_stuck = False
            if self.position == protocol.OUT and self.world.is_shut(self.place("default")):
                self.open("default")  # it did not arrive inside
            self.after(0, self._stand_by, exact=True)

    # -- receiving ---------------------------------------------------------------------------

    def receive(self, data: bytes) -> None:
        self._received += data
        while (begin := self._received.find(protocol.STX)) >= 0:
            end = self._received.find(protocol.ETX, begin)
            if end < 0 or len(self._received) < end + 6:
                return
            text = self._received[begin + 1 : end]
            trailer = self._received[end + 1 : end + 5]
            self._received = self._received[end + 6 :]
            if trailer == bytes((0, 0, len(text) & 0xFF, protocol.check_sum(text))):
                self._obey(text.decode("ascii", "replace"))
            else:
                self._send("-")
        self._received = b""

    def _send(self, text: str) -> None:
        self.send(frame(text))

    def _numbers(self, packet: bytes) -> None:
        self.send(frame(f"{len(packet)},BIN:") + packet + bytes(4))

    def _obey(self, command: str) -> None:
        queries = {
            "QQ": "BY" if self.busy else protocol.STANDBY,
            "?ABSOLUTE MTP,POS": "FLOATING" if self.busy else self.position,
            "?SENSOR PLATEPOS": self.sensor,
            "#BEAM DIAMETER": "700|1000|3000",
            "#RATIO LABELS": "1",
            "#EMISSION ATTENUATION": "0",
        }
        if command in queries:
            self._send(queries[command])
        elif self.busy:
            if not command.startswith("BY#"):  # the message of standby is the answer to ``BY#``
                self._waiting.append(command)
        elif self.refuses:
            self._send(protocol.REFUSED)
        elif command.startswith("BY#"):
            self._send(protocol.STANDBY)
        elif match := re.fullmatch(r"ABSOLUTE MTP,(IN|OUT)", command):
            self._send("BY#T5000")
            self._begin(self._gate_s)
            self._drive(match[1])
        elif match := re.fullmatch(r"ABSOLUTE MTP,(?:X=(\d+),)?Y=(\d+)", command):
            self._go(match)
        elif match := re.fullmatch(r"SCANX (\d+),(\d+),(\d+)", command):
            self._scan(*map(int, match.groups()))
        elif command == "PREPARE REF":
            self._begin(REFERENCE_S)
            self.after(REFERENCE_S, self._reference)
        elif command == "INIT FORCE":
            self._begin(INIT_S)
            self.after(INIT_S, self._finish_initialising)
        elif SETTINGS.fullmatch(command):
            if match := re.fullmatch(r"EXCITATION \d,ABS,(\d+),\d+,0", command):
                self._nm = int(match[1]) / 10
            self._send(protocol.STANDBY)
        else:
            self._send(protocol.REFUSED)

    # -- motions -----------------------------------------------------------------------------

    def _begin(self, seconds: float) -> None:
        self.busy = True
        self.world.enter(self.name, self.name)

    def _stand_by(self) -> None:
        self.busy = False
        self.world.leave(self.name)
        self._send(protocol.STANDBY)
        while self._waiting and not self.busy:
            self._obey(self._waiting.pop(0))

    def _drive(self, goal: str) -> None:
        if goal == protocol.IN and self.position != goal:
            self.shut("default")
        self.after(self._gate_s, lambda: self._arrive(goal))

    def _arrive(self, goal: str) -> None:
        if self.jammed:
            self._is_stuck = True
            return
        self.position = goal
        if goal == protocol.OUT:
            self.open("default")
        else:
            self._update_sensor()
        self._stand_by()

    def _update_sensor(self) -> None:
        self.sensor = "TAKEN" if self.top(self.place("default")) else "FREE"

    def _finish_initialising(self) -> None:
        if not self.jammed:
            self.shut("default")
            self.position = protocol.IN
            self._update_sensor()
        self._stand_by()

    def _go(self, match: re.Match[str]) -> None:
        if self.position == protocol.OUT:
            self._send(protocol.REFUSED)
            return
        x, y = match.groups()
        self._at = (int(x) if x else self._at[0], int(y))
        self._begin(MOVE_S)
        self.after(MOVE_S, self._stand_by)

    def _reference(self) -> None:
        seen = CALIBRATION._replace(bright=CALIBRATION.dark) if self.lamp_dead else CALIBRATION
        self._numbers(protocol.write_calibration(self._nm, seen))
        self._stand_by()

    def _scan(self, first: int, last: int, count: int) -> None:
        grid = next((grid for grid in GRIDS.values() if grid.columns == count), GRIDS[96])
        row = round((self._at[1] - grid.y(0)) / (grid.y(1) - grid.y(0)))
        self._begin(WELL_S * count)
        for n in range(count):
            x = first + (last - first) * n // max(count - 1, 1)
            column = round((x - grid.x(0)) / (grid.x(1) - grid.x(0)))
            well = grid.well(min(max(row, 0), grid.rows - 1), min(max(column, 0), grid.columns - 1))
            self.after(WELL_S * (n + 1), lambda well=well: self._flash(well), exact=True)  # type: ignore[misc]
        self.after(WELL_S * count + 0.1, lambda: self._end_of_row(row), exact=True)

    def _flash(self, well: str) -> None:
        plate = self.top(self.place("default"))
        od = optics_of(self.world, plate)(well, self._nm) if plate else 0.0
        self.crash_if_lidded(self.place("default"), "reads through a lid")
        light = 10**-od * self._random.gauss(1.0, 0.002)
        sample = round(CALIBRATION.dark + light * (CALIBRATION.bright - CALIBRATION.dark))
        self._numbers(protocol.write_measurement(self._nm, min(sample, 65535), CALIBRATION.reference_bright))

    def _end_of_row(self, row: int) -> None:
        place = self.place("default")
        self.world.work(self.name, "read", place if self.top(place) else "", nm=self._nm, row=row)
        self._stand_by()

    def damage(self, crash: Crash) -> None:
        self.forget_plans()
        self.busy = False
        self._send("ERR")

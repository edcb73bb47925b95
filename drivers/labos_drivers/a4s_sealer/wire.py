"""A simulated a4S at the far end of a serial line.

It sends its status every second, with each answer, and when the shuttle arrives or an error occurs. It
accepts a command with ``Y`` and rejects it with ``N``. Its temperature changes by 2 °C per second. Its
shuttle needs about 3 s to move in or out. Its error numbers are invented, because no real ones are published.
"""

from __future__ import annotations

import re
from collections.abc import Callable

from labos.link import FarEnd
from labos.node import Crash, Setup
from labos_drivers._onwire import OnWire
from labos_drivers.a4s_sealer import protocol
from labos_drivers.a4s_sealer.protocol import Status, check_sum

STREAM_S = 1.0
DEGREES_PER_S = 2.0
ROOM_C, STORED_C = 22.0, 175.0
JAMMED, FOIL_GONE = 11, 12

COMMAND = re.compile(rb"\*00(?P<name>[A-Z][A-Z0-9])(?:=(?P<argument>\d*))?(?:(?:zz|ZZ|[A-P]{2})!|ZZ)")
REST = re.compile(rb"^[^*]*|\*[^*!]*!")


class SealerOnWire(OnWire):
    """The state and the behaviour of the device. With ``rejects_twice``, an acceptance follows each of its
    rejections, as on some real devices."""

    drawers = ("default",)

    def __init__(self, setup: Setup, end: FarEnd | None = None, *, cold: bool = False) -> None:
        super().__init__(setup, end)
        self.system = protocol.IDLE
        self.error = 0
        self.shuttle = protocol.SHUTTLE_OUT
        self.has_roll = self.door_is_shut = True
        self.rejects_twice = False
        self._target_c = STORED_C
        self._from_c = ROOM_C if cold else STORED_C
        self._since_s = 0.0
        self._press_s = 3.0
        self._cycle_ends_s = 0.0
        self._received = b""
        self._goal, self._ways, self._cycle = protocol.SHUTTLE_OUT, 0, False

    def power_on(self) -> None:
        self._stream()

    # -- receiving ---------------------------------------------------------------------------

    def receive(self, data: bytes) -> None:
        self._received += data
        while self._received:
            if match := COMMAND.match(self._received):
                self._received = self._received[match.end() :]
                self._obey(match["name"].decode(), int(match["argument"] or 0))
            elif (match := REST.match(self._received)) and match.end():
                self._received = self._received[match.end() :]
                if match[0].startswith(b"*"):
                    self._send_answer(b"N01")
            else:
                return

    def _obey(self, name: str, argument: int) -> None:
        orders: dict[str, Callable[[], None]] = {
            "SR": self._reset,
            "MO": self._shuttle_out,
            "MC": self._shuttle_in,
            "GS": self._begin,
            "DH": lambda: self._heat(argument),
            "DT": lambda: self._set_time(argument),
            "H1": lambda: self._heat(self._target_c or STORED_C),
            "H0": lambda: self._heat(0),
        }
        moves = name in ("MO", "MC", "GS")
        unfit = moves and self.system in (protocol.SINGLE_CYCLE, protocol.ERROR)
        may_seal = self._find_foil_left() and self.has_roll and self.door_is_shut
        if name == "GS" and not (may_seal and self.shuttle != protocol.SHUTTLE_MIDDLE):
            unfit = True
        self._send_answer(b"N00" if name not in orders or unfit else b"Y00")
        if name in orders and not unfit:
            orders[name]()
            self._send_status()

    # -- carrying commands out ---------------------------------------------------------------

    def _reset(self) -> None:
        """Clear the error and home the shuttle. Meanwhile the status is that of a cycle; the status that a
        real device sends while it homes is not published."""
        self.forget_plans()
        self.error, self.system = 0, protocol.SINGLE_CYCLE
        self._stream()
        self._shuttle_out()

    def _shuttle_out(self) -> None:
        self._go(protocol.SHUTTLE_OUT)

    def _shuttle_in(self) -> None:
        self.shut(*self.drawers)
        self._go(protocol.SHUTTLE_IN)

    def _go(self, goal: int) -> None:
        self.shuttle, self._goal = protocol.SHUTTLE_MIDDLE, goal
        self._ways += 1
        way = self._ways
        self.after(3, lambda: self._arrive(way))

    def _arrive(self, way: int) -> None:
        if way != self._ways:
            return  # a later command has sent the shuttle elsewhere
        self.shuttle = self._goal
        if self.shuttle == protocol.SHUTTLE_OUT:
            self.open(*self.drawers)
            if self.system == protocol.SINGLE_CYCLE:
                self.system = protocol.FINISHED if self._cycle else protocol.IDLE
                self._cycle = False
                self.world.leave(self.name)
                self.after(2, self._become_idle)
        self._send_status()

    def _become_idle(self) -> None:
        if self.system == protocol.FINISHED:
            self.system = protocol.IDLE

    def _begin(self) -> None:
        self.system, self._cycle = protocol.SINGLE_CYCLE, True
        self.world.enter(self.name, self.name)
        self._cycle_ends_s = self.now_s() + 22 + self._press_s
        self._shuttle_in()
        self.after(8 + self._press_s, self._press)

    def _press(self) -> None:
        nest = self.place("default")
        if self._find_foil_left() < 1:
            self._fail(FOIL_GONE)
            return
        self.crash_if_sealed(nest, "seals a sealed plate")
        self.crash_if_lidded(nest, "seals a lid")
        self.world.use(self.name, "foil", 1)
        self.world.work(
            self.name, "seal", nest, time_s=self._press_s, temperature_c=round(self._compute_temperature())
        )
        self.after(11, self._shuttle_out)

    def damage(self, crash: Crash) -> None:
        self._fail(JAMMED, comes_out=False)

    def _fail(self, error: int, *, comes_out: bool = True) -> None:
        self.forget_plans()
        self.system, self.error, self._cycle = protocol.ERROR, error, False
        self._stream()
        if comes_out:
            self._shuttle_out()
            self.world.leave(self.name)

    def _set_time(self, tenths: int) -> None:
        self._press_s = tenths / 10

    def _heat(self, degrees: float) -> None:
        self._from_c, self._since_s = self._compute_temperature(), self.now_s()
        self._target_c = degrees

    # -- sending -----------------------------------------------------------------------------

    def make_status(self) -> Status:
        temperature = self._compute_temperature()
        goal = self._target_c or ROOM_C
        heater = protocol.HEATER_OFF
        if self._target_c:
            away = goal - temperature
            heater = protocol.READY if abs(away) < 0.5 else protocol.HEATING if away > 0 else protocol.COOLING
        sensors = (
            self.shuttle
            | protocol.DOOR * self.door_is_shut
            | protocol.ROLL * (self.has_roll and self._find_foil_left() > 0)
            | protocol.HEATER_UP
            | 0x80
        )
        left = self._cycle_ends_s - self.now_s() if self.system == protocol.SINGLE_CYCLE else 0
        seconds = int(self.now_s())
        return Status(
            temperature,
            self.system,
            heater,
            self.error,
            0,
            sensors,
            max(int(left), 0),
            f"{seconds // 3600 % 24:02d}:{seconds // 60 % 60:02d}:{seconds % 60:02d}",
        )

    def _compute_temperature(self) -> float:
        goal = self._target_c or ROOM_C
        change = DEGREES_PER_S * (self.now_s() - self._since_s)
        if self._from_c < goal:
            return min(goal, self._from_c + change)
        return max(goal, self._from_c - change)

    def _find_foil_left(self) -> float:
        left = self.world.find_level(self.name, "foil")
        return 1000.0 if left is None else left

    def _stream(self) -> None:
        self._send_status()
        # At most 20 records per second of real time: more would overload the line without new data.
        self.after(max(STREAM_S, 0.05 * self._pace), self._stream, exact=True)

    def _send_status(self) -> None:
        self._send_record(self.make_status().body())
        self.send(b"\r")

    def _send_answer(self, body: bytes) -> None:
        self._send_record(self.make_status().body())
        self._send_record(body)
        if body.startswith(b"N") and self.rejects_twice:
            self._send_record(b"Y00")
        self.send(b"\r")

    def _send_record(self, body: bytes) -> None:
        self.send(b"*" + body + check_sum(body) + b"!")

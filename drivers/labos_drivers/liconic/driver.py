"""The driver of the STX incubator, over its serial port."""

from __future__ import annotations

import re
import time
from collections.abc import Callable
from typing import Any

from labos.errors import DeviceError, Garbled
from labos.link import Link, SerialWire, Terminated
from labos.node import Setup
from labos_drivers._limits import make_serial_wire
from labos_drivers._wired import DeviceOnWire, Wired, during_motion, off_loop
from labos_drivers.liconic import protocol

ANSWER_S, BEGIN_S, MOVE_S, START_S = 2.0, 2.0, 60.0, 300.0
POLL_S = 0.1
RESET_PAUSE_S = 0.5
"""After a reset the controller takes no start at once."""
WHO = "a Liconic STX"
NAMED_SLOT = re.compile(r"stacker(\d+)_slot(\d+)")


class LiconicDriver(Wired):
    """Commands of the device. Its answer ``OK`` does not mean that a motion has ended. The plate sensors and
    the ready flag show the end. Just after a command, the flag may still show the old state."""

    deadlines = ("answer", "begin", "move", "start")
    link: Link

    def __init__(self, setup: Setup, port: str, simulator: DeviceOnWire | None = None) -> None:
        super().__init__(setup, port, simulator)
        # A pseudo-terminal accepts even parity only when it is first opened; connecting again would fail.
        real = simulator is None
        self.link = Link(
            make_serial_wire(setup, port, baudrate=protocol.BAUDRATE, parity="E")
            if real
            else SerialWire(port),
            Terminated(protocol.ANSWER_END, send_end=protocol.ASK_END),
            name=setup.name,
            identify=self._recognise,
            expected=WHO,
        )

    # -- plates ------------------------------------------------------------------------------

    @off_loop
    def load_plate(self, stacker: int, slot: int) -> None:
        """Move a plate from the transfer station into a slot. Raises DeviceError."""
        with self.motion():
            self._check_relay(
                protocol.ON_STATION, True, "no plate stands on the transfer station", "Put one there."
            )
            self._transfer(protocol.IMPORT, stacker, slot, arrives=False)

    @off_loop
    def unload_plate(self, stacker: int, slot: int) -> None:
        """Move a plate from a slot to the transfer station. Raises DeviceError."""
        with self.motion():
            self._unload(stacker, slot)

    @off_loop
    def store(self) -> str:
        """Always raises DeviceError. The controller keeps no inventory and does not detect an occupied slot.
        So it cannot choose a free one."""
        raise self.make_refusal(
            "this device does not choose slots", "Name the stacker and the slot: load_plate."
        )

    @off_loop
    def retrieve(self, slot: str) -> None:
        """Move the plate from the slot with this name to the transfer station. Raises DeviceError."""
        named = NAMED_SLOT.fullmatch(slot)
        if named is None:
            raise self.make_refusal(f"{slot!r} names no slot", "Name it as stacker1_slot7.")
        with self.motion():
            self._unload(int(named[1]), int(named[2]))

    @off_loop
    def empty_shovel(self) -> None:
        """Move the plate from the shovel to the transfer station. Raises DeviceError."""
        with self.motion():
            self._check_relay(
                protocol.ON_SHOVEL, True, "no plate is on the shovel", "Look where the plate is."
            )
            self._check_relay(
                protocol.ON_STATION, False, "a plate stands on the transfer station", "Take it away."
            )
            self._write_relay(protocol.SHOVEL_OUT)
            with self.assume_motion():
                self._await_end(lambda: self._read_relay(protocol.ON_STATION))
                self._check_sensors(True, "the shovel")

    @off_loop
    def reset(self) -> None:
        """Clear an error and initialise the device: it homes the shovel, the lift and the carousel."""
        self._ask(b"CR")
        self._write_relay(protocol.RESET)
        time.sleep(RESET_PAUSE_S)
        self._write_relay(protocol.INITIALISE)
        self._await_end(lambda: False, self.limit_s("start", START_S), begins=False)
        self.resume()

    @during_motion
    def is_idle(self) -> bool:
        """Whether the device is ready. After it was switched on, it is not ready until it has been reset."""
        return self._read_relay(protocol.READY)

    @during_motion
    def observe(self) -> dict[str, Any]:
        return {
            "shaking": self._read_relay(protocol.SHAKING),
            "labware": {
                "exchange": self._read_relay(protocol.ON_STATION),
                "gripper": self._read_relay(protocol.ON_SHOVEL),
            },
        }

    # -- climate and shaker ------------------------------------------------------------------

    @during_motion
    def read_temperature(self) -> float:
        return self._read_word(protocol.TEMPERATURE_NOW) / 10

    @during_motion
    def read_target_temperature(self) -> float:
        return self._read_word(protocol.TEMPERATURE) / 10

    @during_motion
    def set_temperature(self, celsius: float) -> None:
        self._write_word(protocol.TEMPERATURE, round(celsius * 10))

    @during_motion
    def read_humidity(self) -> float:
        return self._read_word(protocol.HUMIDITY_NOW) / 10

    @during_motion
    def read_target_humidity(self) -> float:
        return self._read_word(protocol.HUMIDITY) / 10

    @during_motion
    def set_humidity(self, percent: float) -> None:
        self._write_word(protocol.HUMIDITY, round(percent * 10))

    @off_loop
    def shake(self, speed: int) -> None:
        """Shake; 0 stops. The speed is sent unscaled, because the public drivers disagree on its scale."""
        if speed:
            self._write_word(protocol.SHAKER, speed)
        self._write_relay(protocol.SHAKING, bool(speed))

    # -- one motion --------------------------------------------------------------------------

    def _unload(self, stacker: int, slot: int) -> None:
        self._check_relay(
            protocol.ON_STATION, False, "a plate stands on the transfer station", "Take it away."
        )
        self._transfer(protocol.EXPORT, stacker, slot, arrives=True)

    def _transfer(self, order: int, stacker: int, slot: int, *, arrives: bool) -> None:
        """Move a plate to the transfer station (``arrives``) or from it. ``order`` is the relay for it."""
        if self._read_relay(protocol.ERROR):
            raise self._make_error("none")
        self._check_relay(protocol.READY, True, "it is not ready", "Wait, or reset the module.")
        self._check_relay(protocol.SHAKING, False, "it shakes", "Stop shaking first.")
        self._write_word(protocol.STACKER, stacker)
        self._write_word(protocol.SLOT, slot)
        self.check_not_stopped()
        self._write_relay(order)
        with self.assume_motion():
            self._await_end(lambda: self._read_relay(protocol.ON_STATION) == arrives)
            self._check_sensors(arrives, f"stacker {stacker}, slot {slot}")
            self._write_relay(protocol.END_OF_ACCESS)

    def _check_sensors(self, arrives: bool, where: str) -> None:
        """Check with the sensors where the plate is. The ready flag shows only that nothing moves. Raises
        DeviceError."""
        if self._read_relay(protocol.ON_STATION) != arrives or self._read_relay(protocol.ON_SHOVEL):
            raise DeviceError(
                f"{self.name}: the motion to or from {where} ended, but its sensors do not show the plate "
                "where it should be.",
                remedy="Look at the transfer station and the shovel.",
            )

    def _await_end(
        self, shows: Callable[[], bool], limit_s: float | None = None, *, begins: bool = True
    ) -> None:
        """Wait for the end of a motion: the device is ready, and was busy before or ``shows`` returns true (a
        sensor shows the result). Just after a command, "ready" may still be the old state. If it is ready for
        ``BEGIN_S`` without these, it did not move: an error only if ``begins``. Raises DeviceError."""
        limit_s = self.limit_s("move", MOVE_S) if limit_s is None else limit_s
        began = time.monotonic()
        was_busy = False
        while True:
            ready = self._read_relay(protocol.READY)
            was_busy = was_busy or not ready
            if self._read_relay(protocol.ERROR):
                raise self._make_error("unknown")
            passed_s = time.monotonic() - began
            if ready and (was_busy or shows()):
                return
            if ready and passed_s > self.limit_s("begin", BEGIN_S) and not begins:
                return
            if ready and passed_s > self.limit_s("begin", BEGIN_S):
                raise DeviceError(
                    f"{self.name}: it took the command, but does not move.",
                    remedy="Look at the transfer station, then reset the module.",
                )
            if passed_s > limit_s:
                raise DeviceError(
                    f"{self.name}: the motion has not ended within {limit_s:g} s.",
                    remedy="Look at the transfer station and the shovel.",
                )
            time.sleep(POLL_S)

    def _check_relay(self, relay: int, value: bool, why: str, remedy: str) -> None:
        if self._read_relay(relay) != value:
            raise self.make_refusal(f"{why}", remedy)

    def _make_error(self, effects: str) -> DeviceError:
        code = self._read_word(protocol.ERROR_CODE)
        return DeviceError(
            f"{self.name}: Liconic error {code:05d}: {protocol.meaning_of(code)}.",
            effects=effects,
            remedy="Look at the transfer station and the shovel first, then reset the module.",
        )

    # -- one question ------------------------------------------------------------------------

    def _ask(self, question: bytes) -> str:
        answer = self.link.exchange(question, self.limit_s("answer", ANSWER_S)).decode("ascii", "replace")
        if answer.startswith("E"):
            why = protocol.REFUSALS.get(answer, "it refuses")
            raise self.make_refusal(f"{why} ({answer} to {question.decode()})", "Reset the module.")
        return answer

    def _read_relay(self, number: int) -> bool:
        answer = self._ask(b"RD %d" % number)
        if answer not in ("0", "1"):
            raise Garbled(f"{self.name}: {answer!r} is no state of relay {number}.")
        return answer == "1"

    def _read_word(self, number: int) -> int:
        answer = self._ask(b"RD DM%d" % number)
        if not re.fullmatch(r"\d{5}", answer):
            raise Garbled(f"{self.name}: {answer!r} is no word {number}.")
        return int(answer)

    def _write_relay(self, relay: int, value: bool = True) -> None:
        self._expect_ok(b"%s %d" % (b"ST" if value else b"RS", relay))

    def _write_word(self, word: int, value: int) -> None:
        self._expect_ok(b"WR DM%d %05d" % (word, value))

    def _expect_ok(self, command: bytes) -> None:
        if (answer := self._ask(command)) != "OK":
            raise Garbled(f"{self.name}: {answer!r} is no answer to {command.decode()}.")

    def _recognise(self, link: Link) -> str:
        """Open the connection; returns the kind of the device. Only an STX answers ``CR`` with ``CC``."""
        answer = link.exchange(b"CR", self.limit_s("answer", ANSWER_S))
        return WHO if answer == b"CC" else f"what answers {answer!r}"

"""Drives a real XPeel over its serial port."""

from __future__ import annotations

import re
import time
from typing import Any

from labos.errors import DeviceError, Garbled, NoReply, NotConnected, OutcomeUnknown, StrayReply
from labos.link import Link, Terminated
from labos.node import Setup
from labos_drivers._limits import make_serial_wire
from labos_drivers._wired import DeviceOnWire, Wired, off_loop
from labos_drivers.brooks_peeler import protocol
from labos_drivers.brooks_peeler.protocol import CODES, Code

ACK_S, ANSWER_S, HOMING_S, MOTION_S = 5.0, 2.0, 60.0, 90.0
SILENT_S = 40.0
"""A device that does not answer may be in a motion that another node has begun: so long is it waited for."""
WHO = "an XPeel"
VERSION = re.compile(rb"\*\d+[.\d]*")


class PeelerDriver(Wired):
    """Commands of the device. ``*ack`` is not the end of a motion, and a ``*ready`` before it belongs to an
    earlier one."""

    deadlines = ("ack", "answer", "homing", "motion", "silent")
    link: Link

    def __init__(self, setup: Setup, port: str, simulator: DeviceOnWire | None = None) -> None:
        super().__init__(setup, port, simulator)
        self._restarted = False
        self._tape: dict[str, float] = {}
        self.link = Link(
            make_serial_wire(setup, port, baudrate=protocol.BAUDRATE),
            Terminated(protocol.END),
            name=setup.name,
            unasked=self._note_restart,
            identify=self._recognise,
            expected=WHO,
        )

    @off_loop
    def connect(self) -> None:
        try:
            self.link.open()
        except NotConnected as error:
            if not isinstance(error.__cause__, NoReply):
                raise
            self.link.open(self.limit_s("silent", SILENT_S))

    @off_loop
    def find_seal(self) -> None:
        """Check that the plate has a seal: what a peel does without one is not published. Raises
        DeviceError."""
        if self._look_for_seal() != "sealed":
            raise self.make_refusal(
                "XPeel seal check 00: no seal on the plate", "Look at the plate before going on."
            )

    @staticmethod
    def make_peel_command(parameter_set: int, adhere_s: float) -> str:
        """The command that peels."""
        return f"*xpeel:{parameter_set}{protocol.ADHERE_S.index(adhere_s) + 1}"

    @off_loop
    def peel(self, command: str) -> None:
        """Peel, after the seal was found."""
        self.check_not_stopped()
        self._judge(self._move(command.encode()))

    @off_loop
    def follow(self, command: str) -> None:
        """What became of a peel that another node has begun: the device keeps the codes of its last motion. A
        seal check would tell too, but moves the conveyor, which nobody may expect any more. Raises
        DeviceError, and OutcomeUnknown if the device has been switched off since."""
        with self.motion(), self.under_way():
            codes = self._read_last_codes()
            self._ask_tape_left()
        if not command:
            raise self.make_refusal("only the seal was looked for; the peel was never begun")
        if not self._tape:
            raise OutcomeUnknown(f"{self.name} has been switched off since, and has no record of the peel")
        if protocol.SEAL in codes:
            raise DeviceError(
                f"{self.name}: the seal is still on: it was not removed, or the peel was never begun.",
                effects="partial",
                remedy=CODES[protocol.SEAL].remedy,
            )
        self._judge(codes)

    @off_loop
    def sealcheck(self) -> str:
        """``sealed``, ``unsealed`` or ``no plate``."""
        with self.motion():
            try:
                return self._look_for_seal()
            except NoPlate:
                return "no plate"

    @off_loop
    def is_idle(self) -> bool:
        """A device that moves or homes does not answer."""
        self._parse_codes(self._ask(b"*stat", b"*ready:"))
        return True

    @off_loop
    def reset(self) -> None:
        """Get fresh tape, then home the elevator and the conveyor; the nest comes out."""
        self._judge(self._move(b"*reset", self.limit_s("homing", HOMING_S)))
        self.resume()

    @off_loop
    def observe(self) -> dict[str, Any]:
        """Nothing: its plate sensor is read only in a motion."""
        return {}

    async def read_tape(self) -> dict[str, float]:
        """Seals that can still be peeled, as the device counts them in tens; empty if it does not know."""
        if not self.moving:
            await self._ask_tape()
        return self._tape

    @off_loop
    def _ask_tape(self) -> None:
        self._ask_tape_left()

    def _ask_tape_left(self) -> None:
        line = self._ask(b"*tapeleft", b"*tape:")
        try:
            supply, room = (int(field) for field in line.partition(b":")[2].split(b","))
        except ValueError as error:
            raise Garbled(f"{self.name}: {line!r} does not tell how much tape is left.") from error
        known = protocol.UNKNOWN_TAPE not in (supply, room)
        self._tape = {"tape": 10.0 * min(supply, room)} if known else {}

    # -- one command -------------------------------------------------------------------------

    def _ask(self, question: bytes, beginning: bytes) -> bytes:
        """Ask a question that moves nothing."""
        return self.link.exchange(
            question, self.limit_s("answer", ANSWER_S), answers=lambda _, line: line.startswith(beginning)
        )

    def _read_last_codes(self) -> tuple[int, ...]:
        """The codes of the last motion, when it has ended."""
        deadline = time.monotonic() + self.limit_s("motion", MOTION_S)
        while True:
            try:
                return self._parse_codes(self._ask(b"*stat", b"*ready:"))
            except NoReply:
                if time.monotonic() > deadline:
                    raise

    def _parse_codes(self, line: bytes) -> tuple[int, ...]:
        try:
            return protocol.parse_codes(line)
        except ValueError as error:
            raise Garbled(f"{self.name}: {error}.") from error

    def _move(self, command: bytes, limit_s: float | None = None) -> tuple[int, ...]:
        """Send a command that moves, and wait for its end; returns its error codes."""
        deadline = time.monotonic() + (self.limit_s("motion", MOTION_S) if limit_s is None else limit_s)
        self._restarted = False
        self.link.exchange(
            command, self.limit_s("ack", ACK_S), answers=lambda _, line: line.startswith(b"*ack")
        )
        with self.under_way():
            while True:
                line = self.link.receive(max(deadline - time.monotonic(), 0.0))
                if self._note_restart(line) and self._restarted:
                    raise DeviceError(
                        f"{self.name}: the peeler restarted in mid-motion.",
                        remedy="Look at the plate, then reset the module.",
                    )
                if line.startswith(b"*ready"):
                    return self._parse_codes(line)

    def _look_for_seal(self) -> str:
        codes = self._move(b"*sealcheck")
        if protocol.NO_PLATE in codes:
            raise NoPlate(
                f"{self.name}: XPeel error 06: no plate found.",
                effects="none",
                remedy="Look where the plate is.",
            )
        self._judge(tuple(code for code in codes if code != protocol.SEAL))
        return "sealed" if protocol.SEAL in codes else "unsealed"

    def _judge(self, codes: tuple[int, ...]) -> None:
        """Raise DeviceError for the first code that is no warning; its effects are those of the worst
        code."""
        known = [(code, CODES.get(code, Code("an unknown error"))) for code in codes]
        hard = [(code, what) for code, what in known if not what.warning]
        if not hard:
            return
        errors = ", ".join(f"error {code:02d}: {what.meaning}" for code, what in hard)
        effects = {what.effects for _, what in hard}
        raise DeviceError(
            f"{self.name}: XPeel {errors}.",
            effects=effects.pop() if len(effects) == 1 else "unknown",
            remedy=hard[0][1].remedy,
        )

    # -- what the device says by itself ------------------------------------------------------

    def _note_restart(self, line: bytes) -> bool:
        if line.startswith((b"*poweron", b"*homing")):
            self._restarted = True
            return True
        return False

    def _recognise(self, link: Link) -> str:
        """The device answers with its firmware version once it has homed."""
        deadline = time.monotonic() + self.limit_s("homing", HOMING_S)
        while True:
            self._restarted = False
            try:
                self.note_firmware(self._read_version(link))
                return WHO
            except NoReply:
                if not self._restarted or time.monotonic() > deadline:
                    raise
            except StrayReply as error:
                # A device that has just homed says so, and has not heard what it was asked before.
                if "*ready:" not in error.message or time.monotonic() > deadline:
                    raise

    def _read_version(self, link: Link) -> str:
        answer_s = self.limit_s("answer", ANSWER_S)
        answer = link.exchange(b"*version", answer_s, answers=lambda _, line: bool(VERSION.fullmatch(line)))
        return answer.decode().lstrip("*")


class NoPlate(DeviceError):
    """The nest is empty."""

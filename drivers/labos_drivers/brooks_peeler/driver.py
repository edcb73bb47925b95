"""The driver of a real XPeel over its serial port."""

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
    """The commands of the device. ``*ack`` is not the end of a motion. A ``*ready`` before ``*ack`` belongs
    to an earlier motion."""

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
        """Check that the plate has a seal. No public source describes a peel without one. Raises
        DeviceError."""
        if self._look_for_seal() != "sealed":
            raise self.make_refusal(
                "XPeel seal check 00: no seal on the plate", "Look at the plate before going on."
            )

    @staticmethod
    def make_peel_command(parameter_set: int, adhere_s: float) -> str:
        """The command for a peel."""
        return f"*xpeel:{parameter_set}{protocol.ADHERE_S.index(adhere_s) + 1}"

    @off_loop
    def peel(self, command: str) -> None:
        """Peel. Call ``find_seal`` before, in the same motion. Raises DeviceError."""
        self.check_not_stopped()
        self._judge(self._move(command.encode()))

    @off_loop
    def follow(self, command: str) -> None:
        """Wait for the end of a peel from before a restart of the node, and check the codes that the device
        keeps of its last motion. A seal check would show the result too, but unexpectedly moves the conveyor.
        Raises DeviceError, and OutcomeUnknown if the device was switched off since then."""
        with self.motion(), self.assume_motion():
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
        """Look for a seal: ``sealed``, ``unsealed`` or ``no plate``."""
        with self.motion():
            try:
                return self._look_for_seal()
            except NoPlate:
                return "no plate"

    @off_loop
    def is_idle(self) -> bool:
        """True if the device answers. Raises NoReply during a motion or homing: then it does not answer."""
        self._parse_codes(self._ask(b"*stat", b"*ready:"))
        return True

    @off_loop
    def reset(self) -> None:
        """Bring fresh tape into place, then home the elevator and the conveyor; the nest moves out."""
        self._judge(self._move(b"*reset", self.limit_s("homing", HOMING_S)))
        self.resume()

    @off_loop
    def observe(self) -> dict[str, Any]:
        """Empty, because the plate sensor is read only in a motion."""
        return {}

    async def read_tape(self) -> dict[str, float]:
        """The number of seals that can be peeled, counted in tens. Empty if the device does not know."""
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
        """The answer to a question that moves nothing. It starts with ``beginning``."""
        return self.link.exchange(
            question, self.limit_s("answer", ANSWER_S), answers=lambda _, line: line.startswith(beginning)
        )

    def _read_last_codes(self) -> tuple[int, ...]:
        """Wait until the last motion has ended; returns its codes."""
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
        """Send a command for a motion, and wait for its end; returns its error codes."""
        deadline = time.monotonic() + (self.limit_s("motion", MOTION_S) if limit_s is None else limit_s)
        self._restarted = False
        self.link.exchange(
            command, self.limit_s("ack", ACK_S), answers=lambda _, line: line.startswith(b"*ack")
        )
        with self.assume_motion():
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
        """Raise DeviceError if a code is not a warning, with the remedy of the first such code. The effects
        are ``unknown`` if those of the codes differ."""
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

    # -- restarts and identity ---------------------------------------------------------------

    def _note_restart(self, line: bytes) -> bool:
        if line.startswith((b"*poweron", b"*homing")):
            self._restarted = True
            return True
        return False

    def _recognise(self, link: Link) -> str:
        """Recognise the device by its firmware version, which it reports after homing."""
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
                # The device sends ``*ready`` after homing. It has not received the question from before.
                if "*ready:" not in error.message or time.monotonic() > deadline:
                    raise

    def _read_version(self, link: Link) -> str:
        answer_s = self.limit_s("answer", ANSWER_S)
        answer = link.exchange(b"*version", answer_s, answers=lambda _, line: bool(VERSION.fullmatch(line)))
        return answer.decode().lstrip("*")


class NoPlate(DeviceError):
    """The device found no plate in its nest."""

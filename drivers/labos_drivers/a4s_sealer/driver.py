"""The driver of the a4S sealer, over its serial port."""

from __future__ import annotations

import contextlib
import time
from typing import Any

from labos.errors import DeviceError, Garbled, HalfReply, NoReply
from labos.link import Link
from labos.node import Setup
from labos_drivers._limits import make_serial_wire
from labos_drivers._wired import DeviceOnWire, Wired, off_loop
from labos_drivers.a4s_sealer import protocol
from labos_drivers.a4s_sealer.protocol import Status

RECORD_S = 10.0
"""The device says its status every second or so; after this time without, it is off."""

ACCEPT_S, SHUTTLE_S, HEAT_S, BEGIN_S, CYCLE_S = 5.0, 30.0, 300.0, 15.0, 60.0
AT_TEMPERATURE_C = 2.0
WHO = "an a4S sealer"


class SealerDriver(Wired):
    """Commands of the device. The device accepts a command long before it has carried it out. So the driver
    waits until the streamed status shows the requested state. A record that is read just after a command may
    be from before it. So a cycle counts as ended only if the driver saw it begin, or saw a new "finished"."""

    deadlines = ("record", "accept", "shuttle", "heat", "begin", "cycle")
    link: Link

    def __init__(self, setup: Setup, port: str, simulator: DeviceOnWire | None = None) -> None:
        super().__init__(setup, port, simulator)
        self._status: Status | None = None
        self.link = Link(
            make_serial_wire(setup, port, baudrate=protocol.BAUDRATE),
            protocol.framing(),
            name=setup.name,
            answers=lambda _, message: message[:1] in (b"Y", b"N", b"X"),
            unasked=self._note_record,
            identify=self._recognise,
            expected=WHO,
        )

    @off_loop
    def seal(self, time_s: float, temperature_c: float) -> None:
        """Heat, then seal the plate: the shuttle draws it in and brings it out again. Raises DeviceError."""
        with self.motion():
            self._refuse_unless_fit(self._read_fresh_status())
            self._command(b"DT", round(time_s * 10))
            self._command(b"DH", round(temperature_c))
            self._await_heat(temperature_c)
            self._seal()

    @off_loop
    def is_idle(self) -> bool:
        status = self._read_fresh_status()
        at_rest = status.shuttle in (protocol.SHUTTLE_IN, protocol.SHUTTLE_OUT)
        return status.system in (protocol.IDLE, protocol.FINISHED, protocol.ERROR) and at_rest

    @off_loop
    def reset(self) -> None:
        """Clear an error and home the shuttle: nothing may be in its way. Raises DeviceError."""
        self._status = None
        self._command(b"SR")
        with self.assume_motion():
            self._wait(
                "come to rest",
                self.limit_s("shuttle", SHUTTLE_S),
                lambda s: s.system == protocol.IDLE and s.shuttle == protocol.SHUTTLE_OUT,
                fails=False,
            )
        self.resume()

    @off_loop
    def observe(self) -> dict[str, Any]:
        """Nothing, because the device has no sensor for plates. Raises DeviceError if it sends no status."""
        self._read_fresh_status()
        return {}

    # -- one command, and waiting for its result ---------------------------------------------

    def _command(self, name: bytes, argument: int | None = None) -> None:
        """Send a command, and wait until it is accepted. Raises DeviceError; if the command was rejected,
        nothing has moved."""
        text = b"00" + name + b"=" + (b"" if argument is None else b"%04d" % argument)
        answer = self.link.exchange(text, self.limit_s("accept", ACCEPT_S))
        if answer[:1] == b"Y":
            return
        self._pass_over_acceptance()
        why = "is busy" if answer[:1] == b"X" else "does not take the command"
        raise self.make_refusal(
            f"the sealer {why} {name.decode()} ({answer.decode('ascii', 'replace')})",
            "Look at its display, then reset the module.",
        )

    def _pass_over_acceptance(self) -> None:
        """Discard the acceptance that some devices send after a rejection; it belongs to no command."""
        deadline = time.monotonic() + 0.3
        with contextlib.suppress(NoReply, HalfReply, Garbled):
            while (left := deadline - time.monotonic()) > 0:
                self.link.receive(left)

    def _seal(self) -> None:
        before = self._read_fresh_status().system
        self.check_not_stopped()
        self._command(b"GS")
        running = (protocol.SINGLE_CYCLE, protocol.REPEAT_CYCLE)
        with self.assume_motion():
            status = self._wait(
                "begin to seal",
                self.limit_s("begin", BEGIN_S),
                lambda s: s.system in running or (s.system == protocol.FINISHED != before),
            )
            if status.system in running:
                self._end_cycle(status)
            self._wait(
                "hand the plate out",
                self.limit_s("shuttle", SHUTTLE_S),
                lambda s: s.shuttle == protocol.SHUTTLE_OUT,
            )

    def _end_cycle(self, begun: Status) -> None:
        """Wait until the cycle has ended. Raises DeviceError. It detects a device that has restarted: its
        clock goes back, or it is idle although more than half of the countdown was left."""
        last = begun

        def has_ended(status: Status) -> bool:
            nonlocal last
            restarted = status.is_before(last) or (
                status.system == protocol.IDLE and last.remaining > begun.remaining / 2
            )
            if restarted:
                raise DeviceError(
                    f"{self.name}: the sealer rests, but has not ended its cycle: has it restarted?",
                    remedy="Look at the plate, then reset the module.",
                )
            last = status
            return status.system in (protocol.IDLE, protocol.FINISHED)

        self._wait("end the cycle", self.limit_s("cycle", CYCLE_S), has_ended)

    def _await_heat(self, temperature_c: float) -> None:
        limit_s = self.limit_s("heat", HEAT_S)
        deadline = time.monotonic() + limit_s
        while True:
            status = self._read_fresh_status()
            self._refuse_unless_fit(status)
            self.check_not_stopped()
            near = abs(status.temperature_c - temperature_c) <= AT_TEMPERATURE_C
            if near and status.heater in (protocol.READY, protocol.CONVERGING):
                return
            if time.monotonic() > deadline:
                raise self.make_refusal(
                    f"the block is at {status.temperature_c:g} °C after {limit_s:g} s, not at "
                    f"{temperature_c:g} °C",
                    "Check the heater.",
                )

    def _wait(self, what: str, limit_s: float, reached: Any, *, fails: bool = True) -> Status:
        """Wait until ``reached`` returns true for a status; returns this status. Raises DeviceError: after
        ``limit_s``, and with ``fails`` also for an error of the device."""
        deadline = time.monotonic() + limit_s
        while True:
            status = self._read_fresh_status()
            # A reported error counts, even if the rest of the record shows that the cycle has ended.
            if fails and (status.system == protocol.ERROR or status.error):
                raise DeviceError(
                    f"{self.name}: sealer error {status.error:02d} before it did {what}.",
                    remedy="Look at its display and at the plate, then reset the module.",
                )
            if reached(status):
                return status
            if time.monotonic() > deadline:
                raise DeviceError(
                    f"{self.name}: the sealer did not {what} within {limit_s:g} s.",
                    remedy="Look at the plate, then reset the module.",
                )

    def _refuse_unless_fit(self, status: Status) -> None:
        """Raise DeviceError if the device cannot begin a cycle; nothing has moved then."""
        why, remedy = "", ""
        if status.system == protocol.ERROR or status.error:
            why, remedy = f"error {status.error:02d}", "Look at its display, then reset the module."
        elif status.system in (protocol.SINGLE_CYCLE, protocol.REPEAT_CYCLE):
            why, remedy = "it is sealing", "Wait until it has ended."
        elif status.system not in (protocol.IDLE, protocol.FINISHED):
            why = f"its status is {status.system}, which is not known to mean that it is ready"
            remedy = "Look at its display, then reset the module."
        elif not status.has(protocol.ROLL):
            why, remedy = "it has no roll of foil", "Put a roll in and say so: labos replenish."
        elif not status.has(protocol.DOOR):
            why, remedy = "its cleaning door is open", "Close the door."
        if why:
            raise self.make_refusal(f"{why}", remedy)

    # -- records that the device sends by itself ---------------------------------------------

    def _note_record(self, message: bytes) -> bool:
        if message[:1] == b"T":
            try:
                self._status = Status.read(message)
            except ValueError:
                return False
        return message[:1] in (b"T", b"D")

    def _read_fresh_status(self) -> Status:
        """The next status from the device; older ones are discarded. Raises NoReply if it sends none."""
        if not self.link.is_open:
            self.link.open()
        self.link.drain()
        return self._read_next_status(self.link)

    def _read_next_status(self, link: Link) -> Status:
        deadline = time.monotonic() + self.limit_s("record", RECORD_S)
        while True:
            try:
                message = link.receive(max(deadline - time.monotonic(), 0.0))
            except (Garbled, HalfReply):
                # The rest of a record: its beginning arrived earlier and was discarded.
                if time.monotonic() > deadline:
                    raise
                continue
            if self._note_record(message) and message[:1] == b"T" and self._status is not None:
                return self._status

    def _recognise(self, link: Link) -> str:
        self._read_next_status(link)
        return WHO

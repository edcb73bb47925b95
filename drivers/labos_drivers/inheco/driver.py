"""The driver of one incubator of a stack, by its serial port."""

from __future__ import annotations

import re
import time
from collections.abc import Callable
from typing import Annotated, Any

import msgspec

from labos.errors import DeviceError, Garbled
from labos.link import Link
from labos.node import Setup
from labos_drivers._limits import make_serial_wire, read_setting
from labos_drivers._wired import DeviceOnWire, Wired, during_motion, off_loop
from labos_drivers.inheco import protocol

ANSWER_S, DRAWER_S, SHAKER_S = 3.0, 15.0, 20.0
POLL_S = 0.2
WHO = "an Inheco incubator"
Id, Floor = Annotated[int, msgspec.Meta(ge=0, le=15)], Annotated[int, msgspec.Meta(ge=0, le=5)]


class Refused(DeviceError):
    """The incubator answers a command with an error; ``code`` is the error code."""

    def __init__(self, name: str, command: str, code: int) -> None:
        why = protocol.MEANINGS.get(code, "an unknown error")
        super().__init__(
            f"{name}: Inheco error {code} to {command}: {why}.",
            effects="none",
            remedy="Check the incubator, then reset the module; a reset closes its drawer.",
        )
        self.code = code


class InhecoDriver(Wired):
    """The driver of one incubator. An answer means that a command was accepted, not that it is done. So the
    drawer and the shaker are queried until they reach the requested state. Answers have no check sum, so only
    an answer that fits the command is accepted."""

    deadlines = ("answer", "drawer", "shaker")
    link: Link

    def __init__(self, setup: Setup, port: str, simulator: DeviceOnWire | None = None) -> None:
        super().__init__(setup, port, simulator)
        self._device = read_setting(setup, "id", protocol.USUAL_ID, Id, "Write 0 to 15.")
        self._floor = read_setting(setup, "floor", 0, Floor, "Write 0 to 5.")
        self._target_c: float | None = None
        self.link = Link(
            make_serial_wire(setup, port, baudrate=protocol.BAUDRATE),
            protocol.Answers(self._device),
            name=setup.name,
            identify=lambda _: self._recognise(),
            expected=WHO,
        )

    # -- drawer ------------------------------------------------------------------------------

    @off_loop
    def open_gate(self) -> None:
        with self.motion():
            self._move_drawer("AOD", "1")

    @off_loop
    def close_gate(self) -> None:
        with self.motion():
            self._move_drawer("ACD", "0")

    def _move_drawer(self, command: str, goal: str) -> None:
        if self._read_shaker() != "0":
            raise self.make_refusal("it shakes", "Stop shaking first.")
        self.check_not_stopped()
        self._order(command, self.limit_s("drawer", DRAWER_S))
        with self.assume_motion():
            self._await(
                lambda: self._read_drawer() == goal,
                self.limit_s("drawer", DRAWER_S),
                "the drawer has not reached its end",
            )

    def _read_drawer(self) -> str:
        """The position of the drawer: ``0`` closed, ``1`` open, empty in between."""
        try:
            return self._ask("RDS", "[01]")
        except Refused as error:
            if error.code == protocol.BETWEEN:
                return ""
            raise

    # -- temperature -------------------------------------------------------------------------

    @off_loop
    def set_temperature(self, celsius: float) -> None:
        with self.motion():
            self._heat(celsius)
            self._target_c = celsius

    def _heat(self, celsius: float) -> None:
        self._order(f"STT{round(celsius * 10)}")
        self._order("SHE1")
        with self.assume_motion():
            target, heater = int(self._ask("RTT", r"\d{1,3}")), self._ask("RHE", "[012]")
            if target != round(celsius * 10) or heater == "0":
                raise DeviceError(
                    f"{self.name}: it was set to {celsius:g} °C, but reports {target / 10:g} °C, "
                    f"heater {('off' if heater == '0' else 'on')}."
                )

    @off_loop
    def stop_temperature(self) -> None:
        with self.motion():
            self._order("SHE0")
            self._target_c = None

    @during_motion
    def read_temperature(self) -> float:
        return self._read_temperature()

    def _read_temperature(self) -> float:
        return int(self._ask("RAT1", r"-?\d{1,4}")) / 10

    # -- shaker ------------------------------------------------------------------------------

    @off_loop
    def begin_shake(self, rpm: float, amplitude_mm: float) -> None:
        """Shake in circles. Settings apply only from the next start, so a running shaker is stopped
        first. Raises DeviceError."""
        with self.motion():
            if self._ask("RTS", "[0-3]") not in (protocol.MP_SHAKER, protocol.DWP_SHAKER):
                raise self.make_refusal("this incubator has no shaker")
            if self._read_drawer() != "0":
                raise self.make_refusal("the door is not closed", "Close the door first.")
            if self._read_shaker() != "0":
                self._stop_shaking()
            tenths_hz, tenths_mm = round(rpm / 6), round(amplitude_mm * 10)
            self._order(f"SSP{tenths_mm},{tenths_mm},{tenths_hz},{tenths_hz},90")
            self.check_not_stopped()
            self._order("ASE1")
            with self.assume_motion():
                self._await(
                    lambda: self._read_shaker() == protocol.SHAKES,
                    self.limit_s("shaker", SHAKER_S),
                    "the shaker does not run",
                )

    @off_loop
    def end_shake(self) -> None:
        with self.motion():
            self._stop_shaking()

    def _stop_shaking(self) -> None:
        self._order("ASE0")
        with self.assume_motion():
            self._await(
                lambda: self._read_shaker() == "0",
                self.limit_s("shaker", SHAKER_S),
                "the shaker does not stop",
            )

    def _read_shaker(self) -> str:
        """The state of the shaker: ``0`` stands still, ``1`` shakes, ``2`` runs down."""
        return self._ask("RSE", "[012]")

    # -- reset, stop and status --------------------------------------------------------------

    @off_loop
    def reset(self) -> None:
        """Initialise the incubator: its drawer closes, heater and shaker stop. Then heat again to the
        temperature that was set, if there is one. Raises DeviceError."""
        self._order("AID", self.limit_s("drawer", DRAWER_S), again=True)
        with self.assume_motion():
            self._await(
                lambda: self._read_drawer() == "0",
                self.limit_s("drawer", DRAWER_S),
                "the drawer has not closed",
            )
            if self._target_c is not None:
                self._heat(self._target_c)
        self.resume()

    @during_motion
    def stop(self) -> None:
        """Stop the shaker. Raises DeviceError if the drawer moves: it completes its motion."""
        self._halted.set()
        self._order("ASE0")
        if self._read_drawer() == "":
            raise DeviceError(
                f"{self.name}: the drawer cannot be stopped over the wire; it completes its motion.",
                remedy="Use the switch on the device.",
            )

    @during_motion
    def is_idle(self) -> bool:
        """Whether the drawer is open or closed. An incubator that shakes or heats is idle too."""
        return self._read_drawer() != ""

    @during_motion
    def read_status(self) -> dict[str, Any]:
        drawer = self._read_drawer()
        return {
            "door": {"0": "closed", "1": "open"}.get(drawer, "moving"),
            "plate": self._detect_plate(),
            "shaking": self._read_shaker() != "0",
            "heating": self._ask("RHE", "[012]") != "0",
            "temperature": self._read_temperature(),
            "target": int(self._ask("RTT", r"\d{1,3}")) / 10,
            "errors": int(self._ask("REF", r"\d{1,10}")),
        }

    @during_motion
    def observe(self) -> dict[str, Any]:
        """The plate is detected when the drawer closes. It is unknown while the drawer is open and after a
        reset; ``labware`` is left out then, and ``door`` while the drawer moves."""
        drawer, plate = self._read_drawer(), self._detect_plate()
        seen: dict[str, Any] = {"shaking": self._read_shaker() != "0"}
        if drawer:
            seen["door"] = "open" if drawer == "1" else "closed"
        if plate is not None:
            seen["labware"] = {"default": plate}
        return seen

    def _detect_plate(self) -> bool | None:
        answer = self._ask("RLW", "[0178]")
        return answer == protocol.PLATE if answer in (protocol.PLATE, protocol.NO_PLATE) else None

    # -- one command -------------------------------------------------------------------------

    def _ask(self, command: str, form: str, limit_s: float = 0.0) -> str:
        """The text of the answer to a command. Raises Refused, and Garbled if it does not fit ``form``."""
        message = self.link.exchange(
            protocol.make_command(command, self._floor, self._device),
            limit_s or self.limit_s("answer", ANSWER_S),
        )
        code, text = message[0], message[1:].decode("ascii", "replace").strip("\0 ")
        if code:
            raise Refused(self.name, command, code)
        if not re.fullmatch(form, text):
            raise Garbled(f"{self.name}: {text!r} is not an answer to {command}.")
        return text

    def _order(self, command: str, limit_s: float = 0.0, *, again: bool = False) -> None:
        """Send a command whose answer has no text. A device that was reset reports this once, and does not
        carry out the command. With ``again``, the command is then sent again. Raises Refused, Garbled."""
        try:
            self._ask(command, "", limit_s)
        except Refused as error:
            if not (again and error.code == protocol.RESET):
                raise
            self._ask(command, "", limit_s)

    def _await(self, reached: Callable[[], bool], limit_s: float, what: str) -> None:
        deadline = time.monotonic() + limit_s
        while not reached():
            if time.monotonic() > deadline:
                raise DeviceError(
                    f"{self.name}: {what} within {limit_s:g} s.",
                    remedy="Check the incubator, then reset the module; a reset closes its drawer.",
                )
            time.sleep(POLL_S)

    def _recognise(self) -> str:
        """The identity, by the answer to ``RTS``. An incubator may report first that it was switched on."""
        try:
            self._ask("RTS", "[0-3]")
        except Refused as error:
            if error.code not in (protocol.RESET, protocol.NOT_INITIALISED):
                return f"what answers with error {error.code}"
        self.check_unit(self._read_serial())
        return WHO

    def _read_serial(self) -> str:
        """The serial number; empty if the incubator reports none. It may first report that it was reset."""
        for _ in range(2):
            try:
                return self._ask("RFV2", "[ -~]*")
            except Refused as error:
                if error.code != protocol.RESET:
                    return ""
        return ""

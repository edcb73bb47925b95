"""The driver of an Infinite over USB, or over another wire for its bytes."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Any

from labos.errors import DeviceError, Garbled, LinkError
from labos.link import Link, UsbWire, Wire
from labos.node import Attachment, Setup
from labos_drivers._limits import make_serial_wire
from labos_drivers._wired import DeviceOnWire, Wired, off_loop
from labos_drivers.tecan import protocol
from labos_drivers.tecan.protocol import Calibration, Grid

ANSWER_S, GATE_S, ROW_S, INIT_S = 5.0, 30.0, 300.0, 60.0
WHO = "a Tecan Infinite"
STATES = ("ST", "BY", "PD", "PU", "PA", "MSG", "+BY")

Spectra = dict[float, dict[str, float]]
"""Optical densities by wavelength in nm, then by well."""


class TecanDriver(Wired):
    """``BY`` is not the end of a motion: the carrier's position is checked when the reader is on standby. A
    row is complete when the reader has reported each of its wells."""

    deadlines = ("answer", "gate", "row", "init")
    where = ("port", "usb")
    link: Link

    def __init__(self, setup: Setup, address: str, simulator: DeviceOnWire | None = None) -> None:
        super().__init__(setup, address, simulator)
        self._frames = protocol.Frames()
        self._scans = False
        self.link = Link(
            self._wire(setup, address),
            self._frames,
            name=setup.name,
            identify=self._recognise,
            expected=WHO,
        )

    @staticmethod
    def _wire(setup: Setup, address: str) -> Wire:
        if address == "usb":
            return UsbWire(
                protocol.USB_VENDOR, protocol.USB_PRODUCT, serial=str(setup.config.get("serial", ""))
            )
        return make_serial_wire(setup, address)

    # -- carrier -----------------------------------------------------------------------------

    @off_loop
    def open_gate(self) -> None:
        with self.motion():
            self._drive(protocol.OUT)

    @off_loop
    def close_gate(self) -> None:
        with self.motion():
            self._drive(protocol.IN)

    def _drive(self, goal: str) -> None:
        self.check_not_stopped()
        self._order(f"ABSOLUTE MTP,{goal}", self.limit_s("gate", GATE_S))
        with self.assume_motion():
            if (found := self._read_position()) != goal:
                raise DeviceError(
                    f"{self.name}: the carrier should be {goal}, and is {found}.",
                    remedy="Look at the carrier, then reset the module.",
                )

    def _read_position(self) -> str:
        return self._ask("?ABSOLUTE MTP,POS")

    # -- absorbance --------------------------------------------------------------------------

    @off_loop
    def measure(
        self, method: str, start_nm: float, end_nm: float, step_nm: float, wells: int, name: str
    ) -> Attachment:
        """Measure spectra; returns a table as Magellan exports it: tabs, UTF-16, wavelengths in the first
        line."""
        if method:
            raise self.make_refusal(
                f"over USB the reader knows no stored methods; it was asked for {method!r}",
                "Leave the method out, and name start, end and step.",
            )
        wavelengths = self._list_wavelengths(start_nm, end_nm, step_nm)
        with self.motion():
            if (position := self._read_position()) != protocol.IN:
                where = (
                    "the gate is open" if position == protocol.OUT else f"its carrier is {position!r}, not IN"
                )
                raise self.make_refusal(f"{where}", "Close the gate first.")
            if self._detect_plate() is False:
                raise self.make_refusal("no plate is on the carrier", "Put one there.")
            grid = protocol.GRIDS[wells]
            spectra: Spectra = {}
            with self._scan():
                for wavelength in wavelengths:
                    spectra[wavelength] = self._read_spectrum(wavelength, grid)
            if self._detect_plate() is False:
                raise DeviceError(
                    f"{self.name}: the plate is no longer on the carrier; a part was measured without it.",
                    effects="unknown",
                    remedy="Look where it is, and measure again.",
                )
            return Attachment(name, protocol.write_table(spectra, grid))

    def _list_wavelengths(self, start_nm: float, end_nm: float, step_nm: float) -> list[float]:
        if start_nm > end_nm:
            raise self.make_refusal(f"{start_nm:g} nm lies behind {end_nm:g} nm")
        wavelengths = protocol.list_wavelengths(start_nm, end_nm, step_nm)
        if len(wavelengths) > protocol.MOST_WAVELENGTHS:
            raise self.make_refusal(
                f"{len(wavelengths)} wavelengths are more than {protocol.MOST_WAVELENGTHS}"
            )
        return wavelengths

    @contextmanager
    def _scan(self) -> Iterator[None]:
        """Lock the reader's keys for a measurement, and end it on the reader, also after a DeviceError."""
        self._order("KEYLOCK ON")
        self._scans = True
        try:
            with self.assume_motion():
                yield
                self._order("TERMINATE")
                for part in ("MTP", "ABS"):
                    self._order(f"CHECK {part}.STEPLOSS")
                self._order("KEYLOCK OFF")
                self._drive(protocol.IN)
        except DeviceError:
            with suppress(DeviceError):
                self._order("TERMINATE")
                self._order("KEYLOCK OFF")
            raise
        finally:
            self._scans = False

    def _read_spectrum(self, nm: float, grid: Grid) -> dict[str, float]:
        """Measure all wells at one wavelength."""
        self._set_up(nm)
        self.link.send(b"PREPARE REF")
        calibration = self._read_calibration(nm)
        found: dict[str, float] = {}
        for row in range(grid.rows):
            self.check_not_stopped("unknown")
            found |= self._read_row(row, nm, grid, calibration)
        return found

    def _set_up(self, nm: float) -> None:
        self._order("MODE ABS")
        for what in ("EXCITATION", "TIME", "GAIN", "READS", "POSITION", "MIRROR"):
            self._order(f"{what} CLEAR")
        band = protocol.bandwidth_nm(nm)
        for label in (0, 1):
            self._order(f"EXCITATION {label},ABS,{round(nm * 10)},{round(band * 10)},0")
            self._order(f"READS {label},NUMBER={protocol.FLASHES}")
            self._order(f"TIME {label},READDELAY=0")
        self._order("SCAN DIRECTION=ALTUP")
        self._order(f"BEAM DIAMETER={protocol.BEAM_UM}")
        self._order("RATIO LABELS=1")

    def _read_calibration(self, nm: float) -> Calibration:
        packets = self._read_packets(
            self.limit_s("row", ROW_S), lambda found: any(map(protocol.is_calibration, found))
        )
        if not packets:
            raise Garbled(f"{self.name}: no calibration has come at {nm:g} nm.")
        return protocol.read_calibration(next(filter(protocol.is_calibration, packets)))

    def _read_row(self, row: int, nm: float, grid: Grid, calibration: Calibration) -> dict[str, float]:
        """Measure a row; every second row is measured from right to left. Y moves alone first: if X and Y
        move together, the values of the first wells are wrong (PyLabRobot)."""
        columns = list(range(grid.columns))[:: -1 if row % 2 else 1]
        first, last, y = grid.x(columns[0]), grid.x(columns[-1]), grid.y(row)
        self._order(f"ABSOLUTE MTP,Y={y}")
        self._order(f"ABSOLUTE MTP,X={first},Y={y}")
        self._order("SCAN DIRECTION=ALTUP")
        self.link.send(f"SCANX {first},{last},{len(columns)}".encode())
        packets = self._read_packets(
            self.limit_s("row", ROW_S), lambda found: sum(map(protocol.is_measurement, found)) >= len(columns)
        )
        packets = [packet for packet in packets if protocol.is_measurement(packet)]
        if len(packets) != len(columns):
            raise Garbled(f"{self.name}: {len(packets)} of {len(columns)} wells of a row were reported.")
        found: dict[str, float] = {}
        for column, packet in zip(columns, packets, strict=True):
            reported_nm, pairs = protocol.read_measurement(packet)
            if abs(reported_nm - nm) > 0.05:
                raise Garbled(f"{self.name}: it measured at {reported_nm:g} nm, not at {nm:g} nm.")
            try:
                found[grid.well(row, column)] = protocol.optical_density(calibration, pairs)
            except ValueError as error:
                raise DeviceError(
                    f"{self.name}: {error} at {nm:g} nm.", remedy="Check the lamp, then reset the module."
                ) from error
        return found

    def _read_packets(self, limit_s: float, enough: Any) -> list[bytes]:
        """The packets of numbers until the reader is on standby again. Other messages are ignored. Raises
        DeviceError if the reader refuses, or if these packets are not ``enough``."""
        deadline = time.monotonic() + limit_s
        found: list[bytes] = []
        while True:
            message = self.link.receive(max(deadline - time.monotonic(), 0.0))
            if message[:1] == b"\0":
                found.append(message[1:])
            elif message.decode() == protocol.STANDBY:
                if not enough(found):
                    raise Garbled(
                        f"{self.name}: it is on standby, and has not reported all that it measured."
                    )
                return found
            else:
                self._refuse(message.decode(), "the measurement")

    # -- the device itself -------------------------------------------------------------------

    @off_loop
    def reset(self) -> None:
        """Home all axes; then the carrier moves out."""
        self.resume()
        self._order("INIT FORCE", self.limit_s("init", INIT_S))
        with self.assume_motion():
            self._order("KEYLOCK OFF")
            self._drive(protocol.OUT)

    async def stop(self) -> None:
        """End a measurement after its row. A motion of the carrier cannot be stopped: it continues to its
        end, and DeviceError is raised."""
        if self._scans:
            self._halted.set()
        else:
            await super().stop()

    @off_loop
    def is_idle(self) -> bool:
        return self._ask("QQ") == protocol.STANDBY

    @off_loop
    def observe(self) -> dict[str, Any]:
        """The gate, and the plate sensor, which is valid after the carrier has moved in."""
        position = self._read_position()
        seen: dict[str, Any] = {}
        if position in (protocol.IN, protocol.OUT):
            seen["gate"] = "open" if position == protocol.OUT else "closed"
        if position == protocol.IN and (plate := self._detect_plate()) is not None:
            seen["labware"] = {"default": plate}
        return seen

    def _detect_plate(self) -> bool | None:
        return {"TAKEN": True, "FREE": False}.get(self._ask("?SENSOR PLATEPOS"))

    # -- one question ------------------------------------------------------------------------

    def _ask(self, question: str, limit_s: float = 0.0) -> str:
        """Ask a question; returns the text of the answer. Raises DeviceError."""
        self._frames.forget()
        message = self.link.exchange(question.encode(), limit_s or self.limit_s("answer", ANSWER_S))
        if message[:1] == b"\0":
            raise Garbled(f"{self.name}: numbers are no answer to {question!r}.")
        text = message.decode()
        self._refuse(text, repr(question))
        return text

    def _order(self, command: str, limit_s: float = 0.0) -> None:
        """Send a command and wait until it is done; a busy reader queues it. Raises DeviceError. Its effects
        are ``none`` if the first answer refuses the command."""
        text = self._ask(command, limit_s)
        if text in (protocol.STANDBY, protocol.TAKEN):
            return
        busy = protocol.BUSY.fullmatch(text)
        if busy is None:
            raise Garbled(f"{self.name}: {text!r} is no answer to {command!r}.")
        deadline = time.monotonic() + (limit_s or self.limit_s("answer", ANSWER_S))
        with self.assume_motion():
            while text != protocol.STANDBY:
                message = self.link.receive(max(deadline - time.monotonic(), 0.0))
                text = message.decode() if message[:1] != b"\0" else ""
                self._refuse(text, repr(command), effects="unknown")

    def _refuse(self, text: str, what: str, effects: str = "none") -> None:
        if text == protocol.REFUSED or text.startswith("ERR"):
            raise DeviceError(
                f"{self.name}: the reader refuses {what} ({text}).",
                effects=effects,
                remedy="Look at the reader, then reset the module; a reset moves its carrier.",
            )

    def _recognise(self, link: Link) -> str:
        self._frames.forget()
        try:
            text = link.exchange(b"QQ", self.limit_s("answer", ANSWER_S))
        except LinkError as error:
            error.remedy = error.remedy or "Check that no other program uses the reader."
            raise
        return WHO if text.decode("ascii", "replace").startswith(STATES) else f"what answers {text[:40]!r}"

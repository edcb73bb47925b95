"""The protocol of the Infinite 200 (M series): USB bulk transfers of framed text, and of measured numbers.

A question is 0x02, text, 0x03, two zeros, the length, a check sum (exclusive or of the text, and of 1) and a
carriage return. An answer has the same frame. ``<n>,BIN:`` announces n bytes of numbers (big-endian) and four
more bytes. ``ST`` means standby, and ``BY#T<ms>`` busy for at most this time. ``+`` means that a setting is
accepted, ``-`` and ``ERR…`` that a command is refused.

Sources: PyLabRobot/pylabrobot, pylabrobot/plate_reading/tecan/infinite_backend.py (0.2.2, and a later version
for the queries of the carrier and of the plate sensor).
"""

from __future__ import annotations

import math
import re
import struct
from collections.abc import Mapping, Sequence
from functools import reduce
from operator import xor
from typing import NamedTuple

from labos.link import BadFrame

USB_VENDOR, USB_PRODUCT = 0x0C47, 0x8007
STX, ETX, CR, ESC = 0x02, 0x03, 0x0D, 0x1B
STATUS_SIZE = 31
"""Bytes of a status that begins with an escape, among the numbers of a scan."""

LONGEST = 64 * 1024
STANDBY, TAKEN, REFUSED = "ST", "+", "-"
BUSY = re.compile(r"BY(?:#T(\d+))?")
ANNOUNCED = re.compile(r"(\d{1,5}),BIN:")
IN, OUT = "IN", "OUT"

COUNTS_PER_MM = 1000
MOST_OD, MOST_WAVELENGTHS = 4.0, 800
FLASHES, BEAM_UM = 25, 700


class Grid(NamedTuple):
    """The wells of a plate according to ANSI/SLAS 4-2004: rows, columns, the distance of A1 from the left and
    from the back, and the pitch, in mm."""

    rows: int
    columns: int
    left_mm: float
    back_mm: float
    pitch_mm: float

    def well(self, row: int, column: int) -> str:
        return f"{'ABCDEFGHIJKLMNOP'[row]}{column + 1}"

    def x(self, column: int) -> int:
        return round((self.left_mm + self.pitch_mm * column) * COUNTS_PER_MM)

    def y(self, row: int) -> int:
        return round((self.back_mm + self.pitch_mm * row) * COUNTS_PER_MM)


GRIDS = {96: Grid(8, 12, 14.38, 11.24, 9.0), 384: Grid(16, 24, 12.12, 8.99, 4.5)}


class Calibration(NamedTuple):
    """The values of the measuring diode and of the reference diode, without light (dark) and with it."""

    dark: int
    bright: int
    reference_dark: int
    reference_bright: int


def check_sum(text: bytes) -> int:
    return reduce(xor, text, 1)


def frame(text: str) -> bytes:
    data = text.encode("ascii")
    return bytes((STX, *data, ETX, 0, 0, len(data) & 0xFF, check_sum(data), CR))


def list_wavelengths(start_nm: float, end_nm: float, step_nm: float) -> list[float]:
    """From start to end in nm, rounded to a tenth. Empty if the end lies before the start."""
    if end_nm < start_nm:
        return []
    count = int((end_nm - start_nm) / step_nm + 1e-9) + 1
    return [round(start_nm + number * step_nm, 1) for number in range(count)]


def bandwidth_nm(wavelength_nm: float) -> float:
    """The bandwidth to which the monochromator is set (nm)."""
    return 9.0 if wavelength_nm > 315 else 5.0


class Frames:
    """Takes messages out of the received bytes: texts, and packets of numbers after a zero byte."""

    def __init__(self) -> None:
        self._announced = 0
        self._cr_may_come = False

    def pack(self, message: bytes) -> bytes:
        return frame(message.decode("ascii"))

    def forget(self) -> None:
        """Forget an announced packet. It does not come any more if the connection was lost."""
        self._announced = 0

    def take(self, buffer: bytearray) -> bytes | None:
        if self._announced:
            if self._cr_may_come and buffer:
                self._cr_may_come = False
                if buffer[0] == CR:
                    del buffer[0]
            whole = self._announced + 4
            if len(buffer) < whole:
                return None
            self._announced, size = 0, self._announced
            packet = bytes(buffer[:size])
            del buffer[:whole]
            return b"\0" + packet
        while buffer and buffer[0] == ESC:
            if len(buffer) < STATUS_SIZE:
                return None
            del buffer[:STATUS_SIZE]
        while buffer and buffer[0] == CR:
            del buffer[0]
        return self._text(buffer) if buffer else None

    def _text(self, buffer: bytearray) -> bytes | None:
        if buffer[0] != STX:
            cut = buffer.find(STX)
            bad = bytes(buffer[:cut]) if cut > 0 else bytes(buffer)
            del buffer[: len(bad)]
            raise BadFrame(f"it does not begin as answers do: {bad[:60]!r}")
        end = buffer.find(ETX)
        if end < 0 or len(buffer) < end + 5:
            if len(buffer) > LONGEST:
                buffer.clear()
                raise BadFrame(f"{LONGEST} bytes have no end")
            return None
        text, trailer = bytes(buffer[1:end]), bytes(buffer[end + 1 : end + 5])
        del buffer[: end + 5]
        # The meaning of the device's trailer is not published. If it is built like ours, it has to fit.
        if trailer[:2] == b"\0\0" and trailer[2] == len(text) & 0xFF and trailer[3] != check_sum(text):
            raise BadFrame(f"the check sum of {text!r} is wrong")
        if not text.isascii() or not text.decode().isprintable():
            raise BadFrame(f"{text!r} is no text")
        if match := ANNOUNCED.fullmatch(text.decode()):
            self._announced, self._cr_may_come = int(match[1]), True
            return self.take(buffer)
        return text


def is_calibration(packet: bytes) -> bool:
    return len(packet) >= 22 and (len(packet) - 4) % 18 == 0


def is_measurement(packet: bytes) -> bool:
    return len(packet) >= 14 and (len(packet) - 4) % 10 == 0 and not is_calibration(packet)


def read_calibration(packet: bytes) -> Calibration:
    """The first item of a packet."""
    _, _, _, dark, bright, _, reference_dark, reference_bright = struct.unpack_from(">IHHHHHHH", packet, 4)
    return Calibration(dark, bright, reference_dark, reference_bright)


def write_calibration(wavelength_nm: float, calibration: Calibration) -> bytes:
    """The packet as the device sends it."""
    head = struct.pack(">HH", 0, round(wavelength_nm * 10))
    return head + struct.pack(
        ">IHHHHHHH",
        0,
        0,
        1,
        calibration.dark,
        calibration.bright,
        1,
        calibration.reference_dark,
        calibration.reference_bright,
    )


def read_measurement(packet: bytes) -> tuple[float, list[tuple[int, int]]]:
    """The wavelength in nm, and pairs of the values of sample and reference."""
    (tenths,) = struct.unpack_from(">H", packet, 2)
    pairs = [struct.unpack_from(">HH", packet, at + 6) for at in range(4, len(packet), 10)]
    return tenths / 10, [(sample, reference) for sample, reference in pairs]


def write_measurement(wavelength_nm: float, sample: int, reference: int) -> bytes:
    """The packet as the device sends it. It has one item, so it differs from a calibration in its length."""
    return struct.pack(">HH6xHH", 1, round(wavelength_nm * 10), sample, reference)


def optical_density(calibration: Calibration, pairs: Sequence[tuple[int, int]]) -> float:
    """The optical density by the mean transmittance, at most ``MOST_OD``. Raises ValueError without light."""
    through = calibration.bright - calibration.dark
    seen = [
        (s - calibration.dark) / (r - calibration.reference_dark)
        for s, r in pairs
        if r != calibration.reference_dark
    ]
    if not seen or through <= 0:
        raise ValueError("the lamp gave no light")
    transmittance = (
        sum(seen) / len(seen) * (calibration.reference_bright - calibration.reference_dark) / through
    )
    return round(-math.log10(max(transmittance, 10**-MOST_OD)), 4)


def write_table(spectra: Mapping[float, Mapping[str, float]], grid: Grid) -> bytes:
    """The table of optical densities by wavelength and well, as Magellan exports it: tabs, UTF-16."""
    lines = ["\t".join(["*", *(f"{nm:g}nm" for nm in spectra)])]
    for row in range(grid.rows):
        for column in range(grid.columns):
            well = grid.well(row, column)
            densities = (spectrum[well] for spectrum in spectra.values())
            lines.append("\t".join([well, *("NaN" if math.isnan(od) else f"{od:.4f}" for od in densities)]))
    return ("\r\n".join(lines) + "\r\n").encode("utf-16-le")

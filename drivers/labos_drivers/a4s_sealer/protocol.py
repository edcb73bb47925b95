"""The serial protocol of the a4S: frames, check sums, status records.

19200 baud, 8 data bits, no parity, 1 stop bit. A frame is ``*``, the body, two letters of check sum, and
``!``. The device ends each group of frames with a carriage return. The sum of the body's bytes and the
check sum is 0xB5 modulo 256. Each letter of the check sum is a nibble, from A for 0 to P for 15. A host may
send ``zz`` instead of the check sum.

Sources: PyLabRobot/pylabrobot, pylabrobot/azenta/a4s.py; AD-SDL/a4s_sealer_module. The rule for the check
sum was derived from captured records.
"""

from __future__ import annotations

import msgspec

from labos.link import Checked, Terminated

BAUDRATE = 19200
IDLE, SINGLE_CYCLE, REPEAT_CYCLE, ERROR, FINISHED = range(5)
HEATER_OFF, READY, HEATING, COOLING, CONVERGING = range(5)
SHUTTLE_MIDDLE, SHUTTLE_OUT, SHUTTLE_IN, DOOR, ROLL, HEATER_UP, HEATER_DOWN = (1 << bit for bit in range(7))


def check_sum(body: bytes) -> bytes:
    """The check sum of a message: two letters."""
    value = (0xB5 - sum(body)) & 0xFF
    return bytes((0x41 + (value >> 4), 0x41 + (value & 0x0F)))


def framing() -> Checked:
    """The framing of messages. A host sends the wildcard ``zz``, and checks what it receives."""
    return Checked(Terminated(b"!", start=b"*"), check_sum, 2, outgoing=b"zz")


class Status(msgspec.Struct, frozen=True):
    """A status record. The device counts ``remaining`` down during a cycle; its unit is not published."""

    temperature_c: float
    system: int
    heater: int
    error: int
    warning: int
    sensors: int
    remaining: int
    clock: str

    def has(self, sensor: int) -> bool:
        return bool(self.sensors & sensor)

    @property
    def shuttle(self) -> int:
        """The bits of the shuttle's sensors that are on. The position is known only if exactly one is on."""
        return self.sensors & (SHUTTLE_MIDDLE | SHUTTLE_OUT | SHUTTLE_IN)

    def is_before(self, other: Status) -> bool:
        """Whether this record is earlier by the device's clock; false if it has just passed midnight."""
        return self.clock < other.clock and not (other.clock >= "23:" and self.clock < "01:")

    @classmethod
    def read(cls, body: bytes) -> Status:
        """Parse a status record. Raises ValueError."""
        clock, separator, fields = body.decode("ascii")[1:].partition("=")
        numbers = [int(field) for field in fields.split(",")]
        if not separator or len(numbers) != 7:
            raise ValueError(f"{body!r} is no status record")
        tenths, system, heater, error, warning, sensors, remaining = numbers
        return cls(tenths / 10, system, heater, error, warning, sensors, remaining, clock)

    def body(self) -> bytes:
        """The record as the device sends it, without frame and check sum."""
        return (
            f"T{self.clock}={round(self.temperature_c * 10):04d},{self.system},{self.heater},"
            f"{self.error:02d},{self.warning:02d},{self.sensors:03d},{self.remaining:03d}"
        ).encode()

"""Modbus over TCP and over serial lines (RTU), with the messages of pymodbus. Framing, deadlines and the
matching of answers are as in every link. An answer over TCP contains the number of its question. An answer
over a serial line does not, so that after a failure the line must be silent for a while before the next
question.

Source: Modbus Application Protocol 1.1b3, Modbus over Serial Line 1.02, Modbus on TCP/IP 1.0b.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

from labos.errors import DeviceError, Garbled
from labos.link.framing import BadFrame
from labos.link.line import Link
from labos.link.serial import Parity, SerialWire
from labos.link.tcp import TcpWire
from labos.link.wire import needs

if TYPE_CHECKING:
    from pymodbus.pdu import ModbusPDU

EXCEPTIONS = {
    1: "it does not know this function",
    2: "it has no such address",
    3: "it does not take this value",
    4: "it failed during the operation",
    5: "it has started, and needs a long time",
    6: "it is busy",
    8: "its memory is damaged",
    10: "the gateway has no path to it",
    11: "it does not answer its gateway",
}
UNDECIDED = {4, 5, 11}
"""Exceptions after which the request may have been carried out."""


class ModbusLink:
    """Registers and coils of one unit. Addresses are those on the wire, from 0.

    A refusal by the device is a DeviceError; errors of the wire are LinkErrors.
    """

    def __init__(
        self, link: Link, unit: int, number: Callable[[], bytes] = lambda: b"", number_size: int = 0
    ) -> None:
        self._link, self._unit = link, unit
        self._number, self._skip = number, number_size
        self.name = link.name

    @classmethod
    def tcp(cls, host: str, port: int = 502, *, unit: int = 1, name: str = "") -> ModbusLink:
        """A device, or a gateway to one, on the network."""
        numbers = itertools.cycle(range(1, 0x10000))
        wire = TcpWire(host, port)
        link = Link(wire, _Mbap(), name=name or f"modbus {wire.name}", answers=_same_transaction)
        return cls(link, unit, lambda: next(numbers).to_bytes(2, "big"), 2)

    @classmethod
    def rtu(
        cls,
        port: str,
        *,
        unit: int = 1,
        baudrate: int = 19200,
        parity: Parity = "E",
        stopbits: float = 1,
        late_s: float = 1.0,
        name: str = "",
    ) -> ModbusLink:
        """A device on a serial line. ``late_s`` is the longest delay of an answer."""
        wire = SerialWire(port, baudrate=baudrate, parity=parity, stopbits=stopbits)
        link = Link(wire, _Rtu(), name=name or f"modbus {wire.name}", late_s=late_s)
        return cls(link, unit)

    @property
    def is_open(self) -> bool:
        return self._link.is_open

    def open(self, patience_s: float = 0.0) -> None:
        """Raises NotConnected."""
        self._link.open(patience_s)

    def close(self) -> None:
        self._link.close()

    # -- registers and coils -----------------------------------------------------------------

    def holding(self, address: int, count: int = 1, *, timeout_s: float = 2.0) -> list[int]:
        """Holding registers, 0 to 65535 each."""
        return self._registers("ReadHoldingRegistersRequest", address, count, timeout_s)

    def inputs(self, address: int, count: int = 1, *, timeout_s: float = 2.0) -> list[int]:
        """Input registers, 0 to 65535 each."""
        return self._registers("ReadInputRegistersRequest", address, count, timeout_s)

    def coils(self, address: int, count: int = 1, *, timeout_s: float = 2.0) -> list[bool]:
        return self._bits("ReadCoilsRequest", address, count, timeout_s)

    def discretes(self, address: int, count: int = 1, *, timeout_s: float = 2.0) -> list[bool]:
        """Discrete inputs."""
        return self._bits("ReadDiscreteInputsRequest", address, count, timeout_s)

    def write_holding(self, address: int, values: Sequence[int], *, timeout_s: float = 2.0) -> None:
        """Several holding registers in one message."""
        reply = self._do("WriteMultipleRegistersRequest", timeout_s, address=address, registers=list(values))
        self._check_echo(reply, address, len(values))

    def write_coils(self, address: int, values: Sequence[bool], *, timeout_s: float = 2.0) -> None:
        """Several coils in one message."""
        reply = self._do("WriteMultipleCoilsRequest", timeout_s, address=address, bits=list(values))
        self._check_echo(reply, address, len(values))

    # -- inside ------------------------------------------------------------------------------

    def _registers(self, kind: str, address: int, count: int, timeout_s: float) -> list[int]:
        found = list(self._do(kind, timeout_s, address=address, count=count).registers)
        if len(found) != count:
            raise Garbled(f"{self.name}: {count} registers were requested, {len(found)} were received.")
        return found

    def _bits(self, kind: str, address: int, count: int, timeout_s: float) -> list[bool]:
        found = list(self._do(kind, timeout_s, address=address, count=count).bits)
        if len(found) != (count + 7) // 8 * 8:
            raise Garbled(f"{self.name}: {count} bits were requested, {len(found)} were received.")
        return found[:count]

    def _do(self, kind: str, timeout_s: float, **fields: Any) -> ModbusPDU:
        try:
            from pymodbus.pdu import DecodePDU, bit_message, register_message
        except ImportError as error:
            raise needs("modbus", error) from error
        source = register_message if "Register" in kind else bit_message
        request: ModbusPDU = getattr(source, kind)(dev_id=self._unit, **fields)
        answer = self._link.exchange(self._number() + _body(self._unit, request), timeout_s)
        unit, body = answer[self._skip], answer[self._skip + 1 :]
        function = body[0] & 0x7F if body else 0
        if unit != self._unit or function != request.function_code:
            raise Garbled(
                f"{self.name}: the answer is from unit {unit} for function {function}, but the "
                f"request was to unit {self._unit} for function {request.function_code}."
            )
        reply = DecodePDU(False).decode(body)
        if reply is None:
            raise Garbled(f"{self.name} sent data that is not a Modbus message: {body!r}.")
        if body[0] & 0x80:
            code = int(reply.exception_code)
            raise DeviceError(
                f"{self.name}, unit {self._unit}: {EXCEPTIONS.get(code, 'it refuses')} "
                f"(Modbus exception {code}, function {function}, address {fields['address']}).",
                effects="unknown" if code in UNDECIDED else "none",
                remedy="Compare the address with the device's manual.",
            )
        return reply

    def _check_echo(self, reply: ModbusPDU, address: int, count: int) -> None:
        """Check the answer to a write, which contains its address and length."""
        if (reply.address, reply.count) != (address, count):
            raise Garbled(
                f"{self.name}: {count} values were written to {address}, but the device confirms "
                f"{reply.count} at {reply.address}."
            )


def _body(unit: int, pdu: ModbusPDU) -> bytes:
    return bytes([unit, pdu.function_code]) + pdu.encode()


def _same_transaction(question: bytes, answer: bytes) -> bool:
    return question[:2] == answer[:2]


class _Mbap:
    """A header (transaction, protocol 0, length), then unit and message."""

    def pack(self, message: bytes) -> bytes:
        number, body = message[:2], message[2:]
        return number + b"\0\0" + len(body).to_bytes(2, "big") + body

    def take(self, buffer: bytearray) -> bytes | None:
        if len(buffer) < 6:
            return None
        length = int.from_bytes(buffer[4:6], "big")
        if buffer[2:4] != b"\0\0" or not 2 <= length <= 254:
            bad = bytes(buffer)
            buffer.clear()
            raise BadFrame(f"no Modbus header: {bad[:16]!r}")
        if len(buffer) < 6 + length:
            return None
        message = bytes(buffer[:2]) + bytes(buffer[6 : 6 + length])
        del buffer[: 6 + length]
        return message


class _Rtu:
    """Unit and message with a check sum. The function determines the length of a message."""

    def pack(self, message: bytes) -> bytes:
        return message + crc16(message)

    def take(self, buffer: bytearray) -> bytes | None:
        if len(buffer) < 5:
            return None
        from pymodbus.pdu import DecodePDU

        kind = DecodePDU(False).lookupPduClass(bytes(buffer))
        size = kind.calculateRtuFrameSize(bytes(buffer)) if kind is not None else 0
        if size and len(buffer) < size:
            return None
        frame = bytes(buffer[:size])
        if not size or crc16(frame[:-2]) != frame[-2:]:
            bad = bytes(buffer)
            buffer.clear()
            raise BadFrame(
                f"the check sum of {bad[:16]!r} is wrong" if size else f"unknown function: {bad[:16]!r}"
            )
        del buffer[:size]
        return frame[:-2]


def crc16(data: bytes) -> bytes:
    """The check sum of Modbus over serial lines (6.2.2), low byte first."""
    value = 0xFFFF
    for byte in data:
        value ^= byte
        for _ in range(8):
            value = value >> 1 ^ (0xA001 if value & 1 else 0)
    return value.to_bytes(2, "little")

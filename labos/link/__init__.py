"""Links to devices, all with the same interface.

::

    link = Link(SerialWire("/dev/ttyUSB0", baudrate=9600), Terminated(b"\\r\\n"))
    link.open()
    answer = link.exchange(b"*stat", timeout_s=2.0)

A link opens, exchanges messages within a deadline, connects again (with increasing pauses) and closes. It
never sends anything twice by itself. Each failure is an error of its own kind (``LinkError`` in
``labos.errors``). An answer that may belong to another question is never returned.

Links block: call them in plain ``def`` actions, which run in a thread of the node. The external library of a
link (pyserial, pymodbus, python-can, canopen) is imported when the link is opened.
"""

from typing import TYPE_CHECKING, Any

from labos.errors import (
    Garbled,
    HalfReply,
    LinkError,
    LinkLost,
    NoReply,
    NotConnected,
    StrayReply,
    WrongDevice,
)
from labos.link.can import CanLink, CanMessage, SdoLink
from labos.link.device import DeviceOnLine, ReceivingDevice, TimedDevice
from labos.link.farend import FarEnd, PtyEnd, TcpEnd, replay, serial_end, server_at
from labos.link.framing import BadFrame, Checked, Framing, LengthPrefixed, Terminated
from labos.link.line import Link
from labos.link.modbus import ModbusLink
from labos.link.scripted import OffScript, ScriptedHttp, ScriptedWire
from labos.link.serial import SerialWire
from labos.link.tcp import TcpWire
from labos.link.transcript import (
    TranscriptLine,
    keep_transcript,
    read_transcript,
    start_recording,
    stop_recording,
)
from labos.link.usb import UsbWire
from labos.link.wire import Wire

if TYPE_CHECKING:
    from labos.link.http import HttpLink, HttpReply

__all__ = [
    "BadFrame",
    "CanLink",
    "CanMessage",
    "Checked",
    "DeviceOnLine",
    "FarEnd",
    "Framing",
    "Garbled",
    "HalfReply",
    "HttpLink",
    "HttpReply",
    "LengthPrefixed",
    "Link",
    "LinkError",
    "LinkLost",
    "ModbusLink",
    "NoReply",
    "NotConnected",
    "OffScript",
    "PtyEnd",
    "ReceivingDevice",
    "ScriptedHttp",
    "ScriptedWire",
    "SdoLink",
    "SerialWire",
    "StrayReply",
    "TcpEnd",
    "TcpWire",
    "Terminated",
    "TimedDevice",
    "TranscriptLine",
    "UsbWire",
    "Wire",
    "WrongDevice",
    "keep_transcript",
    "read_transcript",
    "replay",
    "serial_end",
    "server_at",
    "start_recording",
    "stop_recording",
]


def __getattr__(name: str) -> Any:
    # httpx takes longer to import than all the rest together.
    if name not in ("HttpLink", "HttpReply"):
        raise AttributeError(name)
    from labos.link import http

    return getattr(http, name)

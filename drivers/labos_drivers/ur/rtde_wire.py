"""The real-time port of a simulated UR controller: the handshake, the recipe, and the stream of outputs."""

from __future__ import annotations

import struct
import time
from collections.abc import Callable, Mapping
from typing import Any

from labos.link import BadFrame, TcpEnd
from labos_drivers.ur import rtde

RECIPE = 1
FASTEST_HZ = 500.0
SOFTWARE = (5, 12, 2, 1101534)


class RtdePort:
    """The port, for one client at a time. ``read_outputs`` returns the present value of each output, and
    ``types`` has the type of each."""

    def __init__(
        self,
        read_outputs: Callable[[], Mapping[str, Any]],
        types: Mapping[str, str],
        end: TcpEnd | None = None,
    ) -> None:
        self.end = end or TcpEnd()
        self._read_outputs, self._types = read_outputs, types
        self._buffer = bytearray()
        self._packages = rtde.Packages()
        self._client = 0
        self._hang_up()

    def close(self) -> None:
        self.end.close()

    def listen(self, timeout_s: float) -> None:
        """Wait for packages and answer them; then send a data package if one is due."""
        data = self.end.read(timeout_s)
        if self.end.clients != self._client:
            self._client = self.end.clients
            self._hang_up()
        self._buffer += data
        try:
            while (message := self._packages.take(self._buffer)) is not None:
                self._answer(message[:1], message[1:])
        except (BadFrame, ValueError, struct.error):
            self.end.write(self._packages.pack(rtde.TEXT + b"\x0cno such thing\x00\x03"))
        self._send_outputs()

    def _hang_up(self) -> None:
        self._buffer.clear()
        self._outputs: list[str] = []
        self._every_s = 1.0
        self._is_started = False
        self._due = 0.0

    def _answer(self, kind: bytes, content: bytes) -> None:
        match kind:
            case rtde.ASK_VERSION:
                accepted = content == struct.pack(">H", rtde.VERSION)
                self._send(kind, bytes([accepted]))
            case rtde.ASK_CONTROLLER:
                self._send(kind, struct.pack(">4I", *SOFTWARE))
            case rtde.OUTPUTS:
                frequency_hz, self._outputs = rtde.parse_outputs(content)
                self._every_s = 1 / min(max(frequency_hz, 1.0), FASTEST_HZ)
                types = rtde.types_of(self._types, self._outputs)
                self._send(kind, bytes([RECIPE]) + ",".join(types).encode("ascii"))
            case rtde.START:
                known = bool(self._outputs) and all(name in self._types for name in self._outputs)
                self._is_started = known
                self._due = time.monotonic()
                self._send(kind, bytes([known]))
            case rtde.PAUSE:
                self._is_started = False
                self._send(kind, b"\x01")

    def _send_outputs(self) -> None:
        now = time.monotonic()
        if self._is_started and now >= self._due:
            self._due = max(self._due + self._every_s, now)
            read_outputs = self._read_outputs()
            types = [self._types[name] for name in self._outputs]
            package = rtde.pack_values(RECIPE, types, (read_outputs[name] for name in self._outputs))
            self.end.write(self._packages.pack(package))

    def _send(self, kind: bytes, content: bytes) -> None:
        self.end.write(self._packages.pack(kind + content))

"""TCP connections as streams of bytes, without framing."""

from __future__ import annotations

import select
import socket

from labos.errors import LinkLost, NotConnected


class TcpWire:
    """A connection to ``host:port``. A new connection has no bytes of the old one."""

    forgets = True

    def __init__(self, host: str, port: int, *, connect_s: float = 5.0) -> None:
        self.host, self.port = host, port
        self.name = f"tcp {host}:{port}"
        self._connect_s = connect_s
        self._socket: socket.socket | None = None

    def open(self) -> None:
        try:
            self._socket = socket.create_connection((self.host, self.port), timeout=self._connect_s)
            self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
        except OSError as error:
            raise NotConnected(
                f"{self.name} does not take a connection: {error.strerror or error}.",
                remedy="Check its power, the network cable, the address and the port.",
            ) from error

    def write(self, data: bytes, timeout_s: float) -> None:
        wire = self._find_socket()
        try:
            wire.settimeout(timeout_s)
            wire.sendall(data)
        except OSError as error:
            raise self._describe_loss(error) from error

    def read(self, timeout_s: float) -> bytes:
        wire = self._find_socket()
        try:
            if not select.select([wire], [], [], timeout_s)[0]:
                return b""
            data = wire.recv(65536)
        except (OSError, ValueError) as error:
            raise self._describe_loss(error) from error
        if not data:
            raise LinkLost(f"{self.name} closed the connection.", remedy="Check the device.")
        return data

    def close(self) -> None:
        wire, self._socket = self._socket, None
        if wire is not None:
            wire.close()

    def _find_socket(self) -> socket.socket:
        if self._socket is None:
            raise LinkLost(f"{self.name} is not open.", effects="none")
        return self._socket

    def _describe_loss(self, error: Exception) -> LinkLost:
        reason = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
        return LinkLost(
            f"{self.name}: the connection is lost: {reason}.",
            remedy="Check its power and the network cable.",
        )

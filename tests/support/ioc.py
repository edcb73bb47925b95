"""A real EPICS IOC as a process, and a line to it that can be cut."""

from __future__ import annotations

import contextlib
import socket
import struct
import threading
from pathlib import Path
from typing import Any

from labos.settings import free_port
from tests.support.foreign import ForeignProcess

HEADER = struct.Struct(">HHHHII")
SEARCH = 6
PVA_SEARCH, PVA_FOUND = 3, 4


class Ioc(ForeignProcess):
    """``port`` is that of Channel Access; PV Access has its own."""

    says_up = "the IOC is up"

    def __init__(self, folder: Path) -> None:
        super().__init__("epics", folder, free_port())
        self.pva_port, self.pva_search = free_port(), free_port()

    @property
    def config(self) -> dict[str, Any]:
        """Where it is, for the adapter."""
        return {"ca_address": f"127.0.0.1:{self.port}", "pva_address": f"127.0.0.1:{self.pva_search}"}

    def environment(self) -> dict[str, str]:
        """It listens on loopback only."""
        return {
            "EPICS_CA_SERVER_PORT": str(self.port),
            "EPICS_CAS_INTF_ADDR_LIST": "127.0.0.1",
            "EPICS_CAS_BEACON_ADDR_LIST": "127.0.0.1",
            "EPICS_CAS_AUTO_BEACON_ADDR_LIST": "NO",
            "EPICS_PVAS_SERVER_PORT": str(self.pva_port),
            "EPICS_PVAS_BROADCAST_PORT": str(self.pva_search),
            "EPICS_PVAS_INTF_ADDR_LIST": "127.0.0.1",
            "EPICS_PVAS_BEACON_ADDR_LIST": "127.0.0.1",
            "EPICS_PVAS_AUTO_BEACON_ADDR_LIST": "NO",
        }


class CaLine:
    """Stands between a client of Channel Access and an IOC: searches by UDP are passed on, and the answers
    name this line's own port; the connections can be cut. ``target`` is where the IOC listens, ``search``
    where it is searched for, if that is another port."""

    def __init__(self, target: int, search: int = 0) -> None:
        self.target, self.search = target, search or target
        self._near = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._near.bind(("127.0.0.1", 0))
        self.port = int(self._near.getsockname()[1])
        self._server = socket.create_server(("127.0.0.1", self.port))
        self._far = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._far.bind(("127.0.0.1", 0))
        self._client: Any = None
        self._open: list[socket.socket] = []
        for work in (self._listen, self._ask, self._answer):
            threading.Thread(target=work, daemon=True).start()

    def cut(self) -> None:
        """Cut all connections; the next ones are let through."""
        for each in self._open:
            with contextlib.suppress(OSError):
                each.shutdown(socket.SHUT_RDWR)
        self._open.clear()

    def close(self) -> None:
        self.cut()
        for each in (self._server, self._near, self._far):
            with contextlib.suppress(OSError):
                each.shutdown(socket.SHUT_RDWR)
            each.close()

    def _ask(self) -> None:
        with contextlib.suppress(OSError):
            while True:
                data, self._client = self._near.recvfrom(65536)
                self._far.sendto(self.name_far(data), ("127.0.0.1", self.search))

    def _answer(self) -> None:
        with contextlib.suppress(OSError):
            while True:
                data = self.name_near(bytearray(self._far.recv(65536)))
                if self._client:
                    self._near.sendto(data, self._client)

    def name_far(self, data: bytes) -> bytes:
        """A search, as it is passed on."""
        return data

    def name_near(self, data: bytearray) -> bytes:
        """An answer to a search, naming this line."""
        start = 0
        while start + HEADER.size <= len(data):
            command, size, _, *rest = HEADER.unpack_from(data, start)
            if command == SEARCH:
                HEADER.pack_into(data, start, command, size, self.port, *rest)
            start += HEADER.size + size
        return bytes(data)

    def _listen(self) -> None:
        with contextlib.suppress(OSError):
            while True:
                near, _ = self._server.accept()
                far = socket.create_connection(("127.0.0.1", self.target))
                self._open += [near, far]
                for source, target in ((near, far), (far, near)):
                    threading.Thread(target=_pump, args=(source, target), daemon=True).start()


class PvaLine(CaLine):
    """The same for PV Access. A search says to which port its answer goes, and an answer where the server
    listens; both stand at fixed places behind the header of 8 bytes, whose flags tell the order of bytes."""

    ANSWER_TO, SERVER = 32, 40
    """Where the ports stand: behind sequence, flags and address; behind GUID, sequence and address."""

    def name_far(self, data: bytes) -> bytes:
        return self._with_port(bytearray(data), PVA_SEARCH, self.ANSWER_TO, self._far.getsockname()[1])

    def name_near(self, data: bytearray) -> bytes:
        return self._with_port(data, PVA_FOUND, self.SERVER, self.port)

    def _with_port(self, data: bytearray, command: int, place: int, port: int) -> bytes:
        if len(data) > place and data[3] == command:
            struct.pack_into(">H" if data[2] & 0x80 else "<H", data, place, port)
        return bytes(data)


def _pump(source: socket.socket, target: socket.socket) -> None:
    with contextlib.suppress(OSError):
        while data := source.recv(65536):
            target.sendall(data)
    with contextlib.suppress(OSError):
        target.shutdown(socket.SHUT_RDWR)
    source.close()

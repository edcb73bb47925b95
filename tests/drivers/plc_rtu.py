"""The hatch on a serial line, for the torture suite."""

from __future__ import annotations

import threading
from typing import Any

import msgspec

from labos.link import PtyEnd
from labos.node import Setup
from labos_drivers.plc.interface import Plc
from labos_drivers.plc.torture import TORTURE as ON_TCP
from labos_drivers.plc.wire import Hatch


class PlcOnLine(Plc):
    """The PLC of the hatch, over Modbus RTU."""


class HatchOnLine(Hatch):
    """On a serial line (RTU): two pseudo-terminals, joined as by a null-modem cable."""

    def __init__(self, setup: Setup) -> None:
        super().__init__(setup)
        self._cable = _Cable()

    @property
    def address(self) -> str:
        return self._cable.near.address

    def close(self) -> None:
        super().close()
        self._cable.close()

    async def _serve(self, memory: Any) -> Any:
        from pymodbus.server import ModbusSerialServer

        server = ModbusSerialServer(memory, port=self._cable.far.address, baudrate=19200)
        await server.serve_forever(background=True)
        return server


class _Cable:
    """What goes in at one end comes out at the other."""

    def __init__(self) -> None:
        self.near, self.far = PtyEnd(), PtyEnd()
        self._over = threading.Event()
        pairs = ((self.near, self.far), (self.far, self.near))
        self._threads = [threading.Thread(target=self._copy, args=pair, daemon=True) for pair in pairs]
        for thread in self._threads:
            thread.start()

    def close(self) -> None:
        self._over.set()
        for thread in self._threads:
            thread.join(5)
        self.near.close()
        self.far.close()

    def _copy(self, source: PtyEnd, target: PtyEnd) -> None:
        while not self._over.is_set():
            if data := source.read(0.05):
                target.write(data)


TORTURE = msgspec.structs.replace(
    ON_TCP,
    device=HatchOnLine,
    settings={"parity": "N", "late_s": 0.2},  # a pseudo-terminal knows no parity
)

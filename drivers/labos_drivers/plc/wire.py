"""A simulated PLC at the far end of a network or a serial line: the server of pymodbus, with the program of
the hatch in ``hatch.yaml`` behind it.

It works like a PLC: in each cycle it reads the values that were written to it, works, and shows its state.
The values that it shows are therefore up to one cycle old. A motion begins up to one cycle after its request.
"""

from __future__ import annotations

import asyncio
import struct
import threading
import time
from collections.abc import Coroutine
from typing import Any, TypeVar

from labos.errors import NotConnected
from labos.link.wire import needs
from labos.node import Crash, Setup
from labos_drivers._onwire import Timed

T = TypeVar("T")

CYCLE_S = 0.01
SENSOR_S = 0.05
UNIT = 1
READY_S = 20.0

TRAVEL_MM, WATCHDOG = 400.0, 1.5
"""How far the door goes; after so many times the time that it needs it counts as jammed."""

INSIDE_C = 21.5
OPEN, CLOSE = 1, 2
JAMMED, CURTAIN, HALTED, EMERGENCY, NO_SUCH = range(1, 6)

READ_COILS, READ_DISCRETES, READ_HOLDING, READ_INPUTS = 1, 2, 3, 4
"""Modbus' functions, by which the server's memory is told apart."""


class Hatch(Timed):
    """A sliding door with a motor, and the program of its PLC. ``jammed``, ``curtain`` and ``emergency`` are
    set from outside and cause faults. While ``local`` is true, no motion can be started over Modbus."""

    def __init__(self, setup: Setup) -> None:
        super().__init__(setup)
        self.nest = self.place("nest")
        self.position = 0.0 if self.world.is_shut(self.nest) else 1.0
        self.jammed = self.curtain = self.emergency = self.local = False
        self.fault = self.taken = self.ended = 0
        self.starts = time.monotonic_ns() // 1_000_000 % 0xFFFF + 1
        self.plate = False
        self._motor = 0
        self._since_s = self._needs_s = 0.0
        self._sensed_s = float("-inf")
        self._shown: tuple[list[bool], list[int]] = ([], [])
        self._loop = asyncio.new_event_loop()
        self._server: Any = None
        self._is_ready = threading.Event()

    # -- start and end -----------------------------------------------------------------------

    def start(self) -> None:
        super().start()
        if not self._is_ready.wait(READY_S):
            raise NotConnected(f"The simulated PLC {self.name} does not start.", remedy="Check its log.")

    def power_on(self) -> None:
        self._server = self._do(self._serve(self._memory()))
        self._cycle()
        self._is_ready.set()

    def _live(self) -> None:
        try:
            super()._live()
        finally:
            if self._server is not None:
                self._do(self._server.shutdown())
                self._do(asyncio.sleep(0))
            self._loop.close()

    def _memory(self) -> Any:
        try:
            from pymodbus.simulator import DataType, SimData, SimDevice
        except ImportError as error:
            raise needs("modbus", error) from error
        bits = [SimData(0, values=[False] * 16, datatype=DataType.BITS)]
        words = [SimData(0, values=[0] * 16, datatype=DataType.REGISTERS)]
        return SimDevice(id=UNIT, simdata=(bits, list(bits), words, list(words)))

    async def _serve(self, memory: Any) -> Any:
        """Start a server that listens; from then on ``address`` is known."""
        raise NotImplementedError

    def _do(self, work: Coroutine[Any, Any, T]) -> T:
        return self._loop.run_until_complete(work)

    def listen(self, timeout_s: float) -> None:
        """Let the server work for one cycle or ``timeout_s``, whichever is shorter, then the program."""
        self._do(asyncio.sleep(min(timeout_s, CYCLE_S)))
        self._cycle()

    # -- one cycle ---------------------------------------------------------------------------

    def _cycle(self) -> None:
        command, speed, high, low = self._do(self._server.async_getValues(UNIT, READ_HOLDING, 0, 4))
        reset, halt = self._do(self._server.async_getValues(UNIT, READ_COILS, 0, 2))
        if reset or halt:
            self._do(self._server.async_setValues(UNIT, READ_COILS, 0, [False, False]))
        number = high << 16 | low
        if reset and not self.emergency:
            self.fault = 0
        if halt and number not in (0, self.taken):
            self.taken = number  # stop and number in one cycle: accept the number, but do not move
            self._fail(HALTED)
        self._watch(halt)
        if number not in (0, self.taken) and not (self.fault or self._motor or self.local):
            self._take(number, command, speed / 10)
        self._show()

    def _watch(self, halt: bool) -> None:
        if self.emergency and self.fault != EMERGENCY:
            self._fail(EMERGENCY)
        elif halt and self._motor:
            self._fail(HALTED)
        elif self._motor == CLOSE and self.curtain:
            self._fail(CURTAIN)
        elif self._motor and self.now_s() - self._since_s > WATCHDOG * self._needs_s + 0.1 * self._pace:
            self._fail(JAMMED)

    def _take(self, number: int, command: int, speed_mm_s: float) -> None:
        self.taken = number
        if command not in (OPEN, CLOSE) or not speed_mm_s:
            self._fail(NO_SUCH)
            return
        goal = 1.0 if command == OPEN else 0.0
        if self.position == goal:
            self.ended = number
            return
        self._motor, self._since_s = command, self.now_s()
        self._needs_s = abs(goal - self.position) * TRAVEL_MM / speed_mm_s
        self.world.work(self.name, "opens" if command == OPEN else "closes")
        if command == CLOSE and not self.world.is_shut(self.nest):
            self.shut("nest")
        if not self.jammed:
            self.after(self._needs_s, lambda: self._arrive(number, goal))

    def _arrive(self, number: int, goal: float) -> None:
        if self.jammed:
            return
        self._motor, self.position, self.ended = 0, goal, number
        if goal:
            self.open("nest")
        else:
            self.world.work(self.name, "locks")

    def _fail(self, fault: int) -> None:
        """Stop the motor and show the fault. The door stays at its present position."""
        self.forget_plans()
        if self._motor:
            way = min((self.now_s() - self._since_s) / self._needs_s, 0.9) if not self.jammed else 0.1
            goal = 1.0 if self._motor == OPEN else 0.0
            self.position += (goal - self.position) * way
        self._motor, self.fault = 0, fault

    def _show(self) -> None:
        now = time.monotonic()
        if now - self._sensed_s > SENSOR_S:
            self._sensed_s, self.plate = now, bool(self.top(self.nest))
        still = not self._motor
        bits = [
            still and self.position == 1.0,
            still and self.position == 0.0,
            bool(self._motor),
            self.plate,
            self.emergency,
            self.curtain,
        ]
        words = struct.unpack(">6H", struct.pack(">fII", INSIDE_C, self.taken, self.ended))
        shown = bits, [self.fault, *words, self.starts]
        if shown != self._shown:
            self._do(self._server.async_setValues(UNIT, READ_DISCRETES, 0, bits))
            self._do(self._server.async_setValues(UNIT, READ_INPUTS, 0, shown[1]))
            self._shown = shown

    def damage(self, crash: Crash) -> None:
        self._fail(JAMMED)


class HatchOnTcp(Hatch):
    """The hatch behind Modbus TCP."""

    @property
    def address(self) -> str:
        return f"127.0.0.1:{self._port}"

    async def _serve(self, memory: Any) -> Any:
        from pymodbus.server import ModbusTcpServer

        server = ModbusTcpServer(memory, address=("127.0.0.1", 0))
        await server.serve_forever(background=True)
        transport: Any = server.transport
        self._port = int(transport.sockets[0].getsockname()[1])
        return server

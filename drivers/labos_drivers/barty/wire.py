"""A simulated Barty at the far end of a TCP connection: a Raspberry Pi with a pigpio daemon, four bridges,
and pumps that run while they are enabled."""

from __future__ import annotations

import select
import socket
from collections.abc import Callable

import msgspec

from labos.link import FarEnd, TcpEnd
from labos.node import Setup
from labos_drivers._onwire import OnWire
from labos_drivers.barty import protocol
from labos_drivers.barty.protocol import PINS
from labos_drivers.barty.simulator import Tanks

VERSION = 79
NO_SCRIPT, BAD_COMMAND, RUNS = -48, -88, -115
NOTIFIES = (19, 20, 21, 99)
RATE_NOISE = 0.02


class Daemon(TcpEnd):
    """A port for several clients. Each gets its reply before the data of the next one are read."""

    def __init__(self) -> None:
        super().__init__()
        self._clients: list[socket.socket] = []

    def read(self, timeout_s: float) -> bytes:
        waiting = [one for one in (self._listener, *self._clients) if one.fileno() >= 0]
        try:
            for ready in select.select(waiting, [], [], timeout_s)[0]:
                if ready is self._listener:
                    self._clients.append(self._listener.accept()[0])
                elif data := ready.recv(65536):
                    self._client = ready
                    return bytes(data)
                else:
                    self._clients.remove(ready)
                    ready.close()
        except (OSError, ValueError):
            self._hang_up()
        return b""

    def _hang_up(self) -> None:
        clients, self._clients, self._client = self._clients, [], None
        for client in clients:
            client.close()


class Script(msgspec.Struct):
    """The words of a script, the position in them, and the script's own time (``clock_s``)."""

    words: list[str]
    at: int = 0
    status: int = protocol.HALTED
    parameters: list[int] = msgspec.field(default_factory=lambda: [0] * 10)
    run: int = 0
    clock_s: float = 0.0


class BartyOnWire(OnWire):
    """The simulated device. A pump that is ``stuck`` moves no ink while its motor is enabled."""

    def __init__(self, setup: Setup, end: FarEnd | None = None) -> None:
        super().__init__(setup, end)
        self.levels = [0] * 32
        self.stuck: set[int] = set()
        self.refuses = False
        self.tanks = Tanks(self.world, self.name)
        self._scripts: dict[int, Script] = {}
        self._since_s: dict[int, float] = {}
        self._received = b""

    def make_end(self) -> FarEnd:
        return Daemon()

    @property
    def address(self) -> str:
        return self.end.address.removeprefix("socket://")

    def close(self) -> None:
        """Switch the power off: all pumps stop."""
        super().close()
        for pump in list(self._since_s):
            self._stop(pump, self.now_s())

    # -- receiving ---------------------------------------------------------------------------

    def receive(self, data: bytes) -> None:
        self._received += data
        size = protocol.HEADER.size
        while len(self._received) >= size:
            command, p1, p2, more = protocol.HEADER.unpack_from(self._received)
            if len(self._received) < size + more:
                return
            text, self._received = self._received[size : size + more], self._received[size + more :]
            result, extra = self._answer(command, p1, p2, text)
            self.send(protocol.HEADER.pack(command, p1, p2, result) + extra)

    def _answer(self, command: int, p1: int, p2: int, text: bytes) -> tuple[int, bytes]:
        script = self._scripts.get(p1)
        match command:
            case protocol.PIGPV:
                return VERSION, b""
            case code if code in NOTIFIES:
                return 0, b""  # accepted, but changes of pins are not reported
            case protocol.READ:
                return self.levels[p1], b""
            case protocol.WRITE:
                self._write(p1, p2)
                return 0, b""
            case protocol.PROC:
                return self._store(text.decode("ascii", "replace")), b""
            case protocol.PROCR | protocol.PROCS | protocol.PROCD | protocol.PROCP if script is None:
                return NO_SCRIPT, b""
            case protocol.PROCR if script is not None:
                return self._run(script), b""
            case protocol.PROCS if script is not None:
                self._halt(script)
                return 0, b""
            case protocol.PROCD if script is not None:
                self._halt(script)
                del self._scripts[p1]
                return 0, b""
            case protocol.PROCP if script is not None:
                return protocol.STATUS.size, protocol.STATUS.pack(script.status, *script.parameters)
        return BAD_COMMAND, b""

    def press(self, pin: int) -> None:
        """A person sets a pin high by hand."""
        self._write(pin, 1)

    # -- scripts -----------------------------------------------------------------------------

    def _store(self, text: str) -> int:
        number = next((n for n in range(protocol.ROOM) if n not in self._scripts), None)
        if number is None or self.refuses:
            return protocol.NO_ROOM
        self._scripts[number] = Script(text.lower().split())
        return number

    def _run(self, script: Script) -> int:
        if script.status == protocol.RUNNING:
            return RUNS
        script.at, script.status = 0, protocol.RUNNING
        script.run += 1
        script.clock_s = self.now_s()
        self._go_on(script, script.run)
        return 0

    def _halt(self, script: Script) -> None:
        """Stop a script. The pins keep their levels."""
        script.status = protocol.HALTED
        script.run += 1

    def _go_on(self, script: Script, run: int) -> None:
        while script.run == run and script.at < len(script.words):
            word, *rest = script.words[script.at : script.at + 3]
            match word, *rest:
                case "mils", milliseconds, *_:
                    script.at += 2
                    script.clock_s += int(milliseconds) / 1000
                    self.after(int(milliseconds) / 1000, lambda: self._go_on(script, run), exact=True)
                    return
                case "w", pin, level:
                    self._write(int(pin), int(level), script.clock_s)
                    script.at += 3
                case "m", _, _:
                    script.at += 3
                case "ld", register, value:
                    script.parameters[int(register.removeprefix("p"))] = int(value)
                    script.at += 3
                case _:
                    script.status = protocol.FAILED
                    return
        if script.run == run:
            script.status = protocol.HALTED

    # -- pumps -------------------------------------------------------------------------------

    def _write(self, pin: int, level: int, at_s: float | None = None) -> None:
        """Set a pin. A script gives its own time ``at_s``, independent of delays of this computer."""
        was, self.levels[pin] = self.levels[pin], level
        for pump, pins in enumerate(PINS):
            if pins.enable == pin and was != level:
                change: Callable[[int, float], None] = self._start if level else self._stop
                change(pump, self.now_s() if at_s is None else at_s)

    def _start(self, pump: int, at_s: float) -> None:
        self._since_s[pump] = at_s
        self.world.enter(self.name, self.name)

    def _stop(self, pump: int, at_s: float) -> None:
        ran_s = at_s - self._since_s.pop(pump)
        pins = PINS[pump]
        way = self.levels[pins.backward] - self.levels[pins.forward]
        rate = protocol.ML_PER_S * self._random.gauss(1.0, RATE_NOISE)
        wanted = 0.0 if pump in self.stuck else way * rate * ran_s
        if not self._since_s:
            self.world.leave(self.name)
        if way:  # an enabled bridge without a direction turns no motor
            self.tanks.pump(pump, wanted)

    def damage(self, crash: Exception) -> None:
        """Ink runs over the deck. The device does not detect it."""

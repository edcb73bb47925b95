"""A relay between a driver and a simulated device, which can cut and spoil the line. Messages of the driver
always arrive. Messages of the device can be lost, held back, garbled or cut short. The line can be unplugged,
and the device behind it can be switched off and on.
"""

from __future__ import annotations

import contextlib
import re
import socket
import threading
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Literal, Protocol
from urllib.parse import urlsplit

from labos.errors import LinkError
from labos.link import PtyEnd, SerialWire, server_at

Mode = Literal["pass", "lose", "hold", "garble", "cut", "precede"]
Write = Callable[[bytes], object]

POLL_S = 0.05
ANSWER_S = 0.5
"""How long to wait for the answer to the last question; a device need not answer every message."""

NOWHERE = ("", 0)

MOST_KINDS, LONGEST_KIND = 500, 200
"""The number of first bytes by which kinds of questions are distinguished, ignoring numbers in them."""

_DIGITS = re.compile(rb"[0-9]+")


class Relay(Protocol):
    """``address`` is the address that the driver opens instead of the device's own. ``spoiled`` counts the
    spoiled messages since the last request to spoil. ``questions`` are the kinds of messages of the driver,
    each once and in order."""

    address: str

    @property
    def questions(self) -> list[bytes]: ...

    @property
    def spoiled_count(self) -> int: ...

    def spoil(self, mode: Mode, *, times: int = 0, to: bytes = b"", stray: bytes = b"") -> None:
        """Spoil messages of the device in this way, the given number of times (0: until the next call). With
        ``to``, only after the driver has asked this kind of question. ``precede`` sends ``stray`` before the
        message."""

    def restore(self) -> None:
        """Send the messages that were held back, and pass on all later ones."""

    def unplug(self) -> None: ...

    def plug(self) -> None: ...

    def reach(self, address: str) -> None:
        """Connect to the device at this address; empty: the device is off."""

    def wait_for_device(self) -> None:
        """Hold back what the driver sends from now on until the next ``reach``; what it asked before is
        answered first. TCP connections end with the device."""

    def close(self) -> None: ...


class Spoiler:
    """Spoils the bytes that a device sends."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._mode: Mode = "pass"
        self._left = 0
        self._to = self._stray = b""
        self.questions: list[bytes] = []
        self._held: list[tuple[Write, bytes]] = []
        self.spoiled_count = 0

    def spoil(self, mode: Mode, *, times: int = 0, to: bytes = b"", stray: bytes = b"") -> None:
        with self._lock:
            self._mode, self._left, self._to, self._stray = mode, times, to, stray
            self.spoiled_count = 0

    def receive(self, data: bytes) -> None:
        """The driver has sent these bytes."""
        kind = _DIGITS.sub(b"#", data)[:LONGEST_KIND]
        with self._lock:
            if kind == self._to:
                self._to = b""
            if kind not in self.questions and len(self.questions) < MOST_KINDS:
                self.questions.append(kind)

    def restore(self) -> None:
        with self._lock:
            held, self._held, self._mode = self._held, [], "pass"
        for write, data in held:
            with contextlib.suppress(OSError):
                write(data)

    def forget(self) -> None:
        """Discard the messages that were held back."""
        with self._lock:
            self._held = []

    def say(self, write: Write, data: bytes) -> Mode:
        """Deliver a message of the device, or the rest of it; returns how it was spoiled."""
        with self._lock:
            mode = self._mode
            if self._to:
                mode = "pass"
            if mode == "hold":
                self._held.append((write, data))
            if mode != "pass":
                self.spoiled_count += 1
                if self._left and self.spoiled_count >= self._left and mode != "hold":
                    self._mode = "pass"
        match mode:
            case "pass":
                write(data)
            case "precede":
                write(self._stray + data)
            case "garble":
                write(self.garble(data))
            case "cut":
                write(data[: len(data) // 2])
            case "lose" | "hold":
                pass
        return mode

    def garble(self, data: bytes) -> bytes:
        """Replace a message by noise; the message end, if there is one, is kept."""
        first = 1 if len(data.strip()) > 1 else 0
        return bytes(byte ^ 0x2A if n % 3 == first else byte for n, byte in enumerate(data))


class LineRelay(Spoiler):
    """Between a driver that opens a serial port and a device at a serial port."""

    def __init__(self, path: Path, address: str) -> None:
        super().__init__()
        self._front = PtyEnd(path)
        self.address = self._front.address
        self._back: SerialWire | None = None
        self._turn = threading.Condition()
        self._waits = self._awaits_answer = False
        self._over = False
        self._turned = threading.Event()
        self.reach(address)
        self._threads = [
            threading.Thread(target=pump, daemon=True)
            for pump in (self._carry_to_device, self._carry_to_driver)
        ]
        for thread in self._threads:
            thread.start()

    def unplug(self) -> None:
        self._front.unplug()
        # A thread that still waits on the line keeps it alive for that long.
        self._turned.clear()
        self._turned.wait(20 * POLL_S)
        self.forget()

    def plug(self) -> None:
        self._front.plug()

    def reach(self, address: str) -> None:
        old, self._back = self._back, None
        if old is not None:
            old.close()
        self.forget()
        if address:
            back = SerialWire(address)
            back.open()
            with self._turn:
                self._back = back
                self._waits = self._awaits_answer = False
                self._turn.notify_all()

    def wait_for_device(self) -> None:
        with self._turn:
            self._waits = True
            self._turn.wait_for(lambda: not self._awaits_answer, ANSWER_S)

    def close(self) -> None:
        self._over = True
        for thread in self._threads:
            thread.join(2)
        self.reach("")
        self._front.close()

    def _carry_to_device(self) -> None:
        while not self._over:
            data = self._front.read(POLL_S)
            self._turned.set()
            if not data:
                continue
            with self._turn:
                while self._waits and not self._over:
                    self._turn.wait(POLL_S)
                back = self._back
                self._awaits_answer = back is not None
            if back is not None:
                with contextlib.suppress(LinkError):
                    self.receive(data)
                    back.write(data, 1.0)

    def _carry_to_driver(self) -> None:
        idle = threading.Event()
        while not self._over:
            back = self._back
            try:
                data = back.read(POLL_S) if back is not None else b""
            except LinkError:
                data, back = b"", None
            if back is None:
                idle.wait(POLL_S)  # it is switched off
            elif data:
                self.say(self._front.write, data)
                with self._turn:
                    self._awaits_answer = False
                    self._turn.notify_all()


class TcpRelay(Spoiler):
    """Between a driver that connects to a TCP port and a device that listens on one, for any number of
    connections. The address has the same form as the device's. While the device has no power, or the cable is
    out, no connection is accepted."""

    def __init__(self, address: str) -> None:
        super().__init__()
        self._connections: set[socket.socket] = set()
        self._target = _host_and_port(address)
        self._is_plugged = True
        self._listener = server_at("127.0.0.1", 0)
        self._port = int(self._listener.getsockname()[1])
        host, port = self._target
        self.address = address.replace(f"{host}:{port}", f"127.0.0.1:{self._port}")
        self._listen()

    def unplug(self) -> None:
        self._is_plugged = False
        self._update_listener()
        self._hang_up()

    def plug(self) -> None:
        self._is_plugged = True
        self._update_listener()

    def reach(self, address: str) -> None:
        self._target = _host_and_port(address) if address else NOWHERE
        self._update_listener()
        self._hang_up()

    def wait_for_device(self) -> None:
        """Its connections end too."""

    def close(self) -> None:
        self.unplug()

    def pass_answers(self, far: socket.socket, near: socket.socket, asked: threading.Thread) -> None:
        """Pass on messages of the device until it disconnects. ``asked`` ends when the driver disconnects."""
        _pump(far, near, lambda data: self.say(near.sendall, data))
        asked.join(2)

    def _make_asker(self, far: socket.socket) -> Write:
        def ask(data: bytes) -> None:
            self.receive(data)
            far.sendall(data)

        return ask

    def _update_listener(self) -> None:
        wanted, is_open = self._is_plugged and self._target != NOWHERE, self._listener.fileno() >= 0
        if wanted and not is_open:
            self._listener = server_at("127.0.0.1", self._port)
            self._listen()
        elif is_open and not wanted:
            with contextlib.suppress(OSError):
                self._listener.shutdown(socket.SHUT_RDWR)
            self._listener.close()

    def _hang_up(self) -> None:
        self.forget()
        for connection in list(self._connections):
            with contextlib.suppress(OSError):
                connection.shutdown(socket.SHUT_RDWR)

    def _listen(self) -> None:
        threading.Thread(target=self._accept, args=(self._listener,), daemon=True).start()

    def _accept(self, listener: socket.socket) -> None:
        with contextlib.suppress(OSError):
            while True:
                near, _ = listener.accept()
                threading.Thread(target=self._serve, args=(near, listener), daemon=True).start()

    def _serve(self, near: socket.socket, listener: socket.socket) -> None:
        target = self._target
        with contextlib.suppress(OSError), near, socket.create_connection(target, 2.0) as far:
            far.settimeout(None)
            both = {near, far}
            for end in both:
                end.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            self._connections |= both
            try:
                if listener.fileno() < 0 or self._target != target:
                    return  # unplugged before this connection was noticed
                up = threading.Thread(target=_pump, args=(near, far, self._make_asker(far)), daemon=True)
                up.start()
                self.pass_answers(far, near, up)
            finally:
                self._connections -= both


def _pump(source: socket.socket, target: socket.socket, write: Write) -> None:
    with contextlib.suppress(OSError):
        while data := source.recv(65536):
            write(data)
    with contextlib.suppress(OSError):
        target.shutdown(socket.SHUT_WR)


def _host_and_port(address: str) -> tuple[str, int]:
    """The host and port in ``socket://host:port``, ``http://host:port/…``, ``tcp://host:port`` or
    ``host:port``."""
    parts = urlsplit(address if "://" in address else f"tcp://{address}")
    if parts.hostname is None or parts.port is None:
        raise ValueError(f"{address!r} names no host and port")
    return parts.hostname, parts.port


class Relays:
    """For a device with several lines, whose addresses are in one text, separated by commas. All lines are
    cut together, and each is spoiled separately."""

    def __init__(self, lines: Sequence[Relay]) -> None:
        self._lines = lines
        self.address = ",".join(line.address for line in lines)

    @property
    def questions(self) -> list[bytes]:
        return [kind for line in self._lines for kind in line.questions]

    @property
    def spoiled_count(self) -> int:
        return sum(line.spoiled_count for line in self._lines)

    def spoil(self, mode: Mode, *, times: int = 0, to: bytes = b"", stray: bytes = b"") -> None:
        for line in self._lines:
            line.spoil(mode, times=times, to=to, stray=stray)

    def restore(self) -> None:
        for line in self._lines:
            line.restore()

    def unplug(self) -> None:
        for line in self._lines:
            line.unplug()

    def plug(self) -> None:
        for line in self._lines:
            line.plug()

    def reach(self, address: str) -> None:
        parts = address.split(",") if address else [""] * len(self._lines)
        for line, part in zip(self._lines, parts, strict=True):
            line.reach(part)

    def wait_for_device(self) -> None:
        for line in self._lines:
            line.wait_for_device()

    def close(self) -> None:
        for line in self._lines:
            line.close()

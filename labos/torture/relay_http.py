"""A line in the middle of HTTP: what is lost, held back, garbled or cut short is a whole answer.

The connection of an answer that is lost or late stays silent until the driver gives it up: whoever saw it
end would know that no answer will come. That of one that is cut short ends there.
"""

from __future__ import annotations

import os
import re
import socket
import threading
from collections.abc import Iterator
from pathlib import Path
from urllib.parse import urlsplit

from labos.torture.relay import LineRelay, Relay, Relays, TcpRelay

HEAD_END = b"\r\n\r\n"
BODILESS = (b"204", b"304")


class HttpRelay(TcpRelay):
    """Between a driver and a device that answers HTTP. An answer tells its length, or ends with its
    connection."""

    def pass_answers(self, far: socket.socket, near: socket.socket, asked: threading.Thread) -> None:
        silent = False
        for answer in split_answers(far):
            done = self.say(near.sendall, answer)
            silent = silent or done in ("lose", "hold")
            if done == "cut":
                break
        if not silent:
            near.shutdown(socket.SHUT_WR)
        asked.join(None if silent else 2)

    def garble(self, data: bytes) -> bytes:
        """Noise that is HTTP, as from a proxy that answers for the device, and noise that is none."""
        noise = super().garble
        head, end, body = data.partition(HEAD_END)
        if self.spoiled_count % 2:
            return head + end + noise(body)
        # Its lines still end, so that it is not waited for.
        return b"\r\n".join(noise(line) for line in head.split(b"\r\n")) + end + noise(body)


def split_answers(line: socket.socket) -> Iterator[bytes]:
    """One after the other, each with its head; the last one may be broken off."""
    heard = b""
    while True:
        while HEAD_END not in heard:
            if not (piece := line.recv(65536)):
                if heard:
                    yield heard
                return
            heard += piece
        size = _read_size(heard)
        while size is None or len(heard) < size:
            if not (piece := line.recv(65536)):
                yield heard
                return
            heard += piece
        yield heard[:size]
        heard = heard[size:]


def _read_size(heard: bytes) -> int | None:
    """How many bytes an answer has in all; None if only its end tells."""
    head = heard.partition(HEAD_END)[0]
    bare = len(head) + len(HEAD_END)
    if head.split(b" ", 2)[1:2] in ([status] for status in BODILESS):
        return bare
    length = re.search(rb"(?im)^content-length: *(\d+)", head)
    return bare + int(length[1]) if length else None


def open_relay(address: str, folder: Path, name: str = "wire") -> Relay:
    """The relay for a device's address, or for several with commas between them."""
    parts = address.split(",")
    if len(parts) > 1:
        return Relays([open_relay(part, folder, f"{name}{n}") for n, part in enumerate(parts)])
    if os.path.isabs(address):
        return LineRelay(folder / name, address)
    return HttpRelay(address) if urlsplit(address).scheme == "http" else TcpRelay(address)

"""A relay for HTTP: it loses, holds back, garbles or cuts short whole answers. The connection of a lost or
late answer stays open and silent until the driver stops waiting; if it ended, the driver would know that no
answer comes. The connection of an answer that is cut short ends there.
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
    """Between a driver and a device that answers HTTP. An answer contains its length, or ends with its
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
        """Noise in the form of HTTP, as from a proxy that answers for the device, and noise in no form."""
        noise = super().garble
        head, end, body = data.partition(HEAD_END)
        if self.spoiled_count % 2:
            return head + end + noise(body)
        # Its lines still end, so that no reader waits for it.
        return b"\r\n".join(noise(line) for line in head.split(b"\r\n")) + end + noise(body)


def split_answers(line: socket.socket) -> Iterator[bytes]:
    """The answers one after the other, each with its head; the last one may be incomplete."""
    received = b""
    while True:
        while HEAD_END not in received:
            if not (piece := line.recv(65536)):
                if received:
                    yield received
                return
            received += piece
        size = _read_size(received)
        while size is None or len(received) < size:
            if not (piece := line.recv(65536)):
                yield received
                return
            received += piece
        yield received[:size]
        received = received[size:]


def _read_size(received: bytes) -> int | None:
    """The total number of bytes of an answer; None if only the end of the connection shows it."""
    head = received.partition(HEAD_END)[0]
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

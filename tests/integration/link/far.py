"""Devices at the far end of a wire, as small as a test needs them."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from labos.link import FarEnd

Hear = Callable[[bytes], None]


class Answering:
    """Hears whole lines and answers each with what ``script`` says for it: a bytes object, or
    a function that is called. ``received`` is what came, ``said`` is set after each answer."""

    def __init__(self, end: FarEnd, script: dict[bytes, bytes | Callable[[], None]], stop: bytes) -> None:
        self.end, self.script, self.stop = end, script, stop
        self.received: list[bytes] = []
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._work, daemon=True)
        self._thread.start()

    def _work(self) -> None:
        buffer = b""
        while not self._over.is_set():
            buffer += self.end.read(0.02)
            while self.stop in buffer:
                line, _, buffer = buffer.partition(self.stop)
                self.received.append(line)
                answer = self.script.get(line, b"")
                if callable(answer):
                    answer()
                elif answer:
                    self.end.write(answer)

    def close(self) -> None:
        self._over.set()
        self._thread.join(5)
        self.end.close()


@contextmanager
def answer_on(
    end: FarEnd, script: dict[bytes, bytes | Callable[[], None]], stop: bytes = b"\r\n"
) -> Iterator[Answering]:
    device = Answering(end, script, stop)
    try:
        yield device
    finally:
        device.close()

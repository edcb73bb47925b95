"""A simulated network camera: it shows its nest, and the places that it observes, as they are when it is
asked."""

from __future__ import annotations

import queue
import time

from labos.node import Setup
from labos_drivers._onhttp import HttpEnd, OnHttp, Reply, Request
from labos_drivers.camera.render import picture_of
from labos_drivers.camera.vision import Picture, cv, encode

PATH = "snapshot.jpg"
EXPOSES_S = 1.5


class CameraOnWire(OnHttp):
    """What the device is and does. Somebody may switch the light off (``is_dark``), its sensor may hang
    (``is_frozen``), it may take a picture and never send it (``is_silent``)."""

    def __init__(self, setup: Setup, end: HttpEnd | None = None) -> None:
        super().__init__(setup, end)
        self.is_dark = self.is_frozen = self.is_silent = False
        self._places = [self.place(place) for place in ("plate_station", *setup.config.get("observes", ()))]
        self._last: Picture | None = None

    @property
    def address(self) -> str:
        return f"{self.end.address}/{PATH}"

    def listen(self, timeout_s: float) -> None:
        """A picture takes its time, and is sent when it is done."""
        try:
            request = self.end.requests.get(timeout=timeout_s)
        except queue.Empty:
            return
        if request.parts != (PATH,):
            request.replies.put(Reply(404, b""))
        elif request.method == "HEAD":
            request.replies.put(Reply(200, b"", {"Content-Type": "image/jpeg"}))
        elif request.method == "GET":
            self._send(request)
        else:
            request.replies.put(Reply(405, b""))

    def _send(self, request: Request) -> None:
        shot = Reply(200, encode(self._expose(), PATH), {"Content-Type": "image/jpeg"})
        if not self.is_silent:
            self.after(EXPOSES_S, lambda: request.replies.put(shot))

    def _expose(self) -> Picture:
        """What is there now."""
        nest = self._places[0]
        self.world.work(self.name, "picture", nest if self.top(nest) else "")
        if self.is_frozen and self._last is not None:
            return self._last
        # Noise is never the same twice, not even after the power was off.
        seen = picture_of(self.world, self._places, time.monotonic_ns())
        self._last = cv().convertScaleAbs(seen, alpha=0.01) if self.is_dark else seen
        return self._last

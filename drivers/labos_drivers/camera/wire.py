"""A simulated network camera. Its pictures show its nest and the places that it observes at the time of the
request."""

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
    """The simulated device. The light may be off (``is_dark``), and the sensor may hang (``is_frozen``). With
    ``is_silent``, it takes a picture and does not send it."""

    def __init__(self, setup: Setup, end: HttpEnd | None = None) -> None:
        super().__init__(setup, end)
        self.is_dark = self.is_frozen = self.is_silent = False
        self._places = [self.place(place) for place in ("plate_station", *setup.config.get("observes", ()))]
        self._last: Picture | None = None

    @property
    def address(self) -> str:
        return f"{self.end.address}/{PATH}"

    def listen(self, timeout_s: float) -> None:
        """Answer a request, if one comes in this time. A picture is sent after its exposure."""
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
        """A picture of the present bench; if the sensor hangs, the last picture again."""
        nest = self._places[0]
        self.world.work(self.name, "picture", nest if self.top(nest) else "")
        if self.is_frozen and self._last is not None:
            return self._last
        # The time is the seed, so that the noise is never repeated, also after the power was off.
        seen = picture_of(self.world, self._places, time.monotonic_ns())
        self._last = cv().convertScaleAbs(seen, alpha=0.01) if self.is_dark else seen
        return self._last

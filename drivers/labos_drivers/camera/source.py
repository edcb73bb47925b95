"""The sources of pictures: a video device, a network camera, a file or a folder.

The first frames of a video device may be from before the request, so some are discarded for each picture.
Their numbers are those of AD-SDL/camera_module, src/camera_interface.py.
"""

from __future__ import annotations

import base64
import threading
from collections.abc import Callable, Mapping
from concurrent.futures import Future
from pathlib import Path
from typing import Any, Protocol, TypeVar
from urllib.parse import urlsplit

from labos.errors import DeviceError, Garbled, LinkLost, NoReply, NotConnected
from labos.link import HttpLink, HttpReply
from labos.link.life import Life
from labos.node import assume_motion
from labos.node.secrets import read_secret
from labos_drivers._refusals import make_refusal
from labos_drivers.camera.vision import Picture, cv, decode

T = TypeVar("T")
Limit = Callable[[str, float], float]

OPEN_S, FRAME_S, ANSWER_S = 10.0, 10.0, 10.0
SETTLES, REFOCUSES = 5, 30
"""Frames thrown away before a picture, and after the focus was set."""

PICTURES = (".jpg", ".jpeg", ".png", ".bmp", ".tif", ".tiff")
WHO = "a camera that gives pictures"


class Source(Protocol):
    """A source of pictures; ``link`` is the connection to it."""

    link: Life

    def take(self, focus: int | None = None, *, glance: bool = False) -> list[Picture]:
        """Take a picture; it is the last item of the result, after an earlier picture if there is one. Two
        pictures that are equal bit by bit come from a frozen camera. ``focus`` is 0 to 255, None leaves it
        to the camera. A ``glance`` may have a lower quality. Raises DeviceError."""


def make_source(name: str, address: str, config: Mapping[str, Any], limit_s: Limit) -> Source:
    """The source for an address. ``limit_s`` gives the timeout (s) for the name of a deadline."""
    if address.startswith(("http://", "https://")):
        return NetworkCamera(name, address, config, limit_s)
    path = Path(address)
    if not address.isdecimal() and (path.is_dir() or path.suffix.lower() in PICTURES):
        return StoredPictures(name, path)
    return VideoDevice(name, address, limit_s)


class VideoDevice(Life):
    """A camera of this computer by its number (``0``) or path (``/dev/v4l/by-id/…``), or another video that
    OpenCV can open: a stream, a recording. It is opened for each picture. So no old frame waits in a
    buffer, and other programs can use the camera in between."""

    def __init__(self, name: str, address: str, limit_s: Limit) -> None:
        super().__init__(name)
        self._limit_s = limit_s
        self.link: Life = self
        self._where: int | str = int(address) if address.isdecimal() else address

    def take(self, focus: int | None = None, *, glance: bool = False) -> list[Picture]:
        if not self.is_open:
            self.open()
        with self._judge():
            return self._run_within(self._limit_s("frame", FRAME_S), lambda: self._read_frames(focus))

    def _connect(self) -> None:
        try:
            self._run_within(self._limit_s("open", OPEN_S), lambda: self._open_device().release())
        except LinkLost as error:
            raise NotConnected(error.message, remedy=error.remedy) from error

    def _disconnect(self) -> None:
        """Do nothing: the device is open only while a picture is taken."""

    def _open_device(self) -> Any:
        capture = cv().VideoCapture(self._where)
        if not capture.isOpened():
            raise NotConnected(
                f"{self.name}: the camera {self._where} cannot be opened.",
                remedy="Check its cable, its name or number, and that no other program uses it.",
            )
        return capture

    def _read_frames(self, focus: int | None) -> list[Picture]:
        capture = self._open_device()
        try:
            count = self._set_focus(capture, focus)
            frames: list[Picture] = []
            for _ in range(count + 1):
                there, frame = capture.read()
                if not there or frame is None:
                    raise LinkLost(
                        f"{self.name}: the camera {self._where} gives no picture.",
                        effects="none",
                        remedy="Plug it in again, then reset the module.",
                    )
                frames = [*frames[-1:], frame]
            return frames
        finally:
            capture.release()

    def _set_focus(self, capture: Any, focus: int | None) -> int:
        """Set the focus; returns the number of frames to discard. Raises DeviceError if it cannot be set."""
        if focus is None:
            capture.set(cv().CAP_PROP_AUTOFOCUS, 1)  # false without an autofocus
            return SETTLES
        capture.set(cv().CAP_PROP_AUTOFOCUS, 0)
        if not capture.set(cv().CAP_PROP_FOCUS, focus):
            raise make_focus_error(self.name)
        return REFOCUSES

    def _run_within(self, limit_s: float, work: Callable[[], T]) -> T:
        """Run ``work`` in a thread, because OpenCV may wait without end for a camera that hangs. After
        ``limit_s``, this raises LinkLost, and the thread stays blocked."""
        ends: Future[T] = Future()

        def run() -> None:
            try:
                ends.set_result(work())
            except Exception as error:
                ends.set_exception(error)

        threading.Thread(target=run, name=f"{self.name} picture", daemon=True).start()
        try:
            return ends.result(limit_s)
        except TimeoutError:
            raise LinkLost(
                f"{self.name}: the camera {self._where} has sent no picture within {limit_s:g} s.",
                effects="none",
                remedy="Unplug it and plug it in again, then restart the node of this module.",
            ) from None


class NetworkCamera:
    """A camera that gives a new picture at a URL, exposed at the time of the request. For each picture, a
    first one is taken before it, so that exposure and white balance have settled. A glance takes only one
    if there is a last picture for comparison."""

    def __init__(self, name: str, url: str, config: Mapping[str, Any], limit_s: Limit) -> None:
        self._limit_s = limit_s
        parts = urlsplit(url)
        self._path = f"{parts.path or '/'}{f'?{parts.query}' if parts.query else ''}"
        self._name = name
        self._last: Picture | None = None
        self.link: Life
        self.link = self._http = HttpLink(
            f"{parts.scheme}://{parts.netloc}",
            name=name,
            headers=_make_authorization(name, config),
            identify=lambda _: self._recognise(),
            expected=WHO,
        )

    def take(self, focus: int | None = None, *, glance: bool = False) -> list[Picture]:
        if focus is not None:
            raise make_focus_error(self._name)
        if glance and self._last is not None:
            before, self._last = self._last, self._take_shot()
            return [before, self._last]
        first = self._take_shot()
        with assume_motion():
            self._last = self._take_shot()
        return [first, self._last]

    def _take_shot(self) -> Picture:
        reply = self._http.get(self._path, timeout_s=self._limit_s("frame", FRAME_S))
        if not reply.ok:
            raise NoReply(
                f"{self._name}: the camera answers {reply.status} instead of a picture.",
                remedy="Check the camera, then reset the module.",
            )
        picture = decode(reply.body)
        if picture is None:
            raise Garbled(
                f"{self._name}: the answer ({len(reply.body)} bytes) is not a complete picture.",
                remedy="Check the address, the network, and the camera.",
            )
        return picture

    def _recognise(self) -> str:
        """``WHO`` if the address is a camera, else its answer. Asks only for headers (HEAD), because GET
        would take a picture without need. Raises NotConnected if user or password are wrong."""
        reply = self._http.exchange("HEAD", self._path, timeout_s=self._limit_s("answer", ANSWER_S))
        if reply.status in (401, 403):
            raise NotConnected(
                f"{self._name}: the camera does not know this user and password.",
                remedy="Check `user:` and `password_env:` (or `password_file:`) of the module.",
            )
        kind = _read_kind(reply)
        if reply.status in (405, 501) or (reply.ok and kind in ("", "image")):
            return WHO  # some cameras do not support HEAD
        return f"what answers {reply.status} {kind}".rstrip()


class StoredPictures(Life):
    """A picture in a file, or the pictures of a folder in the order of their names, again and again."""

    def __init__(self, name: str, path: Path) -> None:
        super().__init__(name)
        self.link: Life = self
        self._path, self._next = path, 0

    def take(self, focus: int | None = None, *, glance: bool = False) -> list[Picture]:
        if focus is not None:
            raise make_focus_error(self.name)
        if not self.is_open:
            self.open()
        with self._judge():
            files = self._list_files()
            if not files:
                raise LinkLost(
                    f"{self.name}: there is no picture at {self._path}.",
                    effects="none",
                    remedy="Put one there, then reset the module.",
                )
            file = files[self._next % len(files)]
            self._next += 1
            picture = decode(file.read_bytes())
            if picture is None:
                raise Garbled(f"{self.name}: {file} is not a complete picture.", effects="none")
            return [picture]

    def _connect(self) -> None:
        if not self._list_files():
            raise NotConnected(
                f"{self.name}: there is no picture at {self._path}.", remedy="Check `source:` of the module."
            )

    def _disconnect(self) -> None:
        """Do nothing: no file stays open."""

    def _list_files(self) -> list[Path]:
        found = sorted(self._path.iterdir()) if self._path.is_dir() else [self._path]
        return [file for file in found if file.suffix.lower() in PICTURES and file.is_file()]


def make_focus_error(name: str) -> DeviceError:
    """The error for a source whose focus cannot be set."""
    return make_refusal(
        name, "the focus of this camera cannot be set", "Leave `focus` out, and focus by hand."
    )


def _read_kind(reply: HttpReply) -> str:
    return reply.headers.get("content-type", "").partition("/")[0].strip().lower()


def _make_authorization(name: str, config: Mapping[str, Any]) -> dict[str, str]:
    """The header with user and password; empty without ``user``. Raises DeviceError without a password."""
    user = config.get("user")
    if not user:
        return {}
    password = read_secret(config, "password")
    if not password:
        raise make_refusal(
            name,
            f"`config:` has the user {user!r}, but no password",
            "Write `password_env` (a variable of this node) or `password_file`.",
        )
    digest = base64.b64encode(f"{user}:{password}".encode()).decode()
    return {"Authorization": f"Basic {digest}"}

"""The stream of states that a UR controller sends in real time, while the driver needs it."""

from __future__ import annotations

import struct
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress

from labos.errors import Garbled, LinkError, NoReply
from labos.link import Link, TcpWire
from labos_drivers.ur import rtde
from labos_drivers.ur.rtde import Robot

ANSWER_S, LOOK_S = 5.0, 0.01
FREQUENCY_HZ = 25.0
WHO = "a UR controller that tells its state"


class Stream:
    """The stream of states. It runs during ``watch`` and ``read_state`` and is otherwise paused, so that no
    unread data accumulate. During ``watch``, ``read_state`` returns the last state."""

    def __init__(self, host: str, port: int, name: str) -> None:
        self._name = name
        self._recipe = 0
        self._turn = threading.Lock()
        self._is_watched = False
        self._last: Robot | None = None
        self.link = Link(
            TcpWire(host, port),
            rtde.Packages(),
            name=f"{name} real-time data",
            answers=lambda question, message: message[:1] == question[:1],
            unasked=lambda message: message[:1] in (rtde.DATA, rtde.TEXT),
            identify=self._set_up,
            expected=WHO,
        )

    def close(self) -> None:
        """Close the connection; the next request connects again."""
        self.link.close()

    @contextmanager
    def watch(self) -> Iterator[Iterator[Robot]]:
        """Start the stream, and yield an endless iterator of its states. Nothing moves. Raises LinkError."""
        with self._turn:
            self._last = None
            self._order(rtde.START)
            self._is_watched = True
        try:
            yield self._receive_states()
        finally:
            with self._turn:
                self._is_watched = False
                with suppress(LinkError):
                    self._order(rtde.PAUSE)

    def read_state(self) -> Robot:
        """The present state. Raises LinkError."""
        deadline = time.monotonic() + ANSWER_S
        while time.monotonic() < deadline:
            with self._turn:
                if not self._is_watched:
                    self._order(rtde.START)
                    robot = next(self._receive_states())
                    self._order(rtde.PAUSE)
                    return robot
                if self._last is not None:
                    return self._last
            time.sleep(LOOK_S)
        raise NoReply(f"{self._name}: the controller does not tell its state within {ANSWER_S:g} s.")

    # -- inside ------------------------------------------------------------------------------

    def _receive_states(self) -> Iterator[Robot]:
        while True:
            message = self.link.receive(ANSWER_S)
            if message[:1] == rtde.DATA:
                try:
                    self._last = rtde.unpack_robot(self._recipe, message[1:])
                except (ValueError, struct.error) as error:
                    raise Garbled(f"{self._name}: no state of a robot: {error}.") from error
                yield self._last

    def _order(self, kind: bytes) -> None:
        if self.link.exchange(kind, ANSWER_S) != kind + b"\x01":
            raise Garbled(f"{self._name}: the controller refuses {kind!r} on its real-time port.")

    def _set_up(self, link: Link) -> str:
        version = rtde.ASK_VERSION + struct.pack(">H", rtde.VERSION)
        if link.exchange(version, ANSWER_S) != rtde.ASK_VERSION + b"\x01":
            return "a controller that does not speak version 2 of RTDE"
        answer = link.exchange(rtde.request_outputs(rtde.RECIPE, FREQUENCY_HZ), ANSWER_S)[1:]
        types = answer[1:].decode("ascii", "replace").split(",")
        missing = [name for name, kind in zip(rtde.RECIPE, types, strict=False) if kind == rtde.NOT_FOUND]
        if missing:
            return f"a controller without {', '.join(missing)}"
        if tuple(types) != rtde.TYPES:
            return f"a controller that tells {answer[:80]!r}"
        self._recipe = answer[0]
        return WHO

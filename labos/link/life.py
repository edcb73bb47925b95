"""The common part of all links: open, check which device answers, notice a lost connection, and connect
again."""

from __future__ import annotations

import contextlib
import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from typing import Any

from labos.errors import LinkError, LinkLost, NotConnected, WrongDevice
from labos.link.transcript import note

FIRST_PAUSE_S, LONGEST_PAUSE_S = 0.1, 5.0


class Life(ABC):
    """A connection that is opened when it is needed, with pauses between attempts. ``identify`` asks the
    device on the link for its identity each time it is opened. An answer other than ``expected`` (empty:
    other than the first time) raises WrongDevice.
    """

    def __init__(self, name: str, identify: Callable[[Any], str] | None = None, expected: str = "") -> None:
        self.name = name
        self._identity, self._expected = identify, expected
        self._lock = threading.RLock()
        self._is_open = False
        self._pause_s = FIRST_PAUSE_S
        self._not_before = 0.0
        self._why = ""

    @property
    def is_open(self) -> bool:
        return self._is_open

    def open(self, patience_s: float = 0.0) -> None:
        """Connect; try again for ``patience_s`` with increasing pauses. Raises NotConnected, WrongDevice."""
        deadline = time.monotonic() + patience_s
        while True:
            try:
                with self._lock:
                    if not self._is_open:
                        self._open_once()
                return
            except WrongDevice:
                raise
            except NotConnected:
                if self._not_before >= deadline:
                    raise
            time.sleep(max(self._not_before - time.monotonic(), 0.0))

    def close(self) -> None:
        """Disconnect from the device; the next exchange connects again."""
        with self._lock:
            if self._is_open:
                note(self.name, "close")
            self._is_open = False
            self._disconnect()

    @abstractmethod
    def _connect(self) -> None:
        """Raises NotConnected."""

    @abstractmethod
    def _disconnect(self) -> None:
        """Raises nothing. It may be called more than once."""

    def _open_once(self) -> None:
        wait = self._not_before - time.monotonic()
        if wait > 0:
            raise NotConnected(
                f"{self._why} The next try is in {wait:.1f} s.", remedy="Check its power and its cable."
            )
        try:
            self._connect()
            self._is_open = True
            note(self.name, "open")
            self._check_identity()
        except NotConnected as error:
            self._why = error.message
            self._not_before = time.monotonic() + self._pause_s
            self._pause_s = min(self._pause_s * 2, LONGEST_PAUSE_S)
            self._note_error(error)
            self.close()
            raise
        self._pause_s, self._not_before = FIRST_PAUSE_S, 0.0

    def _check_identity(self) -> None:
        if self._identity is None:
            return
        try:
            found = self._identity(self)
        except NotConnected:
            raise
        except LinkError as error:
            raise NotConnected(
                f"{self.name} does not identify itself: {error.message}",
                remedy="Check which device is on this wire, and its speed.",
            ) from error
        self._expected = self._expected or found
        if found != self._expected:
            raise WrongDevice(
                f"{self.name}: {self._expected} was expected, but {found} answers.",
                remedy="Two cables may have been swapped. Put them back, then reset the module.",
            )

    @contextlib.contextmanager
    def _in_turn(self) -> Iterator[None]:
        """One exchange at a time, on a link that is opened before if need be."""
        with self._lock:
            if not self._is_open:
                self.open()
            with self._judge():
                yield

    @contextlib.contextmanager
    def _judge(self) -> Iterator[None]:
        """Record errors in the transcript, and close a lost connection."""
        try:
            yield
        except LinkError as error:
            self._note_error(error)
            if isinstance(error, LinkLost):
                self.close()
            raise

    def _note_error(self, error: LinkError) -> None:
        note(self.name, "!", f"{type(error).__name__}: {error.message}".encode("ascii", "replace"))

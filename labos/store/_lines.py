"""The open connections to a server, so that they can be cut while somebody waits on one."""

from __future__ import annotations

import contextlib
import socket
from threading import Lock
from typing import Any
from weakref import WeakSet

import psycopg


class Lines:
    """Connections of psycopg. libpq waits for an answer without any limit of its own, and a frozen
    server's system goes on acknowledging what is sent: nothing but the end of the line wakes who waits."""

    def __init__(self) -> None:
        self._open: WeakSet[psycopg.Connection[Any]] = WeakSet()
        self._lock = Lock()

    def add(self, connection: psycopg.Connection[Any], _record: object = None) -> None:
        """As a listener to SQLAlchemy's ``connect``."""
        with self._lock:
            self._open.add(connection)

    def cut(self) -> None:
        """End all of them from this side: callers that wait get psycopg's OperationalError."""
        with self._lock:
            lines = list(self._open)
        for line in lines:
            _shut(line)


def _shut(line: psycopg.Connection[Any]) -> None:
    # By a handle of its own: the thread that waits may close the line at this moment, and its number
    # may be another file's then. One that is still open afterwards was the line's.
    with (
        contextlib.suppress(psycopg.Error, OSError),
        socket.fromfd(line.pgconn.socket, socket.AF_INET, socket.SOCK_STREAM) as handle,
    ):
        if not line.closed:
            handle.shutdown(socket.SHUT_RDWR)

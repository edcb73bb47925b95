"""The open connections to a server. They can be closed while a thread waits for an answer."""

from __future__ import annotations

import contextlib
import socket
from threading import Lock
from typing import Any
from weakref import WeakSet

import psycopg


class Lines:
    """Connections of psycopg. libpq waits for an answer without a time limit, and the system of a frozen
    server continues to acknowledge what is sent. Only closing the connection wakes the waiting thread."""

    def __init__(self) -> None:
        self._open: WeakSet[psycopg.Connection[Any]] = WeakSet()
        self._lock = Lock()

    def add(self, connection: psycopg.Connection[Any], _record: object = None) -> None:
        """As a listener to SQLAlchemy's ``connect``."""
        with self._lock:
            self._open.add(connection)

    def cut(self) -> None:
        """Close all connections from this side: waiting callers get psycopg's OperationalError."""
        with self._lock:
            lines = list(self._open)
        for line in lines:
            _shut(line)


def _shut(line: psycopg.Connection[Any]) -> None:
    # The connection is closed by a handle of its own: the waiting thread may close it at this moment, and its
    # number may then belong to another file. If the handle is still open afterwards, it belonged to the
    # connection.
    with (
        contextlib.suppress(psycopg.Error, OSError),
        socket.fromfd(line.pgconn.socket, socket.AF_INET, socket.SOCK_STREAM) as handle,
    ):
        if not line.closed:
            handle.shutdown(socket.SHUT_RDWR)

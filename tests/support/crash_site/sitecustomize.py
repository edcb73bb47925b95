"""Kills or freezes a LabOS process at one labelled point of the protocol, once.

Python loads this at start when its folder is on PYTHONPATH. ``LABOS_CRASH_AT`` is
``point:visit``; ``LABOS_CRASH_MARK`` is a file whose creation claims the one crash, so that the
process lives when it is started again, and which holds its process id; ``LABOS_CRASH_BY`` names
the signal, SIGKILL if it does not. Nothing is replaced: what runs is the real thing, with a
signal before or after it.
"""

from __future__ import annotations

import os
import signal
import sys
import threading
from collections import Counter
from typing import Any

POINT, _, VISIT = os.environ.get("LABOS_CRASH_AT", "").partition(":")
ROLE, _, _ = POINT.partition(".")
_visits: Counter[str] = Counter()


def due(point: str) -> bool:
    """Whether this is the point and the visit that was asked for."""
    if point != POINT:
        return False
    _visits[point] += 1
    return _visits[point] >= int(VISIT) and not os.path.exists(os.environ["LABOS_CRASH_MARK"])


def die() -> None:
    mark = os.open(os.environ["LABOS_CRASH_MARK"], os.O_CREAT | os.O_EXCL | os.O_WRONLY)
    os.write(mark, str(os.getpid()).encode())
    os.close(mark)
    # To this very thread: the main one would stop the others a moment later, when they are somewhere else.
    signal.pthread_kill(threading.get_ident(), getattr(signal, os.environ.get("LABOS_CRASH_BY", "SIGKILL")))


def reached(point: str) -> None:
    if due(point):
        die()


def _in_kernel() -> None:
    from labos.node.protocol import Start
    from labos.runtime.dispatcher import Dispatcher
    from labos.store import SqlEventStore

    append, ask = SqlEventStore.append, Dispatcher._ask_node

    def crashing_append(self: Any, expected: Any, records: Any) -> Any:
        reached("kernel.before_commit")
        head = append(self, expected, records)
        reached("kernel.after_commit")
        return head

    async def crashing_ask(self: Any, module: Any, message: Any) -> Any:
        starting = isinstance(message, Start)
        if starting:
            reached("kernel.before_send")
        reply = await ask(self, module, message)
        if starting:
            reached("kernel.after_send")
        return reply

    if POINT in ("kernel.in_commit", "kernel.in_pipeline", "kernel.in_copy"):
        _in_transaction()
    SqlEventStore.append = crashing_append  # type: ignore[method-assign]
    Dispatcher._ask_node = crashing_ask  # type: ignore[method-assign]


def _in_transaction() -> None:
    """Between the head's move and the rows, or while the server waits for more rows (of a pipeline, of a
    COPY), on PostgreSQL: the head row is locked."""
    from labos.store import _postgres

    insert = _postgres._insert

    def crashing_insert(cursor: Any, rows: Any) -> None:
        reached("kernel.in_commit")
        if POINT == "kernel.in_pipeline":
            with cursor.connection.pipeline():
                cursor.executemany(_postgres._INSERT, rows)
                cursor.connection.pgconn.flush()
                reached("kernel.in_pipeline")
            return
        if POINT == "kernel.in_copy":
            with cursor.copy(_postgres._COPY) as copy:
                copy.set_types(_postgres._TYPES)
                reached("kernel.in_copy")
                for row in rows:
                    copy.write_row(row)
            return
        insert(cursor, rows)

    _postgres._insert = crashing_insert


def _in_node() -> None:
    from labos.node.journal_file import FileJournalFile
    from labos.node.server import NodeServer
    from labos.node.world import World

    append, publish, grip = FileJournalFile._append, NodeServer._publish, World.grip

    def crashing_append(self: Any, data: bytes) -> None:
        kind = "accept" if b'"accepted"' in data else "result" if b'"ended"' in data else "other"
        reached(f"node.before_{kind}_journal")
        if due(f"node.torn_{kind}_journal"):
            os.write(self._fd, data[: len(data) // 2])
            die()
        append(self, data)
        reached(f"node.after_{kind}_journal")

    async def crashing_publish(self: Any, key: str, message: Any) -> None:
        result = "/result/" in key
        if result:
            reached("node.before_publish")
        await publish(self, key, message)
        if result:
            reached("node.after_publish")

    def crashing_grip(self: Any, device: str, place: str, how: str = "") -> str:
        reached("node.before_grip")
        plate = grip(self, device, place, how)
        reached("node.in_motion")
        return plate

    FileJournalFile._append = crashing_append  # type: ignore[method-assign]
    NodeServer._publish = crashing_publish  # type: ignore[method-assign]
    World.grip = crashing_grip  # type: ignore[method-assign]


if POINT and ROLE == "kernel" and "up" in sys.argv:
    _in_kernel()
elif POINT and ROLE == "node" and "node" in sys.argv and "pf400" in sys.argv:
    _in_node()

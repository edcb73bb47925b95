"""Kills or freezes LabOS processes at labelled points of the protocol, each once.

Python loads this at start when its folder is on PYTHONPATH. ``LABOS_CRASH_AT`` is
``point:visit``, or several of them separated by commas, of which each counts its visits from the crash
before it on: what happens in the course of a recovery only. ``LABOS_CRASH_MARK`` is a file whose
creation claims the first crash, so that the process lives when it is started again, and which holds its
process id; those of the crashes after it end in ``.2``, ``.3`` …. ``LABOS_CRASH_BY`` names
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

CRASHES = [text.partition(":") for text in os.environ.get("LABOS_CRASH_AT", "").split(",") if text]
POINTS = [point for point, _, _ in CRASHES]
ROLES = {point.partition(".")[0] for point in POINTS}
_visits: Counter[int] = Counter()


def mark(number: int) -> str:
    """The file that claims a crash, counted from 0."""
    return os.environ["LABOS_CRASH_MARK"] + (f".{number + 1}" if number else "")


def due(point: str) -> bool:
    """Whether this is the next point, and the visit that was asked for."""
    if point not in POINTS or (point.startswith("node.") and "pf400" not in sys.argv):
        return False
    number = next((n for n in range(len(POINTS)) if not os.path.exists(mark(n))), None)
    if number is None or POINTS[number] != point:
        return False
    _visits[number] += 1
    return _visits[number] >= int(CRASHES[number][2])


def die() -> None:
    number = next(n for n in range(len(POINTS)) if not os.path.exists(mark(n)))
    file = os.open(mark(number), os.O_CREAT | os.O_EXCL | os.O_WRONLY)
    os.write(file, str(os.getpid()).encode())
    os.close(file)
    # To this very thread: the main one would stop the others a moment later, when they are somewhere else.
    signal.pthread_kill(threading.get_ident(), getattr(signal, os.environ.get("LABOS_CRASH_BY", "SIGKILL")))


def reach(point: str) -> None:
    if due(point):
        die()


def _in_kernel() -> None:
    from labos.core.ids import local
    from labos.node.protocol import Ask, Start
    from labos.runtime.dispatcher import Dispatcher
    from labos.runtime.observing import Observer
    from labos.runtime.reconcile import Reconciler
    from labos.store import SqlEventStore

    append, claim, ask = SqlEventStore.append, SqlEventStore.claim, Dispatcher._ask_node
    look, tell = Observer.observe, Reconciler._report_sight

    def crashing_append(self: Any, expected: Any, records: Any) -> Any:
        ends = any(record.head.type == "action.succeeded" for record in records)
        reach("kernel.before_commit")
        if ends:
            reach("kernel.before_result_commit")
        head = append(self, expected, records)
        reach("kernel.after_commit")
        if ends:
            reach("kernel.after_result_commit")
        return head

    def crashing_claim(self: Any, *how: Any) -> Any:
        head = claim(self, *how)
        reach("kernel.after_claim")
        return head

    async def crashing_ask(self: Any, module: Any, message: Any) -> Any:
        what = {Start: "send", Ask: "ask"}.get(type(message), "")
        if what:
            reach(f"kernel.before_{what}")
            reach(f"kernel.before_{what}_{local(module)}")
        reply = await ask(self, module, message)
        if what:
            reach(f"kernel.after_{what}")
            reach(f"kernel.after_{what}_{local(module)}")
        return reply

    async def crashing_look(self: Any, module: Any) -> Any:
        reach("kernel.before_look")
        seen = await look(self, module)
        reach("kernel.after_look")
        return seen

    def crashing_report(self: Any, *sight: Any) -> None:
        tell(self, *sight)
        reach("kernel.after_sight")

    if not {"kernel.in_commit", "kernel.in_pipeline", "kernel.in_copy"}.isdisjoint(POINTS):
        _in_transaction()
    SqlEventStore.append = crashing_append  # type: ignore[method-assign]
    SqlEventStore.claim = crashing_claim  # type: ignore[method-assign]
    Dispatcher._ask_node = crashing_ask  # type: ignore[method-assign]
    Observer.observe = crashing_look  # type: ignore[method-assign]
    Reconciler._report_sight = crashing_report  # type: ignore[method-assign]


def _in_transaction() -> None:
    """Between the head's move and the rows, or while the server waits for more rows (of a pipeline, of a
    COPY), on PostgreSQL: the head row is locked."""
    from labos.store import _postgres
    from labos.store._words import NOTHING

    insert = _postgres._insert

    def crashing_insert(cursor: Any, rows: Any, beside: Any) -> None:
        reach("kernel.in_commit")
        insert(cursor, (), beside)
        if "kernel.in_pipeline" in POINTS:
            with cursor.connection.pipeline():
                cursor.executemany(_postgres._INSERT, rows)
                cursor.connection.pgconn.flush()
                reach("kernel.in_pipeline")
            return
        if "kernel.in_copy" in POINTS:
            with cursor.copy(_postgres._COPY) as copy:
                copy.set_types(_postgres._TYPES)
                reach("kernel.in_copy")
                for row in rows:
                    copy.write_row(row)
            return
        insert(cursor, rows, NOTHING)

    _postgres._insert = crashing_insert


KINDS = (
    (b'"accepted"', "accept"),
    (b'"ended"', "result"),
    (b'"t":"void"', "void"),
    (b'"t":"epoch"', "epoch"),
)
"""Kinds of lines of a journal, by a record in it: a tombstone may bring the new epoch along."""


def _in_node() -> None:
    from labos.node.journal_file import FileJournalFile
    from labos.node.server import NodeServer
    from labos.node.world import World

    append, publish, grip = FileJournalFile._append, NodeServer._publish, World.grip

    def crashing_append(self: Any, data: bytes) -> None:
        kind = next((kind for text, kind in KINDS if text in data), "other")
        reach(f"node.before_{kind}_journal")
        if due(f"node.torn_{kind}_journal"):
            os.write(self._fd, data[: len(data) // 2])
            die()
        append(self, data)
        reach(f"node.after_{kind}_journal")

    async def crashing_publish(self: Any, key: str, message: Any) -> None:
        result = "/result/" in key
        if result:
            reach("node.before_publish")
        await publish(self, key, message)
        if result:
            reach("node.after_publish")

    def crashing_grip(self: Any, device: str, place: str, how: str = "") -> str:
        reach("node.before_grip")
        plate = grip(self, device, place, how)
        reach("node.in_motion")
        return plate

    FileJournalFile._append = crashing_append  # type: ignore[method-assign]
    NodeServer._publish = crashing_publish  # type: ignore[method-assign]
    World.grip = crashing_grip  # type: ignore[method-assign]


if "kernel" in ROLES and "up" in sys.argv:
    _in_kernel()
if "node" in ROLES and "node" in sys.argv:
    _in_node()  # also in the process whose forks the nodes are: which one it is shows when it is called

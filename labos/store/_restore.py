"""Restoring a log into an empty database, all or nothing, with a new epoch.

A restored log may be older than the journals of its nodes, which know kernels of later epochs. So it begins
with an epoch that no kernel of this lab can have had. Then the nodes obey it, and a request that an older
kernel sent can no longer be carried out.
"""

from __future__ import annotations

from collections.abc import Iterable
from itertools import islice

import msgspec
from sqlalchemy import select, update

from labos.core.envelope import GENESIS, Record
from labos.core.ids import LabId
from labos.core.lab import LEAP
from labos.errors import Refused
from labos.ports import Head, StoredWords
from labos.store._backend import WordChanges
from labos.store._event_store import rows_of
from labos.store._lease import find_lease_holder
from labos.store._migrate import migrate, read_database_status
from labos.store._open import use_backend
from labos.store._tables import head
from labos.store._url import display_name, parse_url
from labos.store._words import make_changes, row_of

_CHUNK = 2000
_BEGAN_S = 1_767_225_600
"""2026-01-01 UTC. PostgreSQL's locks take epochs below 2³¹: enough until 2094."""


def leap_epoch(epoch: int, now_ns: int) -> int:
    """An epoch above every possible epoch of this lab's kernels: the seconds since 2026. It would be too low
    only if kernels had started more than once per second all the time."""
    return max(epoch + LEAP, now_ns // 1_000_000_000 - _BEGAN_S)


def restore_log(
    url: str, records: Iterable[Record], lab: str, epoch: int, words: Iterable[StoredWords] = ()
) -> Head:
    """Put records, and the words beside them, into a database without a log, in one transaction; returns the
    log's head. The caller has checked the records. Raises Refused if there is a log, StoreUnavailable; in
    both cases nothing was written."""
    refuse_to_overwrite(url)
    migrate(url)
    source, rest = iter(records), iter(words)
    end = Head(LabId(lab), 0, GENESIS, epoch)
    with use_backend(parse_url(url)) as backend:
        backend.occupy("labos restore")
        with backend.writing.connect() as connection, connection.begin():
            found = connection.execute(select(head.c.position).with_for_update()).scalar_one()
            if found:
                raise _refuse_occupied(url, found)
            # The words are written before the events that erased some of them.
            while some := list(islice(rest, _CHUNK)):
                backend.insert(connection, (), WordChanges(list(map(row_of, some))))
            while chunk := list(islice(source, _CHUNK)):
                rows = rows_of(end, chunk)
                backend.insert(connection, rows, make_changes(chunk))
                last = chunk[-1]
                end = Head(end.lab, last.head.position, last.hash, epoch, last.head.recorded_at)
            connection.execute(update(head).values(msgspec.structs.asdict(end)))
    return end


def refuse_to_overwrite(url: str) -> None:
    """Raise Refused if a database has a log already, or if a kernel lives on it."""
    status = read_database_status(url)
    if status.state in ("missing", "empty"):
        return
    owner = find_lease_holder(url)
    if owner:
        raise Refused(
            f"A kernel ({owner}) is running on the {status.name}.",
            remedy="Restore into another database, or stop it and move its database away.",
        )
    if status.state != "current":
        raise Refused(
            f"The {status.name} holds a log of revision {status.revision}.",
            remedy="Restore into another database, or move this one away.",
        )
    with use_backend(parse_url(url)) as backend, backend.reading.connect() as connection:
        position = connection.execute(select(head.c.position)).scalar_one()
    if position:
        raise _refuse_occupied(url, position)


def raise_epoch(url: str, now_ns: int) -> tuple[int, int]:
    """Record that a database was restored from a copy: the epoch of its next kernel is above every epoch that
    its nodes can have seen. Returns the epochs before and after. Raises Refused while a kernel lives,
    StoreUnavailable."""
    owner = find_lease_holder(url)
    parsed = parse_url(url)
    if owner:
        raise Refused(
            f"A kernel ({owner}) is running on the {display_name(parsed)}.",
            remedy="Stop it first: Ctrl-C where labos up runs.",
        )
    with use_backend(parsed) as backend:
        backend.occupy("labos db restored")
        with backend.writing.connect() as connection, connection.begin():
            before = connection.execute(select(head.c.epoch).with_for_update()).scalar_one()
            after = leap_epoch(before, now_ns)
            connection.execute(update(head).values(epoch=after, lease_owner="", lease_until=0))
    return int(before), after


def _refuse_occupied(url: str, position: int) -> Refused:
    return Refused(
        f"The {display_name(parse_url(url))} holds a log of {position} records; it is not overwritten.",
        remedy="Restore into another database, or move this one away.",
    )

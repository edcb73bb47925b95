"""Finds what the nodes' journals contain and the log does not: the sign of a log whose end was cut off."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from pathlib import Path

import msgspec

from labos.core.decide.shorter import FoundAction
from labos.core.ids import ActionId, ModuleName
from labos.core.lab import KernelStarted
from labos.core.structs import make_from
from labos.errors import JournalDamaged, Refused
from labos.node.journal import Memory, knows_more, read_journal
from labos.node.protocol import Unacknowledged
from labos.ports import LogQuery
from labos.services.log import Log, decode_event


class Surplus(msgspec.Struct, frozen=True):
    """A journal with entries that the log does not have."""

    journal: str
    knows: str


def find_owners(folder: Path) -> dict[str, str]:
    """The labs to which the journals in a folder belong, by ``workcell.module``. Damaged journals, and those
    without a lab, are left out."""
    return {name: journal.lab for name, journal in _read_sound(folder) if journal.lab}


def refuse_lost_log(log: Log, folder: Path, database: str) -> None:
    """If the log has no events but there are journals of a lab, the log is not that lab's: it was lost,
    copied without its write-ahead log, or another database was meant. Raises Refused."""
    known = {} if log.head().position else find_owners(folder)
    if known:
        name, lab = next(iter(known.items()))
        more = f" and {len(known) - 1} more" if len(known) > 1 else ""
        raise Refused(
            f"The log in {database} is empty, but {folder} holds journals of the lab {lab} "
            f"({name}{more}): the log of that lab is in another place, or lost.",
            remedy="Put it back (`labos restore FOLDER`, or the file that it was in, its -wal file beside "
            f"it), or name its --database. To start a new lab here, check the bench and move {folder} "
            "away first.",
        )


def list_surplus(log: Log, journals: dict[str, Memory]) -> list[Surplus]:
    """The entries of journals that the log does not have. The journals must have been read before the log, as
    a request is in the log before its node receives it."""
    head = log.head()
    starts = _list_starts(log)
    found: list[Surplus] = []
    for name, journal in journals.items():
        if journal.lab and not head.position:
            found.append(Surplus(name, f"the lab {journal.lab}, and this log has no event of it"))
            continue
        if journal.lab and journal.lab != head.lab:
            continue  # of another lab that used this folder
        if journal.epoch > head.epoch:
            found.append(Surplus(name, f"a kernel of epoch {journal.epoch}; the log's last has {head.epoch}"))
        if knows_more(journal.pruned, journal.pruned_by, head.position, starts):
            found.append(Surplus(name, f"of a log up to position {journal.pruned}"))
        for attempt in _list_unlogged(log, journal, head.position):
            what = f"{attempt.name} ({attempt.status}), requested at position {attempt.position}"
            found.append(Surplus(name, what))
    return found


def find_unlogged(log: Log, folder: Path) -> list[tuple[ModuleName, list[FoundAction], int]]:
    """The entries of the journals in a folder that the log of their lab does not have, by module: actions,
    and the position up to which the journal was acknowledged (0: the log is at least as long). Damaged
    journals are left out, as their nodes refuse to start."""
    head, starts = log.head(), _list_starts(log)
    found: list[tuple[ModuleName, list[FoundAction], int]] = []
    for name, journal in _read_sound(folder):
        if journal.lab != head.lab:
            continue
        unlogged = _list_unlogged(log, journal, head.position)
        strange = [make_from(FoundAction, each, action=ActionId(each.action)) for each in unlogged]
        more = knows_more(journal.pruned, journal.pruned_by, head.position, starts)
        if strange or more:
            module = ModuleName(name.replace(".", "/", 1))
            found.append((module, strange, journal.pruned if more else 0))
    return found


def _read_sound(folder: Path) -> Iterator[tuple[str, Memory]]:
    """The journals in a folder that are not damaged, by ``workcell.module``."""
    for path in sorted(folder.glob("*.journal")):
        with contextlib.suppress(JournalDamaged):
            yield path.stem, read_journal(path.read_bytes())


def _list_unlogged(log: Log, journal: Memory, end: int) -> list[Unacknowledged]:
    """The attempts in a journal whose requests are not in the log."""
    return [each for each in journal.list_unacknowledged() if not _is_requested(log, each, end)]


def _is_requested(log: Log, attempt: Unacknowledged, end: int) -> bool:
    if not 1 <= attempt.position <= end:
        return False
    record = next(log.read(attempt.position - 1, attempt.position), None)
    return record is not None and getattr(decode_event(record), "action", "") == attempt.action


def _list_starts(log: Log) -> list[tuple[int, int]]:
    pairs = [(decode_event(r), r.head.position) for r in log.select(LogQuery(types=(KernelStarted.TYPE,)))]
    return [(event.epoch, position) for event, position in pairs if isinstance(event, KernelStarted)]

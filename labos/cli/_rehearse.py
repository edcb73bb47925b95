"""Rehearses a restore: whether a backup can be restored, how long that takes, and how many events it would
lose."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import click
import msgspec

from labos.cli._out import end_with_json
from labos.cli._query import Where, name_own_database, now_ns, open_database
from labos.core.ids import LabId
from labos.core.structs import make_from
from labos.errors import LabosError, LogDamaged
from labos.private import replace_file
from labos.services.doctor import REHEARSAL
from labos.services.times import show_time

if TYPE_CHECKING:
    from labos.cli.restore import Restored


class RestoreRehearsal(msgspec.Struct, frozen=True):
    """The result: ``took_s`` seconds for everything; ``behind`` events of the lab's log are not in the backup
    (None: there is no log to compare with, ``compared`` says why)."""

    lab: LabId
    folder: str
    position: int
    hash: str
    state: str
    blobs: int
    took_s: float
    at: int
    behind: int | None
    compared: str


def rehearse(where: Where, folder: Path, put_back: Callable[[Where], Restored], scratch: Path | None) -> None:
    """Restore a backup into a temporary folder, compare it with the lab's log, and note the rehearsal in the
    lab's folder. Raises what ``put_back`` raises, LogDamaged for the backup of another log."""
    began = time.monotonic()
    with tempfile.TemporaryDirectory(prefix="labos-rehearsal-", dir=scratch) as there:
        home = Path(there) / "lab"
        home.mkdir(0o700)
        done = put_back(Where(home, name_own_database(home)))
    behind, compared = _compare(where, done)
    found = make_from(
        RestoreRehearsal,
        done,
        folder=str(folder.absolute()),
        took_s=round(time.monotonic() - began, 3),
        at=now_ns(),
        behind=behind,
        compared=compared,
    )
    if where.home.is_dir():
        replace_file(where.home / REHEARSAL, msgspec.json.encode(found) + b"\n")
    end_with_json(found)
    click.echo(
        f"The backup can be restored: {found.position} events up to {show_time(done.recorded_at)}, "
        f"{found.blobs} "
        f"blobs; chain, fold and state agree. It took {found.took_s:.1f} s."
    )
    click.echo(compared)


def _compare(where: Where, done: Restored) -> tuple[int | None, str]:
    """How many events of the lab's log are not in the backup."""
    try:
        with open_database(where) as store:
            head = store.head()
            record = next(store.read(done.position - 1, done.position), None)
    except LabosError as error:
        return None, f"It was not compared with a log: {error.message}"
    if not head.position:
        return None, "It was not compared with a log: there is none in this lab's folder."
    if record is None or record.hash.hex() != done.hash:
        raise LogDamaged(
            f"The backup is intact, but belongs to another log than that of {where.home}: they "
            "differ at position "
            f"{done.position} or before.",
            position=done.position,
            remedy="Name the folder of this lab's backup, or find the change: labos verify",
        )
    behind = head.position - done.position
    if not behind:
        return 0, "The backup contains all events of the lab's log."
    return behind, (
        f"A restore would lose {behind} events, recorded since {show_time(done.recorded_at)}: labos backup"
    )

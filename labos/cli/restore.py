"""``labos restore``: restores a backup into an empty database, or rehearses this."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import closing
from pathlib import Path

import click
import msgspec

from labos.cli._options import file_option
from labos.cli._out import end_with_json
from labos.cli._query import Where, folder_and_json, name_own_database, now_ns, open_database
from labos.cli.backup import archive_option, key_option
from labos.core.ids import LabId
from labos.core.state import hash_state
from labos.core.structs import make_from
from labos.core.words import Kept
from labos.errors import LabosError, LogDamaged
from labos.ports import StoredWords
from labos.private import replace_file
from labos.services.doctor import REHEARSAL
from labos.services.log import fold_to
from labos.services.times import show_time
from labos.settings import KernelInfo, announce, last_kernel
from labos.store import (
    ERASURES,
    Blobs,
    FolderBlobs,
    find_first_damage,
    forget_end,
    key_of,
    leap_epoch,
    open_accounts,
    open_blobs,
    put_accounts_back,
    read_accounts_copy,
    read_erasures,
    read_words_copy,
    records_of,
    refuse_to_overwrite,
    restore_log,
    show_url,
    verify_backup,
)


class Restored(msgspec.Struct, frozen=True):
    """A backup that was restored into a database and checked there: its last ``position``, the chain's
    ``hash`` and the hash of the ``state`` there, and the number of ``users`` whose accounts were restored.
    The next kernel's ``epoch`` is above this one."""

    lab: LabId
    position: int
    hash: str
    state: str
    epoch: int
    blobs: int
    database: str
    recorded_at: int = 0
    users: int = 0


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


@click.command("restore", short_help="Put a backup into an empty database.")
@click.argument("folder", type=click.Path(path_type=Path, file_okay=False))
@click.option(
    "--rehearse",
    "is_rehearsal",
    is_flag=True,
    help="Only test it: restore to a folder that is removed afterwards. The lab may run.",
)
@click.option(
    "--scratch",
    type=click.Path(path_type=Path, file_okay=False, exists=True),
    metavar="DIR",
    help="With --rehearse: a folder with room for a copy of the log (default: that for temporary files).",
)
@file_option(
    "--erased",
    "lists",
    multiple=True,
    help="A list of erasures (labos.erased) besides the one in the lab's folder.",
)
@archive_option
@key_option
@folder_and_json
def command(
    where: Where,
    folder: Path,
    is_rehearsal: bool,
    scratch: Path | None,
    lists: tuple[Path, ...],
    archive: Path | None,
    key_file: Path | None,
) -> None:
    """Restore the backup in FOLDER: the log into the lab's database, which must be empty, and the blobs into
    the lab's folder. A backup of SQLite can be restored to PostgreSQL, and the reverse.

    LabOS checks the backup first, and the restored log afterwards: the chain of hashes, the state from
    replaying all events, and its hash. The lab's next kernel has a higher epoch than its nodes have ever
    seen. It starts no action until a person has checked the bench (labos bench round).

    Texts that were erased after the backup do not come back. The list of erasures is labos.erased in the
    lab's folder (`labos erase` writes it). If that folder is lost, give a copy of the list with --erased.

    With --rehearse, LabOS restores into a temporary folder and compares the copy with the lab's log. It
    reports how much a restore would lose, and how long it takes. `labos doctor` shows the time of the last
    rehearsal.

    \b
    labos restore /safe/lab
    labos restore /safe/lab --rehearse
    labos restore /safe/lab --archive /archive/lab    with the segments that were moved there
    """
    key = key_of(key_file) if key_file else b""
    if scratch is not None and not is_rehearsal:
        raise click.UsageError("--scratch needs --rehearse.")
    if is_rehearsal:
        _rehearse(where, folder, key, _with_own(lists, where), archive, scratch)
        return
    # The note in the home folder must be valid from every working directory.
    done = put_back(Where(where.home.absolute(), where.database), folder, key, lists=lists, archive=archive)
    end_with_json({name: getattr(done, name) for name in done.__struct_fields__ if name != "recorded_at"})
    click.echo(f"The lab {done.lab} is restored up to position {done.position}: chain, fold and state agree.")
    click.echo(f"Database {done.database}, {done.blobs} blobs, next epoch above {done.epoch}.")
    if done.users:
        click.echo(
            f"The accounts of {done.users} users are as they were then: again revoke tokens that were "
            "revoked since (labos token list), and erase users who were erased since (labos user "
            "erase)."
        )
    click.echo("No action starts before a person has checked the bench: labos up, then labos bench round.")


def put_back(
    where: Where,
    folder: Path,
    key: bytes,
    blobs: Blobs | None = None,
    lists: Sequence[Path] = (),
    archive: Path | None = None,
) -> Restored:
    """Restore a backup into a database without a log, its blobs to the place where the lab stores them (or to
    ``blobs``), and check the result. Words that are erased according to ``lists``, or to the list in the
    lab's folder, are left out. Segments that are not in the folder are read from the ``archive``. Raises
    Refused, LogDamaged, BadInput, StoreUnavailable."""
    refuse_to_overwrite(where.url)
    found, state = verify_backup(folder, key=key, archive=archive)
    people = read_accounts_copy(folder, found.lab, key)
    target, source = blobs or open_blobs(where.settings.blobs), FolderBlobs(folder / "blobs")
    for name in found.blobs:
        target.put(source.get(name))
    epoch = leap_epoch(found.epoch, now_ns())
    gone = _read_erased(found.lab, _with_own(lists, where))
    words = _drop_erased(read_words_copy(folder), gone)
    head = restore_log(where.url, records_of(folder, found, archive), found.lab, epoch, words)
    forget_end(where.home)  # it was restored on purpose
    wanted = hash_state(state)
    with open_database(where) as store:
        store.note_erasures()
        damage = find_first_damage(store)
        if damage is not None:
            raise LogDamaged(
                f"The restored log is damaged at position {damage.position}: {damage.reason}.",
                position=damage.position,
                remedy="Check the disk, then restore into another database.",
            )
        written = hash_state(fold_to(store, head.position))
    if written != wanted:
        raise LogDamaged(
            "The restored log gives another state than the backup.",
            position=head.position,
            remedy="Check the disk, then restore into another database.",
        )
    if people is not None:
        with closing(open_accounts(where.url)) as accounts:
            put_accounts_back(accounts, people)
    if last_kernel(where.home) is None:
        place = str(where.settings.blobs)
        info = KernelInfo(0, "", "", found.lab, where.url, found.simulated, state.lab.pace, place)
        announce(where.home, info)
    return Restored(
        lab=head.lab,
        position=head.position,
        hash=head.hash.hex(),
        state=written,
        epoch=epoch,
        blobs=len(found.blobs),
        database=show_url(where.url),
        recorded_at=head.recorded_at,
        users=people.users if people is not None else 0,
    )


def _with_own(lists: Sequence[Path], where: Where) -> Sequence[Path]:
    """Lists of erasures, and the one in the lab's folder if there is one."""
    own = where.home / ERASURES
    return (*lists, own) if own.exists() else lists


def _read_erased(lab: str, lists: Sequence[Path]) -> dict[str, int]:
    """The references that lists of erasures name, and the positions of the events. Raises BadInput."""
    known = [each for file in lists for each in read_erasures(file) if each.lab == lab]
    return {each.reference: each.position for each in known}


def _drop_erased(words: Iterable[StoredWords], gone: Mapping[str, int]) -> Iterator[StoredWords]:
    for each in words:
        name = each.words.reference
        is_gone = name in gone
        yield StoredWords(Kept(name, b"", ""), each.position, gone[name]) if is_gone else each


def _rehearse(
    where: Where, folder: Path, key: bytes, lists: Sequence[Path], archive: Path | None, scratch: Path | None
) -> None:
    """Restore a backup into a temporary folder, compare it with the lab's log, and note the rehearsal in the
    lab's folder. Raises what ``put_back`` raises, LogDamaged for the backup of another log."""
    began = time.monotonic()
    with tempfile.TemporaryDirectory(prefix="labos-rehearsal-", dir=scratch) as there:
        home = Path(there) / "lab"
        home.mkdir(0o700)
        own = FolderBlobs(home / "blobs")  # the folder where the lab stores its own
        done = put_back(Where(home, name_own_database(home)), folder, key, own, lists, archive)
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

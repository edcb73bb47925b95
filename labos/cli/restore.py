"""``labos restore``: restores a backup into an empty database, or rehearses this."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import closing
from pathlib import Path

import click
import msgspec

from labos.cli._options import file_option
from labos.cli._out import end_with_json
from labos.cli._query import Where, folder_and_json, now_ns, open_database
from labos.cli._rehearse import rehearse
from labos.cli.backup import archive_option, key_option
from labos.core.ids import LabId
from labos.core.state import hash_state
from labos.core.words import Kept
from labos.errors import LogDamaged
from labos.ports import StoredWords
from labos.services.log import fold_to
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
        known = _with_own(lists, where)

        def try_it(place: Where) -> Restored:
            own = FolderBlobs(place.home / "blobs")  # the folder where the lab stores its own
            return put_back(place, folder, key, own, known, archive)

        rehearse(where, folder, try_it, scratch)
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

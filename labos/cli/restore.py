"""``labos restore``: a backup put into an empty database."""

from __future__ import annotations

from pathlib import Path

import click

from labos.cli._out import show_json
from labos.cli._query import Where, json_option, kernel_file, log_options, now_ns, open_database
from labos.cli.backup import key_option
from labos.core.state import state_hash
from labos.errors import LogDamaged
from labos.services.log import fold_to
from labos.settings import KernelInfo, Settings, announce
from labos.store import (
    FolderBlobs,
    first_damage,
    forget_end,
    key_of,
    leapt_epoch,
    open_blobs,
    records_of,
    refuse_to_overwrite,
    restore_log,
    shown_url,
    verify_backup,
)


@click.command("restore", short_help="Put a backup into an empty database.")
@click.argument("folder", type=click.Path(path_type=Path, file_okay=False))
@key_option
@json_option
@log_options
def command(where: Where, folder: Path, key_file: Path | None, as_json: bool) -> None:
    """Put the backup in FOLDER into the lab's database, which must not hold a log, and its blobs into
    the lab's folder. SQLite and PostgreSQL take each other's backups.

    The backup is checked first, what was written is checked afterwards: chain, fold and hash of the
    state. The lab's next kernel has a greater epoch than any that its nodes have seen, and starts nothing
    before a person has checked the bench: labos bench round.
    """
    # What is noted in the home must hold from every working directory.
    where = Where(where.home.absolute(), where.database)
    refuse_to_overwrite(where.url)
    found, state = verify_backup(folder, key=key_of(key_file) if key_file else b"")
    blobs, source = open_blobs(Settings.of(where.home, where.url).blobs), FolderBlobs(folder / "blobs")
    for name in found.blobs:
        blobs.put(source.get(name))
    epoch = leapt_epoch(found.epoch, now_ns())
    head = restore_log(where.url, records_of(folder, found), found.lab, epoch)
    forget_end(where.home)  # it was put back on purpose
    wanted = state_hash(state)
    with open_database(where) as store:
        damage = first_damage(store)
        if damage is not None:
            raise LogDamaged(
                f"What was written is damaged at position {damage.position}: {damage.reason}.",
                position=damage.position,
                remedy="Check the disk, then restore into another database.",
            )
        written = state_hash(fold_to(store, head.position))
    if written != wanted:
        raise LogDamaged(
            "What was written folds to another state than the backup.",
            position=head.position,
            remedy="Check the disk, then restore into another database.",
        )
    if not kernel_file(where.home):
        place = str(Settings.of(where.home, where.url).blobs)
        info = KernelInfo(0, "", "", found.lab, where.url, found.simulated, state.lab.pace, place)
        announce(where.home, info)
    if as_json:
        show_json(
            {
                "lab": found.lab,
                "position": head.position,
                "hash": head.hash.hex(),
                "state": written,
                "epoch": epoch,
                "blobs": len(found.blobs),
                "database": shown_url(where.url),
            }
        )
        return
    click.echo(
        f"The lab {found.lab} is restored up to position {head.position}: chain, fold and state agree."
    )
    click.echo(f"Database {shown_url(where.url)}, {len(found.blobs)} blobs, next epoch above {epoch}.")
    click.echo(
        "Nothing will start before somebody has been round the bench: labos up, then labos bench round."
    )

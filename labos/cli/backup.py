"""``labos backup``: the log and its blobs, copied while the lab runs."""

from __future__ import annotations

from contextlib import closing
from pathlib import Path

import click
import msgspec

from labos.cli._options import file_option, folder_option
from labos.cli._out import end_with_json
from labos.cli._query import Where, folder_and_json, now_ns, open_database
from labos.services.doctor import note_retention
from labos.settings import was_simulated
from labos.store import backup, copy_accounts, key_of, move_old_segments, open_accounts, open_blobs

_DAY_NS = 86_400 * 10**9

key_option = file_option(
    "--key", "key_file", help="A file with the key of the seal, for instance made with openssl rand -hex 32."
)


archive_option = folder_option(
    "--archive",
    metavar="DIR",
    help="The folder of moved segments (labos backup --move-old), for segments that FOLDER lacks.",
)


@click.command("backup", short_help="Copy the log and its blobs while the lab runs.")
@click.argument("folder", type=click.Path(path_type=Path, file_okay=False))
@folder_option(
    "--move-old",
    "archive",
    metavar="DIR",
    help="After the backup, move segments older than --keep-days to this folder, such as another disk.",
)
@click.option(
    "--keep-days",
    type=click.FloatRange(min=0),
    default=365.0,
    show_default=True,
    help="With --move-old: keep segments with an event from the last N days.",
)
@key_option
@folder_and_json
def command(
    where: Where, folder: Path, archive: Path | None, keep_days: float, key_file: Path | None
) -> None:
    """Create a backup in FOLDER, or update it to the present end of the log. The lab may run meanwhile.

    \b
    labos backup /safe/lab              the first time: everything
    labos backup /safe/lab              later: new events, in a new segment
    labos backup /safe/lab --key K      seal the new segment
    labos verify --backup /safe/lab     check it, without a database
    labos restore /safe/lab --rehearse  test whether it can be restored
    labos restore /safe/lab             put it into an empty database
    labos backup /safe/lab --move-old /archive/lab --keep-days 400

    A segment is never changed. The file accounts.json is written again each time: it holds users' names,
    mail addresses, and the digests of passwords and tokens. The journals of the nodes are not copied.
    LabOS needs them to recognise a log that was restored from an older copy.
    """
    key = key_of(key_file) if key_file else b""
    with open_database(where) as store:
        made = backup(
            store,
            open_blobs(where.settings.blobs),
            folder,
            key=key,
            simulated=bool(was_simulated(where.settings)),
        )
    with closing(open_accounts(where.url)) as accounts:
        people = copy_accounts(accounts, made.lab, folder, now_ns(), key)
    before = now_ns() - int(keep_days * _DAY_NS)
    moved = move_old_segments(folder, archive, before) if archive is not None else []
    if archive is not None:
        note_retention(where.home, "moved_at", now_ns())
    files = [segment.file for segment in moved]
    end_with_json({**msgspec.structs.asdict(made), "users": people.users, "moved": files})
    newest = made.segments[-1]
    click.echo(f"{folder} holds the lab {made.lab} up to position {made.position}.")
    click.echo(f"Hash {made.hash}, state {newest.state}")
    click.echo(
        f"{len(made.segments)} segments, the newest {newest.file}{' (sealed)' if newest.seal else ''}; "
        f"{len(made.blobs)} blobs."
    )
    if people.users:
        click.echo(f"The accounts of {people.users} users are in accounts.json.")
    if archive is not None:
        click.echo(
            f"{len(moved)} segments were moved to {archive}."
            if moved
            else "No segment is older than --keep-days."
        )

"""``labos verify --backup``: checks a backup, whole or in its later segments."""

from __future__ import annotations

from pathlib import Path
from typing import NoReturn

import click

from labos.cli._out import end_with_json
from labos.core.state import hash_state
from labos.errors import BadInput, LogDamaged, Refused
from labos.services.times import iso_time
from labos.store import AccountsCopy, read_accounts_copy, verify_backup, verify_detached


def check_backup(folder: Path, archive: Path | None, key: bytes, *, detached: bool) -> None:
    """Check a backup and report the result; exit code 1 if it is damaged. ``archive`` has the segments that
    were moved there. ``detached``: the first segments are missing because they are kept elsewhere."""
    try:
        if detached:
            _verify_detached(folder, key)
        else:
            _verify_backup(folder, archive, key)
    except LogDamaged as error:
        _report_damage(error)


def _verify_backup(folder: Path, archive: Path | None, key: bytes) -> None:
    """Raises LogDamaged."""
    found, state = verify_backup(folder, key=key, archive=archive)
    people = _accounts_of(folder, found.lab, key)
    facts = {"whole": True, "backup": found, "state": hash_state(state), "accounts": _count_accounts(people)}
    end_with_json(facts)
    end = iso_time(found.segments[-1].recorded_at)
    click.echo(
        f"The backup is intact: {found.position} records in {len(found.segments)} segments, "
        f"{len(found.blobs)} blobs{', all seals valid' if key else ''}."
    )
    click.echo(f"Lab {found.lab}, position {found.position}, hash {found.hash}, last event {end}")
    click.echo(f"State {hash_state(state)}")
    _report_accounts(people)


def _accounts_of(folder: Path, lab: str, key: bytes) -> AccountsCopy | None:
    """The accounts in a backup; None if it has none. Raises LogDamaged for accounts that `labos restore`
    would refuse."""
    try:
        return read_accounts_copy(folder, lab, key)
    except (BadInput, Refused) as error:
        raise LogDamaged(error.message, position=0, remedy=error.remedy) from None


def _count_accounts(people: AccountsCopy | None) -> dict[str, int] | None:
    return None if people is None else {"users": people.users, "copied_at": people.copied_at}


def _report_accounts(people: AccountsCopy | None) -> None:
    if people is None:
        click.echo("It contains no accounts of users.")
    else:
        click.echo(f"The accounts of {people.users} users are intact, as of {iso_time(people.copied_at)}.")


def _report_damage(error: LogDamaged) -> NoReturn:
    end_with_json({"whole": False, "fault": error.message, "position": error.position}, 1)
    click.echo(f"The backup is damaged. {error}")
    click.get_current_context().exit(1)


def _verify_detached(folder: Path, key: bytes) -> None:
    """Raises LogDamaged."""
    found = verify_detached(folder, key=key)
    people = _accounts_of(folder, found.lab, key)
    end_with_json({"whole": True, "detached": found, "accounts": _count_accounts(people)})
    first, last = found.segments[0], found.segments[-1]
    seals = ", all seals valid" if found.sealed else ""
    absent = f" ({found.blobs_absent} are elsewhere)" if found.blobs_absent else ""
    click.echo(
        f"The backup is intact from position {first.first} on: {found.records} records in "
        f"{len(found.segments)} segments, {found.blobs} blobs{absent}{seals}."
    )
    if found.absent:
        vouched = "the seal" if found.sealed else "the manifest, which is not protected without a seal"
        click.echo(
            f"It continues position {found.after} with the hash {found.before}, according to {vouched}. "
            f"Elsewhere: {', '.join(segment.file for segment in found.absent)}."
        )
    click.echo(
        f"Lab {found.lab}, position {last.last}, hash {last.hash}, last event {iso_time(last.recorded_at)}"
    )
    click.echo("The state was not computed: this needs all segments from position 1 on.")
    _report_accounts(people)

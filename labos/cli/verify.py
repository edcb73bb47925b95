"""``labos verify``: checks that the log is unchanged."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NoReturn

import click
import msgspec

from labos.cli._options import file_option, folder_option
from labos.cli._out import end_with_json, show_lines, wants_json
from labos.cli._query import Where, folder_and_json, open_database
from labos.cli._signed import compare_signed, trust_of, verify_bundle
from labos.cli.backup import archive_option, key_option
from labos.core.seals import add_seal, check_seal
from labos.core.state import hash_state
from labos.errors import BadInput, LabosError, LogDamaged, Refused
from labos.private import create_file
from labos.services.checkpoint import Checkpoint, find_contradiction, make_checkpoint, read_checkpoint
from labos.services.journals import list_surplus
from labos.services.signatures import check_signatures
from labos.services.times import iso_time
from labos.services.trust.compare import CheckpointComparison, is_signed
from labos.services.verification import (
    VerifiedPart,
    check_benches,
    check_blobs,
    check_database,
    check_end,
    check_journals,
    check_snapshot,
)
from labos.services.words_check import check_words
from labos.store import (
    AccountsCopy,
    Damage,
    Progress,
    SqlEventStore,
    find_first_damage,
    key_of,
    open_blobs,
    read_accounts_copy,
    verify_backup,
    verify_detached,
)

CAVEAT = (
    "The chain of hashes alone does not show that the end was cut off or that the whole log was rewritten: "
    "keep a checkpoint elsewhere (--checkpoint FILE) and compare with it."
)


@click.command("verify", short_help="Check the log's chain of hashes.")
@click.option(
    "--checkpoint",
    "file",
    type=click.Path(path_type=Path),
    metavar="FILE|FOLDER",
    help="Compare with this checkpoint, or with a folder of signed ones; if there is no such file, write it.",
)
@click.option("--export", is_flag=True, help="Write a new checkpoint if the log agrees with the old one.")
@click.option(
    "--journals",
    is_flag=True,
    help="Check the journals of this home's nodes, and whether they know actions that the log lacks.",
)
@folder_option("--backup", "folder", help="Check a backup instead of the database.")
@click.option(
    "--detached",
    is_flag=True,
    help="With --backup: the first segments are missing because they are kept elsewhere.",
)
@file_option(
    "--bundle",
    help="Check a bundle of `labos bundle` instead, offline: neither the database nor the lab is needed.",
)
@click.option(
    "--public-key",
    "public_keys",
    multiple=True,
    metavar="KEY|FILE",
    help="Accept signatures of this public key (default: keys in the lab's folder). May be repeated.",
)
@click.option(
    "--witness-key",
    "witness_keys",
    multiple=True,
    metavar="KEY|FILE",
    help="With --bundle: require a cosignature of this witness.",
)
@file_option("--tsa", help="With --bundle: check the time stamp against the certificates in this PEM file.")
@archive_option
@key_option
@folder_and_json
def command(
    where: Where,
    file: Path | None,
    export: bool,
    journals: bool,
    folder: Path | None,
    detached: bool,
    bundle: Path | None,
    public_keys: tuple[str, ...],
    witness_keys: tuple[str, ...],
    tsa: Path | None,
    archive: Path | None,
    key_file: Path | None,
) -> None:
    """Check every record of the log against the chain of hashes. Check also the data beside the log: the
    snapshot (its seal, and whether a replay of the log gives the same state), the recorded end of the log,
    each blob that the log names, and the records of simulated benches. The command reports what it checked.
    Exit code 1 if anything is wrong.

    \b
    labos verify                               all of these
    labos verify --checkpoint /safe/lab.json   the first time: save the end of the log;
                                               later: check that nothing before it has changed
    labos verify --checkpoint F --export       compare, then save the new end
    labos verify --checkpoint F --key K        seal it, or check its seal
    labos verify --journals                    also the nodes' journals, and actions that the log lacks
    labos verify --backup /safe/lab            a backup, without any database
    labos verify --backup /safe/lab --archive /archive/lab   with the segments that were moved there
    labos verify --backup /safe/lab --detached   its later segments, without the earlier ones
    labos verify --checkpoint /safe/checkpoints   signed checkpoints of labos checkpoint
    labos verify --bundle R7.zip --public-key lab.pub   a run, offline

    Keep checkpoints in a place without write access for users of the database. The chain of hashes alone
    does not show that the end of the log was cut off.
    """
    if export and file is None:
        raise click.UsageError("--export needs --checkpoint FILE.")
    if detached and folder is None:
        raise click.UsageError("--detached needs --backup FOLDER.")
    if archive is not None and (folder is None or detached):
        raise click.UsageError("--archive needs --backup FOLDER, and cannot be combined with --detached.")
    if bundle is not None:
        verify_bundle(bundle, trust_of(where.home, public_keys, witness_keys, tsa))
        return
    key = key_of(key_file) if key_file else b""
    signed = file if file is not None and is_signed(file) else None
    if signed is not None and export:
        raise click.UsageError(f"{signed} is signed: use labos checkpoint for the next one, not --export.")
    if folder is not None:
        try:
            if detached:
                _verify_detached(folder, key)
            else:
                _verify_backup(folder, archive, key)
        except LogDamaged as error:
            _report_damage(error)
        return
    # The journals first: a request is in the log before its node receives it.
    about_journals, nodes = check_journals(where.home / "journals") if journals else (None, {})
    with open_database(where) as store:
        seen = read_checkpoint(file) if file is not None and not signed and file.exists() else None
        end = add_seal(make_checkpoint(store), key)
        with _show_progress(wants_json()) as progress:
            damage = find_first_damage(store, progress)
        against = find_contradiction(store, seen) if seen is not None else ""
        compared = None
        if signed is not None and not damage:
            compared = compare_signed(store, signed, where.home, public_keys)
            against = compared.fault
        parts = [] if damage else _list_other_parts(where, store)
        if about_journals is not None:
            parts.append(about_journals)
        fault = f"Position {damage.position}: {damage.reason}." if damage else ""
        if against and not fault:
            fault = f"The log contradicts the checkpoint: {against}."
        if seen is not None and (broken := check_seal(seen, key)):
            fault = f"The checkpoint cannot be trusted: {broken}."
        more = list_surplus(store, nodes) if nodes and not fault else []
        if more and not fault:
            fault = f"The nodes know more than the log: {more[0].journal} knows {more[0].knows}."
        others = [part_fault for part in parts for part_fault in part.faults]
        whole = not fault and not others
        written = file is not None and not signed and whole and (seen is None or export)
        if file is not None and written:
            _write(file, end)
    told = fault or f"{end.position} records in an unbroken chain."
    head = VerifiedPart("log", damage.position if damage else end.position, told)
    facts = {
        "whole": whole,
        "fault": fault or next(iter(others), ""),
        "position": _find_first_position(damage, compared, parts),
        "head": end,
        "compared_with": seen or compared,
        "parts": [head, *parts],
        "journals": {name: [m.knows for m in more if m.journal == name] for name in nodes},
        "checkpoint_written": written,
    }
    end_with_json(facts, int(not whole))
    _report_log(fault, end, seen, file, written=written, signed=signed is not None)
    if compared is not None and not fault:
        number = "the signed checkpoint" if compared.number == 1 else f"{compared.number} signed checkpoints"
        click.echo(f"It agrees with {number}, up to position {compared.agrees_to}.")
    for part in parts:
        show_lines(part.faults or (part.result,))
    for other in more[1:]:
        click.echo(f"{other.journal} knows {other.knows}.")
    if nodes and not fault:
        click.echo(f"The journals of {len(nodes)} nodes contain nothing that the log lacks.")
    if not journals:
        click.echo("The nodes' journals were not checked (--journals).")
    if not whole:
        click.get_current_context().exit(1)


def _find_first_position(
    damage: Damage | None, compared: CheckpointComparison | None, parts: list[VerifiedPart]
) -> int | None:
    """The first position of the log with a fault; None if there is none."""
    if damage is not None:
        return damage.position
    if compared is not None and compared.fault:
        return compared.position
    return next((at for part in parts for at in part.positions), None)


def _list_other_parts(where: Where, store: SqlEventStore) -> list[VerifiedPart]:
    """The parts beside the chain; if a part cannot be checked, that is a fault too."""
    settings = where.settings
    looks: tuple[tuple[str, Callable[[], VerifiedPart]], ...] = (
        ("database", lambda: check_database(store)),
        ("end", lambda: check_end(store)),
        ("snapshot", lambda: check_snapshot(store)),
        ("blobs", lambda: check_blobs(store, open_blobs(settings.blobs))),
        ("signatures", lambda: check_signatures(store)),
        ("words", lambda: check_words(store)),
        ("benches", lambda: check_benches(settings.worlds)),
    )
    found = []
    for name, look in looks:
        try:
            found.append(look())
        except LabosError as error:
            found.append(VerifiedPart(name, 0, error.message, (str(error),)))
    return found


def _report_log(
    fault: str, end: Checkpoint, seen: Checkpoint | None, file: Path | None, *, written: bool, signed: bool
) -> None:
    if fault:
        click.echo(f"The log is damaged. {fault}" if fault.startswith("Position") else fault)
        click.echo("Do not change this log. Restore a backup.")
    else:
        click.echo(f"The log is intact: {end.position} records in an unbroken chain.")
    click.echo(f"Lab {end.lab}, head position {end.position}, head hash {end.hash}, last event {end.time}")
    if seen is not None and not fault:
        click.echo(f"It agrees with the checkpoint of {seen.time} at position {seen.position}.")
    if written:
        click.echo(f"The checkpoint was written to {file}.")
    elif seen is None and not fault and not signed:
        click.echo(CAVEAT)


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


def _write(file: Path, end: Checkpoint) -> None:
    try:
        with create_file(file) as written:
            written.write(msgspec.json.format(msgspec.json.encode(end, order="sorted"), indent=2) + b"\n")
    except OSError as error:
        raise click.UsageError(f"The checkpoint cannot be written: {error}.") from None


@contextmanager
def _show_progress(quiet: bool) -> Iterator[Progress | None]:
    """A progress bar on standard error, if it is a terminal."""
    if quiet or not sys.stderr.isatty():
        yield None
        return
    from rich.console import Console
    from rich.progress import Progress as Bar

    with Bar(console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("Checking the chain")
        yield lambda done, total: bar.update(task, completed=done, total=total)

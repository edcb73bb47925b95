"""``labos verify``: checks that the log is unchanged."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import click
import msgspec

from labos.cli._options import file_option, folder_option
from labos.cli._out import end_with_json, show_lines, wants_json
from labos.cli._query import Where, folder_and_json, open_database
from labos.cli._verify_backup import check_backup
from labos.cli.backup import archive_option, key_option
from labos.core.seals import add_seal, check_seal
from labos.errors import BadInput, LabosError
from labos.node.journal import Memory
from labos.private import create_file
from labos.services.checkpoint import Checkpoint, find_contradiction, make_checkpoint, read_checkpoint
from labos.services.journals import Surplus, list_surplus
from labos.services.log import Log
from labos.services.signatures import check_signatures
from labos.services.trust.compare import CheckpointComparison, compare, is_signed, read_tree_heads
from labos.services.trust.keys import SigningKeys, TrustedKeys, read_given_keys
from labos.services.trust.proof import Trust, prove_bundle
from labos.services.verification import (
    VerifiedPart,
    check_benches,
    check_blobs,
    check_database,
    check_end,
    check_journals,
    check_snapshot,
    check_words,
)
from labos.store import Damage, Progress, SqlEventStore, find_first_damage, key_of, open_blobs

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
        _verify_bundle(bundle, _trust_of(where.home, public_keys, witness_keys, tsa))
        return
    key = key_of(key_file) if key_file else b""
    if export and file is not None and is_signed(file):
        raise click.UsageError(f"{file} is signed: use labos checkpoint for the next one, not --export.")
    if folder is not None:
        check_backup(folder, archive, key, detached=detached)
        return
    # The journals first: a request is in the log before its node receives it.
    part, nodes = check_journals(where.home / "journals") if journals else (None, {})
    found = _verify_log(where, file, key, public_keys, nodes)
    found.parts.extend([part] if part is not None else [])
    written = None
    if found.is_intact and file is not None and found.signed is None and (found.seen is None or export):
        _write(file, found.end)
        written = file
    end_with_json(_list_facts(found, nodes, written), int(not found.is_intact))
    _report_log(found, written)
    for part in found.parts:
        show_lines(part.faults or (part.result,))
    for other in found.surplus[1:]:
        click.echo(f"{other.journal} knows {other.knows}.")
    if nodes and not found.fault:
        click.echo(f"The journals of {len(nodes)} nodes contain nothing that the log lacks.")
    if not journals:
        click.echo("The nodes' journals were not checked (--journals).")
    if not found.is_intact:
        click.get_current_context().exit(1)


class VerifiedLog(msgspec.Struct):
    """What the checks found. ``end``: the end of the log. ``seen``: the checkpoint with which the log was
    compared, or ``signed``: its comparison with signed ones. ``damage``: the first damage of the chain.
    ``fault``: the most important fault of the log, in one sentence; empty if there is none. ``parts``: the
    parts beside the chain. ``surplus``: what the nodes know and the log does not."""

    end: Checkpoint
    seen: Checkpoint | None = None
    signed: CheckpointComparison | None = None
    damage: Damage | None = None
    fault: str = ""
    parts: list[VerifiedPart] = []
    surplus: list[Surplus] = []

    @property
    def first_fault(self) -> str:
        """The fault of the log, else the first one of a part; empty if there is none."""
        return self.fault or next((fault for part in self.parts for fault in part.faults), "")

    @property
    def is_intact(self) -> bool:
        return not self.first_fault

    @property
    def first_position(self) -> int | None:
        """The first position of the log with a fault; None if there is none."""
        if self.damage is not None:
            return self.damage.position
        if self.signed is not None and self.signed.fault:
            return self.signed.position
        return next((at for part in self.parts for at in part.positions), None)


def _verify_log(
    where: Where, file: Path | None, key: bytes, public_keys: Sequence[str], nodes: dict[str, Memory]
) -> VerifiedLog:
    """Check the chain and the parts beside it, compare them with the checkpoints in ``file`` and the nodes'
    journals."""
    with open_database(where) as store:
        found = VerifiedLog(add_seal(make_checkpoint(store), key))
        signed = file if file is not None and is_signed(file) else None
        if file is not None and signed is None and file.exists():
            found.seen = read_checkpoint(file)
        with _show_progress(wants_json()) as progress:
            found.damage = find_first_damage(store, progress)
        if found.damage is None:
            if signed is not None:
                found.signed = _compare_signed(store, signed, where.home, public_keys)
            found.parts = _list_other_parts(where, store)
        found.fault = _find_fault(store, found, key)
        if nodes and not found.fault:
            found.surplus = list_surplus(store, nodes)
        if found.surplus:
            first = found.surplus[0]
            found.fault = f"The nodes know more than the log: {first.journal} knows {first.knows}."
    return found


def _find_fault(store: SqlEventStore, found: VerifiedLog, key: bytes) -> str:
    """The most important fault of the chain and of what it is compared with; empty if there is none."""
    seen = found.seen
    if seen is not None and (broken := check_seal(seen, key)):
        return f"The checkpoint cannot be trusted: {broken}."
    if found.damage is not None:
        return f"Position {found.damage.position}: {found.damage.reason}."
    against = found.signed.fault if found.signed is not None else ""
    if seen is not None:
        against = find_contradiction(store, seen)
    return f"The log contradicts the checkpoint: {against}." if against else ""


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


def _list_facts(found: VerifiedLog, nodes: Iterable[str], written: Path | None) -> dict[str, object]:
    """What ``--json`` prints."""
    end, damage = found.end, found.damage
    result = found.fault or f"{end.position} records in an unbroken chain."
    head = VerifiedPart("log", damage.position if damage else end.position, result)
    surplus = {name: [more.knows for more in found.surplus if more.journal == name] for name in nodes}
    return {
        "whole": found.is_intact,
        "fault": found.first_fault,
        "position": found.first_position,
        "head": end,
        "compared_with": found.seen or found.signed,
        "parts": [head, *found.parts],
        "journals": surplus,
        "checkpoint_written": written is not None,
    }


def _report_log(found: VerifiedLog, written: Path | None) -> None:
    end, seen, fault = found.end, found.seen, found.fault
    if fault:
        click.echo(f"The log is damaged. {fault}" if fault.startswith("Position") else fault)
        click.echo("Do not change this log. Restore a backup.")
    else:
        click.echo(f"The log is intact: {end.position} records in an unbroken chain.")
    click.echo(f"Lab {end.lab}, head position {end.position}, head hash {end.hash}, last event {end.time}")
    if seen is not None and not fault:
        click.echo(f"It agrees with the checkpoint of {seen.time} at position {seen.position}.")
    if written is not None:
        click.echo(f"The checkpoint was written to {written}.")
    elif seen is None and not fault and found.signed is None:
        click.echo(CAVEAT)
    if found.signed is not None and not fault:
        count = found.signed.number
        number = "the signed checkpoint" if count == 1 else f"{count} signed checkpoints"
        click.echo(f"It agrees with {number}, up to position {found.signed.agrees_to}.")


def _trust_of(
    home: Path, public_keys: Sequence[str], witnesses: Sequence[str] = (), tsa: Path | None = None
) -> Trust:
    """The given keys, else the lab's own. Raises BadInput if there are none."""
    keys = read_given_keys(public_keys) or SigningKeys(home).list_public_keys()
    if not keys:
        raise BadInput(
            "No public key was given to check the signatures.",
            remedy="Give --public-key FILE. The lab prints it with labos key show.",
        )
    return Trust(tuple(keys), tuple(read_given_keys(witnesses)), tsa)


def _compare_signed(log: Log, path: Path, home: Path, public_keys: Sequence[str]) -> CheckpointComparison:
    """Compare the log with the signed checkpoints in a file or folder. Raises BadInput, LogDamaged."""
    trust = _trust_of(home, public_keys)
    trusted = TrustedKeys(trust.keys, SigningKeys(home).read_rotations())
    return compare(log, read_tree_heads(path, trusted))


def _verify_bundle(file: Path, trust: Trust) -> None:
    """Check a bundle and report the result; exit code 1 if anything is wrong."""
    found = prove_bundle(file, trust)
    facts = {"whole": not found.faults, "fault": next(iter(found.faults), ""), "bundle": found}
    end_with_json(facts, int(bool(found.faults)))
    for part in found.parts:
        show_lines(part.faults or (part.result,))
    if found.faults:
        click.echo(f"The bundle does not prove the {found.kind} {found.subject}.")
        click.get_current_context().exit(1)
    click.echo(f"The bundle proves the {found.kind} {found.subject} of the lab {found.lab}.")


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

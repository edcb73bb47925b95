"""The checks of ``labos verify`` for signed checkpoints and bundles."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import click

from labos.cli._out import end_with_json, show_lines
from labos.errors import BadInput
from labos.services.log import Log
from labos.services.trust.compare import CheckpointComparison, compare, read_tree_heads
from labos.services.trust.keys import SigningKeys, TrustedKeys, read_given_keys
from labos.services.trust.proof import Trust, prove_bundle


def trust_of(
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


def compare_signed(log: Log, path: Path, home: Path, public_keys: Sequence[str]) -> CheckpointComparison:
    """Compare the log with the signed checkpoints in a file or folder. Raises BadInput, LogDamaged."""
    trust = trust_of(home, public_keys)
    trusted = TrustedKeys(trust.keys, SigningKeys(home).read_rotations())
    return compare(log, read_tree_heads(path, trusted))


def verify_bundle(file: Path, trust: Trust) -> None:
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

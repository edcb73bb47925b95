"""Compares a log with signed checkpoints that were kept elsewhere, and finds where it differs from them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import msgspec

from labos.errors import BadInput
from labos.services.log import Log
from labos.services.trust.checkpoints import TreeHead, compute_roots_at, parse_tree_head
from labos.services.trust.keys import TrustedKeys
from labos.services.trust.notes import MOST_BYTES, SIGNED, parse_note


class CheckpointComparison(msgspec.Struct, frozen=True):
    """The number of checkpoints, the position up to which the log agrees with them (0: with none), and the
    contradiction in one sentence; ``position`` is the first one that may differ."""

    number: int
    agrees_to: int
    fault: str = ""
    position: int = 0


def is_signed(path: Path) -> bool:
    """Whether a file is a signed checkpoint, or a folder of them; an unsigned checkpoint is a JSON object."""
    if path.is_dir():
        return True
    try:
        with path.open("rb") as file:
            return SIGNED in file.read(MOST_BYTES)
    except OSError:
        return False


def read_tree_heads(path: Path, trusted: TrustedKeys) -> list[TreeHead]:
    """The checkpoints in a file or a folder, the smallest first. Raises BadInput if one is not signed with a
    trusted key."""
    files = sorted(path.glob("*.note")) if path.is_dir() else [path]
    found = []
    for file in files:
        try:
            note = parse_note(file.read_bytes())
        except OSError as error:
            raise BadInput(f"{file} cannot be read: {error}.", remedy="Name another file.") from None
        head = parse_tree_head(note.text)
        if not trusted.find_signers(note, head):
            raise BadInput(
                f"{file} is not signed by a known key.",
                remedy="Give the public key that signed it: --public-key FILE.",
            )
        found.append(head)
    if not found:
        raise BadInput(f"{path} holds no checkpoints.", remedy="Name a folder of labos checkpoint.")
    return sorted(found, key=lambda head: head.size)


def compare(log: Log, heads: Sequence[TreeHead]) -> CheckpointComparison:
    """Compare the log with checkpoints, the smallest first. Raises LogDamaged, StoreUnavailable."""
    end = log.head().position
    roots = compute_roots_at(log, [head.size for head in heads])
    agrees_to = 0
    for head in heads:
        if head.size > end:
            fault = f"the log ends at position {end}, but a checkpoint of size {head.size} was signed: "
            fault += "its tail was cut off"
            return CheckpointComparison(len(heads), agrees_to, fault, end + 1)
        if roots.get(head.size) != head.root:
            fault = f"the records at positions {agrees_to + 1} to {head.size} were rewritten"
            return CheckpointComparison(len(heads), agrees_to, fault, agrees_to + 1)
        agrees_to = head.size
    return CheckpointComparison(len(heads), agrees_to)

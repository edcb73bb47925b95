"""The Merkle tree of a log: the part that is stored between two checkpoints.

Only the right edge is stored, in ``labos.tree`` of the lab's folder, together with the hash of the chain at
its end. If the log was rewritten or cut off meanwhile, it does not continue from this hash, and no further
checkpoint is signed.
"""

from __future__ import annotations

from pathlib import Path

import msgspec

from labos.core.envelope import GENESIS, check_chain
from labos.core.merkle import Edge, hash_leaf
from labos.errors import BadInput, LogDamaged
from labos.private import make_folder, replace_file
from labos.services.log import Log

TREE_FILE = "labos.tree"

_LOOK = (
    "Nothing was signed. Find out where: labos verify --checkpoint FOLDER, with your copies of the "
    "checkpoints. If the log was restored from an older copy on purpose, see docs/trust.md."
)


class StoredTree(msgspec.Struct, frozen=True):
    """A lab's tree up to a size: the chain's hash there and the hashes of the right edge, as hexadecimal
    digits."""

    lab: str = ""
    size: int = 0
    chain: str = ""
    edge: tuple[str, ...] = ()


class Growth(msgspec.Struct, frozen=True):
    """The earlier tree, and the hashes of the leaves that were added since."""

    before: Edge
    added: list[bytes]
    after: Edge
    kept: StoredTree


def read_tree(home: Path) -> StoredTree:
    """The stored tree; an empty tree if there is none. Raises BadInput."""
    path = home / TREE_FILE
    try:
        return msgspec.json.decode(path.read_bytes(), type=StoredTree)
    except FileNotFoundError:
        return StoredTree()
    except (OSError, msgspec.MsgspecError, UnicodeDecodeError) as error:
        raise BadInput(
            f"{path} cannot be read ({error}).", remedy="Remove it: LabOS makes it again from the log."
        ) from None


def store_tree(home: Path, tree: StoredTree) -> None:
    """Store a tree; it is synced to disk on return. Raises OSError."""
    make_folder(home)
    replace_file(home / TREE_FILE, msgspec.json.encode(tree) + b"\n")


def grow(log: Log, kept: StoredTree) -> Growth:
    """Read the records that were added to the log. Each is checked against the chain. Raises LogDamaged if
    one is wrong, or if the stored tree is of another log; StoreUnavailable."""
    head = log.head()
    try:
        before = Edge(kept.size, [bytes.fromhex(each) for each in kept.edge])
    except ValueError as error:
        raise BadInput(
            f"{TREE_FILE} contradicts itself ({error}).",
            remedy="Remove it: LabOS makes it again from the log.",
        ) from None
    previous = bytes.fromhex(kept.chain) if kept.size else GENESIS
    if kept.size:
        _check_same(log, kept, previous)
    after, added = before.copy(), []
    for record in check_chain(log.read(kept.size, head.position), previous, kept.size, _LOOK):
        leaf = hash_leaf(record.envelope)
        after.add(leaf)
        added.append(leaf)
        previous = record.hash
    if after.size != head.position:
        raise _report_damage(after.size + 1, "the record is missing")
    fresh = StoredTree(head.lab, after.size, previous.hex(), tuple(each.hex() for each in after.hashes))
    return Growth(before, added, after, fresh)


def _check_same(log: Log, kept: StoredTree, chain: bytes) -> None:
    head = log.head()
    if head.lab != kept.lab:
        raise _report_damage(1, f"the log is of the lab {head.lab}, the checkpoints are of {kept.lab}")
    if head.position < kept.size:
        raise _report_damage(
            head.position + 1, f"the log ends here, but a checkpoint of size {kept.size} was signed"
        )
    record = next(iter(log.read(kept.size - 1, kept.size)), None)
    if record is None or record.hash != chain:
        raise _report_damage(kept.size, "its hash has changed since the last checkpoint was signed")


def _report_damage(position: int, fault: str) -> LogDamaged:
    return LogDamaged(f"Position {position}: {fault}.", position=position, remedy=_LOOK)

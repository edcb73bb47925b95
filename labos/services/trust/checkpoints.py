"""Signed checkpoints (C2SP ``tlog-checkpoint``): the root of the Merkle tree over a log at a size."""

from __future__ import annotations

import base64
import binascii
from collections.abc import Iterable

import msgspec

from labos.core.merkle import Edge, hash_leaf
from labos.errors import BadInput
from labos.services.log import Log
from labos.services.trust.notes import Note, SigningKey


class TreeHead(msgspec.Struct, frozen=True):
    """The head of a tree: its log, its number of leaves, its root. The leaf of position p has the index p -
    1."""

    origin: str
    size: int
    root: bytes

    @property
    def text(self) -> str:
        return f"{self.origin}\n{self.size}\n{base64.b64encode(self.root).decode()}\n"


def parse_tree_head(text: str) -> TreeHead:
    """The content of a checkpoint. Lines after the third are ignored. Raises BadInput."""
    try:
        origin, number, root, *_ = text.splitlines()
        size = int(number)
        raw = base64.b64decode(root, validate=True)
        if origin and number == str(size) and size >= 0 and len(raw) == 32:
            return TreeHead(origin, size, raw)
    except (ValueError, binascii.Error):
        pass
    raise BadInput(
        "The text of the note is not a checkpoint.",
        remedy="A checkpoint has three lines: origin, size and root.",
    )


def sign_tree(head: TreeHead, key: SigningKey) -> Note:
    return Note(head.text, (key.sign(head.text),))


def compute_roots_at(log: Log, sizes: Iterable[int]) -> dict[int, bytes]:
    """The roots of the log's tree at some sizes; sizes larger than the log are left out. Reads the log from
    its beginning. Raises StoreUnavailable, LogDamaged."""
    wanted = sorted(set(sizes))
    edge = Edge()
    found = {0: edge.compute_root()} if 0 in wanted else {}
    for record in log.read(0, wanted[-1] if wanted else 0):
        edge.add(hash_leaf(record.envelope))
        if edge.size in wanted:
            found[edge.size] = edge.compute_root()
    return found

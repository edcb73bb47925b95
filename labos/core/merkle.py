"""The Merkle tree over a log, and proofs about it (RFC 6962, section 2.1).

Leaf ``i`` is the envelope of the record at position ``i + 1``, byte for byte as it is stored. The envelope
names its payload by digest, so the tree covers payloads too, and a proof needs no payload. Hashes are 32
bytes.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable, Sequence

Range = tuple[int, int]
"""A range of leaves: from the first number up to, but without, the second."""

EMPTY_ROOT = hashlib.sha256().digest()
"""The root of a tree without leaves."""


def hash_leaf(data: bytes) -> bytes:
    return hashlib.sha256(b"\x00" + data).digest()


def hash_node(left: bytes, right: bytes) -> bytes:
    return hashlib.sha256(b"\x01" + left + right).digest()


class Edge:
    """The right edge of a tree: the hashes of its perfect subtrees, the largest first. It is enough to add
    leaves and to compute the root, and has at most 64 hashes for a log of any length."""

    def __init__(self, size: int = 0, hashes: Sequence[bytes] = ()) -> None:
        """Raises ValueError if these hashes do not fit a tree of that size."""
        if size < 0 or len(hashes) != size.bit_count() or any(len(each) != 32 for each in hashes):
            raise ValueError(f"a tree of {size} leaves has no such right edge")
        self.size = size
        self.hashes = list(hashes)

    def add(self, leaf: bytes) -> None:
        """Add a leaf, given by its hash."""
        found, size = leaf, self.size
        while size & 1:
            found = hash_node(self.hashes.pop(), found)
            size >>= 1
        self.hashes.append(found)
        self.size += 1

    def compute_root(self) -> bytes:
        if not self.hashes:
            return EMPTY_ROOT
        found = self.hashes[-1]
        for left in reversed(self.hashes[:-1]):
            found = hash_node(left, found)
        return found

    def copy(self) -> Edge:
        return Edge(self.size, self.hashes)

    def list_ranges(self) -> list[Range]:
        """The leaves under each of ``hashes``."""
        found, start = [], 0
        for level in reversed(range(self.size.bit_length())):
            if self.size >> level & 1:
                found.append((start, start + (1 << level)))
                start += 1 << level
        return found


def compute_root(leaves: Iterable[bytes]) -> bytes:
    """The root over the hashes of leaves."""
    edge = Edge()
    for leaf in leaves:
        edge.add(leaf)
    return edge.compute_root()


class Tree:
    """All hashes of a tree, for many proofs about it: 64 bytes per leaf."""

    def __init__(self, leaves: Iterable[bytes]) -> None:
        self._levels = [list(leaves)]
        while len(below := self._levels[-1]) > 1:
            self._levels.append([hash_node(*below[at : at + 2]) for at in range(0, len(below) - 1, 2)])

    @property
    def size(self) -> int:
        return len(self._levels[0])

    def hash_of(self, leaves: Range) -> bytes:
        """The hash over a range that is a node of a tree."""
        start, end = leaves
        if start == end:
            return EMPTY_ROOT
        level = (end - start).bit_length() - 1
        if end - start == 1 << level and not start & (end - start - 1):
            return self._levels[level][start >> level]
        middle = start + _split(end - start)
        return hash_node(self.hash_of((start, middle)), self.hash_of((middle, end)))

    def compute_root(self, size: int | None = None) -> bytes:
        """The root of the tree, or of its first ``size`` leaves."""
        return self.hash_of((0, self.size if size is None else size))


# -- proofs -------------------------------------------------------------------------------------


def list_inclusion_ranges(index: int, size: int) -> list[Range]:
    """The nodes whose hashes prove that a leaf is in a tree (PATH). Raises ValueError if the tree has no such
    leaf."""
    if not 0 <= index < size:
        raise ValueError(f"a tree of {size} leaves has no leaf {index}")
    found: list[Range] = []
    start, end = 0, size
    while end - start > 1:
        middle = start + _split(end - start)
        if index < middle:
            found.append((middle, end))
            end = middle
        else:
            found.append((start, middle))
            start = middle
    return found[::-1]


def list_consistency_ranges(old: int, size: int) -> list[Range]:
    """The nodes whose hashes prove that a tree begins with the tree of ``old`` leaves (PROOF). Raises
    ValueError if the tree is smaller."""
    if not 0 <= old <= size:
        raise ValueError(f"a tree of {size} leaves does not begin with one of {old}")
    if old in (0, size):
        return []
    found: list[Range] = []
    start, end, whole = 0, size, True
    while old != end:
        middle = start + _split(end - start)
        if old <= middle:
            found.append((middle, end))
            end = middle
        else:
            found.append((start, middle))
            start, whole = middle, False
    if not whole:
        found.append((start, end))
    return found[::-1]


def make_proof(ranges: Iterable[Range], hash_of: Callable[[Range], bytes]) -> list[bytes]:
    return [hash_of(each) for each in ranges]


def make_growth_proof(old: Edge, added: Sequence[bytes]) -> list[bytes]:
    """The consistency proof from a tree to a larger one. It needs only the right edge of the old tree and the
    hashes of the new leaves."""
    known = dict(zip(old.list_ranges(), old.hashes, strict=True))

    def hash_of(leaves: Range) -> bytes:
        start, end = leaves
        return known.get(leaves) or compute_root(added[start - old.size : end - old.size])

    return make_proof(list_consistency_ranges(old.size, old.size + len(added)), hash_of)


def is_included(leaf: bytes, index: int, size: int, root: bytes, proof: Sequence[bytes]) -> bool:
    """Whether a proof shows that the leaf with this hash is at ``index`` of the tree."""
    if not 0 <= index < size:
        return False
    ranges = list_inclusion_ranges(index, size)
    if len(ranges) != len(proof):
        return False
    found = leaf
    for (start, _), other in zip(ranges, proof, strict=True):
        found = hash_node(found, other) if start > index else hash_node(other, found)
    return found == root


def is_consistent(old: int, old_root: bytes, size: int, root: bytes, proof: Sequence[bytes]) -> bool:
    """Whether a proof shows that a tree begins with the leaves of an older one."""
    if not 0 <= old <= size:
        return False
    if old == size:
        return not proof and old_root == root
    if old == 0:
        return not proof and old_root == EMPTY_ROOT
    ranges = list_consistency_ranges(old, size)
    if len(proof) != len(ranges):
        return False
    rest = list(zip(ranges, proof, strict=True))
    if ranges[0][1] == old:  # the part that both trees share is given; otherwise it is the old tree itself
        first, rest = rest[0][1], rest[1:]
    else:
        first = old_root
    older = newer = first
    for (start, _), other in rest:
        if start >= old:
            newer = hash_node(newer, other)
        else:
            older, newer = hash_node(other, older), hash_node(other, newer)
    return older == old_root and newer == root


def _split(width: int) -> int:
    """The largest power of two that is smaller than a width."""
    return 1 << (width - 1).bit_length() - 1

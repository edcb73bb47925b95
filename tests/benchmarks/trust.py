"""What a signed checkpoint and a bundle's proofs cost, by the length of the log; none of it is the kernel's
work.

The bare limit is what the kernel's own check of the chain costs: the same records, in memory, by
``labos.core.envelope.find_damage``.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator

import msgspec

from labos.core.envelope import GENESIS, Record, find_damage, seal
from labos.core.merkle import Tree, list_inclusion_ranges, make_proof
from labos.ports import Head
from labos.services.trust.tree import StoredTree, grow
from tests.benchmarks.figures import Figure, Report, median, times
from tests.unit.services.logbook import two_users

SIZE = 100_000
NEW = 1_000
ROUNDS = 3


class Kept:
    """A log in memory."""

    def __init__(self, records: list[Record]) -> None:
        self._records = records

    def head(self) -> Head:
        last = self._records[-1]
        return Head(last.head.lab, len(self._records), last.hash, 1)  # type: ignore[arg-type]

    def read(self, after: int = 0, upto: int | None = None) -> Iterator[Record]:
        return iter(self._records[after:upto])


def measure() -> Report:
    return _measure(SIZE, NEW)


def smoke() -> Report:
    return _measure(400, 40)


def _measure(size: int, new: int) -> Report:
    records = _records(size)
    log = Kept(records)
    begun = grow(Kept(records[: size - new]), StoredTree()).kept  # type: ignore[arg-type]
    bare = _cost(lambda: _check(records[-new:], records[-new - 1].hash)) / new
    whole = _cost(lambda: grow(log, StoredTree())) / size  # type: ignore[arg-type]
    added = _cost(lambda: grow(log, begun)) / new  # type: ignore[arg-type]
    leaves = grow(log, StoredTree()).added  # type: ignore[arg-type]
    tree = Tree(leaves)
    proof = (
        _cost(lambda: [make_proof(list_inclusion_ranges(at, size), tree.hash_of) for at in range(100)]) / 100
    )
    made = _cost(lambda: Tree(leaves))
    return Report(
        [
            Figure(
                f"checkpoint behind {new:,} new events of {size:,}",
                _micro(added),
                _micro(bare),
                times(added / bare),
            ),
            Figure(f"first checkpoint of {size:,} events", _micro(whole), _micro(bare), times(whole / bare)),
            Figure(f"proof of one event among {size:,}", _micro(proof)),
            Figure(f"tree of {size:,} events for proofs", f"{made * 1e3:.0f} ms"),
        ],
        ["An event of a checkpoint is read, checked against the chain, and added to the tree's right edge."],
    )


def _records(size: int) -> list[Record]:
    told = two_users().records
    found: list[Record] = []
    previous = GENESIS
    for position in range(1, size + 1):
        like = told[position % len(told)]
        head = msgspec.structs.replace(like.head, position=position)
        found.append(seal(previous, head, like.payload))
        previous = found[-1].hash
    return found


def _check(records: list[Record], previous: bytes) -> None:
    for record in records:
        assert not find_damage(previous, record)
        previous = record.hash


def _cost(work: Callable[[], object]) -> float:
    took = []
    for _ in range(ROUNDS):
        before = time.process_time()
        work()
        took.append(time.process_time() - before)
    return median(took)


def _micro(seconds: float) -> str:
    return f"{seconds * 1e6:.1f} µs"

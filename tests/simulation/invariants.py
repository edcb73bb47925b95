"""A lab's log folded anew, and looked at on the way."""

from __future__ import annotations

from collections.abc import Sequence

from labos.core.envelope import Record
from labos.core.fold import evolve
from labos.core.invariants import find_broken
from labos.core.registry import decode
from labos.core.state import LabState


def fold_again(records: Sequence[Record]) -> LabState:
    """The state that a log leads to. Each invariant holds wherever a turn of the kernel ended: what it
    decided at once is written at once."""
    state = LabState()
    for number, record in enumerate(records):
        head = record.head
        evolve(state, decode(head.type, head.schema, record.payload), head.position, head.recorded_at)
        last = number + 1 == len(records) or records[number + 1].head.recorded_at != head.recorded_at
        if last:
            assert find_broken(state) == "", f"after event {head.position}"
    return state

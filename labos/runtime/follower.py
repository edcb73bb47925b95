"""Keeps step with a log that another kernel writes, to take its place without folding it all.

Nothing is written here, and nobody is kept waiting: what is new is read now and then.
"""

from __future__ import annotations

from labos.core.envelope import GENESIS
from labos.core.state import LabState
from labos.ports import EventStore
from labos.runtime.ledger import load


class Follower:
    """The folded log as far as it has been read, and the hash of the last record that was."""

    def __init__(self, store: EventStore) -> None:
        self._store = store
        self.state = LabState()
        self._hash = GENESIS

    def catch_up(self) -> int:
        """Read what is new; returns how many events that were. A log that is another one than it was (a
        backup was put back) is read from its beginning. Raises StoreUnavailable, LogTooNew, LogDamaged."""
        if not self._is_still_same():
            self.state, self._hash = LabState(), GENESIS
        self.state, number = load(self._store, begin=self.state)
        if number or self._hash == GENESIS:
            self._hash = self._hash_at(self.state.position)
        return number

    def hand_over(self) -> LabState | None:
        """The state, to be folded on by a kernel; None if the log is another one than it was. The
        follower begins anew afterwards."""
        state = self.state if self.state.position and self._is_still_same() else None
        self.state, self._hash = LabState(), GENESIS
        return state

    def _is_still_same(self) -> bool:
        return self._hash_at(self.state.position) == self._hash

    def _hash_at(self, position: int) -> bytes:
        """The hash that the log bears at a position; empty if it does not reach so far."""
        if not position:
            return GENESIS
        found = next(iter(self._store.read(after=position - 1, upto=position)), None)
        return found.hash if found is not None else b""

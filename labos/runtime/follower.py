"""Follows a log that another kernel writes, so that a takeover need not fold the whole log.

Nothing is written here, and no process waits for it: new events are read from time to time.
"""

from __future__ import annotations

from labos.core.envelope import GENESIS
from labos.core.state import LabState
from labos.ports import EventStore
from labos.runtime.ledger import find_hash, load


class Follower:
    """The folded log as far as it has been read, and the hash of the last record read."""

    def __init__(self, store: EventStore) -> None:
        self._store = store
        self.state = LabState()
        self._hash = GENESIS

    def catch_up(self) -> int:
        """Read new events; returns their number. If the log was replaced by another one (a backup was
        restored), it is read from its beginning. Raises StoreUnavailable, LogTooNew, LogDamaged."""
        if not self._is_still_same():
            self.state, self._hash = LabState(), GENESIS
        self.state, number = load(self._store, begin=self.state)
        if number or self._hash == GENESIS:
            self._hash = find_hash(self._store, self.state.position)
        return number

    def hand_over(self) -> LabState | None:
        """The state, on which a kernel continues to fold; None if the log was replaced by another one.
        Afterwards the follower starts from the beginning."""
        state = self.state if self.state.position and self._is_still_same() else None
        self.state, self._hash = LabState(), GENESIS
        return state

    def _is_still_same(self) -> bool:
        return find_hash(self._store, self.state.position) == self._hash

"""Limits the number of attempts to sign in."""

from __future__ import annotations

from collections import OrderedDict, deque

WITHIN_S = 60.0
OF_USER = 5
"""Attempts in a minute for one user from one address."""
OF_ADDRESS = 20
OF_ALL = 60
"""Attempts in a minute in all: each costs 0.2 s of a processor, which the kernel needs too."""
MOST_KEYS = 10_000


class Tries:
    """Counts attempts in the last minute, successful ones too. Times are seconds of any monotonic clock."""

    def __init__(self) -> None:
        self._seen: OrderedDict[tuple[str, ...], deque[float]] = OrderedDict()

    def wait_s(self, user: str, address: str, now: float) -> float:
        """Note an attempt; returns 0 if it may be made, else how many seconds to wait. An attempt that may
        not be made is not counted."""
        keys = ((), OF_ALL), ((address,), OF_ADDRESS), ((user, address), OF_USER)
        wait = max(self._wait(key, most, now) for key, most in keys)
        if wait <= 0:
            for key, _ in keys:
                self._find_times(key).append(now)
        return wait

    def _wait(self, key: tuple[str, ...], most: int, now: float) -> float:
        times = self._find_times(key)
        while times and times[0] <= now - WITHIN_S:
            times.popleft()
        return times[-most] + WITHIN_S - now if len(times) >= most else 0.0

    def _find_times(self, key: tuple[str, ...]) -> deque[float]:
        """The times of a key's attempts; if there are too many keys, the one used least recently is
        removed."""
        found = self._seen.setdefault(key, deque())
        self._seen.move_to_end(key)
        if len(self._seen) > MOST_KEYS:
            self._seen.popitem(last=False)
        return found

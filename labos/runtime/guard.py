"""Protects the lab from faults of LabOS: an operation that fails is not tried without end.

A turn that raises is undone completely. For that, the end of the log has to be read again, so a failed
operation must not fail again at every heartbeat.
"""

from __future__ import annotations

from collections import OrderedDict

import msgspec

from labos.core.decide import Command

LIMIT = 3
FIRST_PAUSE_S = 0.5
LONGEST_PAUSE_S = 300.0
REMEMBERED = 1000


class CircuitBreaker:
    """Suspends an operation that has failed ``LIMIT`` times in a row. It is tried again after a pause, which
    doubles with each failure. Times are seconds of a monotonic clock."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.why = ""
        """The text of the last failure; empty after a success."""
        self.retry_at: float | None = None
        self._failures = 0

    @property
    def is_open(self) -> bool:
        """Whether the operation is suspended."""
        return self._failures >= LIMIT

    def allows(self, now: float, is_retry: bool) -> bool:
        """Whether it may be tried: always while it is not suspended, else only as a retry after its pause."""
        if not self.is_open:
            return True
        return is_retry and self.retry_at is not None and now >= self.retry_at

    def record_failure(self, now: float, why: str) -> None:
        self._failures += 1
        self.why = why
        self.retry_at = now + pause_s(self._failures)

    def record_success(self) -> None:
        self._failures = 0
        self.why = ""
        self.retry_at = None


class FaultyCommands:
    """Commands whose turn failed. The same command is refused for a while, so that a repeated message does
    not make the kernel read its log again each time. Only the latest ``REMEMBERED`` are known."""

    def __init__(self) -> None:
        self._known: OrderedDict[bytes, tuple[int, float, str]] = OrderedDict()

    def explain_refusal(self, command: Command, now: float) -> str:
        """The text of its last failure, while it may not be tried again; empty if it may."""
        while self._known:
            key, (_, until, _) = next(iter(self._known.items()))
            if now - until < LONGEST_PAUSE_S:
                break
            del self._known[key]
        if not self._known:
            return ""
        _, until, why = self._known.get(_make_key(command), (0, 0.0, ""))
        return why if now < until else ""

    def record(self, command: Command, now: float, why: str) -> None:
        key = _make_key(command)
        failures = self._known.pop(key, (0, 0.0, ""))[0] + 1
        self._known[key] = (failures, now + pause_s(failures), why)
        if len(self._known) > REMEMBERED:
            self._known.popitem(last=False)


def pause_s(failures: int) -> float:
    """How long to wait after so many failures in a row."""
    return float(min(FIRST_PAUSE_S * 2.0 ** min(failures - 1, 20), LONGEST_PAUSE_S))


def _make_key(command: Command) -> bytes:
    """A key that is the same for a repeated command, whatever its time."""
    fields = {name: getattr(command, name) for name in command.__struct_fields__ if name != "now"}
    try:
        return type(command).__name__.encode() + msgspec.msgpack.encode(fields)
    except (ValueError, TypeError, OverflowError, RecursionError):
        return repr(command)[:4000].encode(errors="replace")

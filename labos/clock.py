"""The only place where LabOS reads a clock, or makes an id or a salt."""

from __future__ import annotations

import secrets
import time
from typing import Protocol

import uuid_utils


class Clock(Protocol):
    """Wall time for records, monotonic time for waiting."""

    def now_ns(self) -> int:
        """UTC, nanoseconds since 1970."""

    def monotonic(self) -> float:
        """Seconds from an arbitrary start; never goes back."""


class Ids(Protocol):
    """A source of ids that sort by the time they were made."""

    def new(self) -> str: ...


class SystemClock:
    """The machine's own clock."""

    def now_ns(self) -> int:
        return time.time_ns()

    def monotonic(self) -> float:
        return time.monotonic()


def new_salt() -> bytes:
    """16 bytes that cannot be guessed."""
    return secrets.token_bytes(16)


class Uuid7Ids:
    """UUIDv7 (RFC 9562): unique without coordination, ordered by time."""

    def new(self) -> str:
        return str(uuid_utils.uuid7())

"""Calibrations of modules: what people recorded, and until when it is valid. Nothing waits for one."""

from __future__ import annotations

from collections.abc import Mapping

import msgspec

from labos.core.days import count_days, day_of

MOST_CALIBRATIONS = 50
"""So many things of one module can be calibrated."""

WARN_DAYS = 14
"""So long before its last day a calibration is said to expire."""


class Calibration(msgspec.Struct, frozen=True):
    """A calibration of a module, or of one thing of it: who recorded it and when (UTC ns), its certificate,
    the digest of its report, and its last day (``2027-01-01``, by UTC). What nobody said is empty."""

    at: int
    by: str
    certificate: str = ""
    file: str = ""
    until: str = ""

    def has_expired(self, now: int) -> bool:
        """Whether its last day is over at a moment in UTC ns."""
        return bool(self.until) and self.until < day_of(now)

    def expires_soon(self, now: int) -> bool:
        """Whether its last day is over, or at most ``WARN_DAYS`` away."""
        return bool(self.until) and count_days(day_of(now), self.until) <= WARN_DAYS


def find_first_expiry(calibrations: Mapping[str, Calibration]) -> str:
    """The last day of the one that expires first; empty if none does."""
    return min((one.until for one in calibrations.values() if one.until), default="")

"""Calibrations of modules: the records of people, with their last day of validity. No step waits for a
calibration."""

from __future__ import annotations

from collections.abc import Mapping

import msgspec

from labos.core.days import count_days, day_of

MOST_CALIBRATIONS = 50
"""The most calibrations that one module may have."""

WARN_DAYS = 14
"""LabOS warns this long before the last day of a calibration."""


class Calibration(msgspec.Struct, frozen=True):
    """A calibration of a module, or of one thing of it: who recorded it and when (UTC ns), its certificate,
    the digest of its report, and its last day (``2027-01-01``, by UTC). Fields without a value are empty."""

    at: int
    by: str
    certificate: str = ""
    file: str = ""
    until: str = ""

    def has_expired(self, now: int) -> bool:
        """Whether its last day is over at ``now`` (UTC ns)."""
        return bool(self.until) and self.until < day_of(now)

    def expires_soon(self, now: int) -> bool:
        """Whether its last day is over, or at most ``WARN_DAYS`` away."""
        return bool(self.until) and count_days(day_of(now), self.until) <= WARN_DAYS


def find_first_expiry(calibrations: Mapping[str, Calibration]) -> str:
    """The earliest last day of the calibrations; empty if none has one."""
    return min((one.until for one in calibrations.values() if one.until), default="")

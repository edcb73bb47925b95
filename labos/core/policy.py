"""The lab's policy: submissions that wait for an operator's approval, the highest priority, the limits of
bookings, and the erasure of words."""

from __future__ import annotations

import msgspec

from labos.core.campaigns import Budget
from labos.core.registry import Event, event


class BookingLimits(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The limits for bookings of a user who is no operator there: ``hours`` of one booking (null: any),
    ``total_hours`` of all future bookings together, and the number of ``days_ahead``."""

    hours: float | None = None
    total_hours: float = 24.0
    days_ahead: int = 14


class Policy(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The submissions that need an approval: those of ``programs`` (service accounts that are not
    ``trusted``); the first ``newcomers`` submissions of a user; those with ``dangerous`` steps; those
    ``above`` a budget; campaigns with ``deadlines``. With ``own``, operators may approve their own
    submissions. With ``erasure``, words are erased only after a second admin has agreed. ``priority`` is the
    highest for a user who is no operator and whose quota sets none (null: any). ``bookings`` limits the
    bookings of such a user."""

    programs: bool = True
    trusted: tuple[str, ...] = ()
    newcomers: int = 0
    dangerous: bool = False
    above: Budget = Budget()
    deadlines: bool = False
    own: bool = False
    erasure: bool = False
    priority: int | None = None
    bookings: BookingLimits = BookingLimits()

    @property
    def depends_on_content(self) -> bool:
        """Whether an approval may depend on the user, the steps, the amounts or the terms of a submission."""
        return bool(self.newcomers or self.dangerous or self.deadlines or self.above != Budget())


@event("policy.applied")
class PolicyApplied(Event, frozen=True):
    """A policy file (``digest``) was applied; this policy is valid from now on."""

    digest: str
    policy: Policy

    def stream(self) -> str:
        return "policy"

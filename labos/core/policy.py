"""Which submissions wait for an operator's approval, how high a priority may be, what may be booked, and who
erases words."""

from __future__ import annotations

import msgspec

from labos.core.campaigns import Budget
from labos.core.registry import Event, event


class BookingLimits(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """What a user who is no operator there may book: ``hours`` of one booking (null: any), ``total_hours``
    that are still to come, of all bookings together, and so many ``days_ahead``."""

    hours: float | None = None
    total_hours: float = 24.0
    days_ahead: int = 14


class Policy(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """What waits for an approval: what ``programs`` (service accounts that are not ``trusted``) submit; the
    first ``newcomers`` submissions of a user; what does something ``dangerous``; what is ``above`` a budget;
    campaigns with ``deadlines``. With ``own``, an operator may approve what is the operator's own. With
    ``erasure``, words are erased only when a second admin has agreed. ``priority`` is the highest that
    somebody may give who is no operator and whose quota names none (null: any). ``bookings`` limits what
    such a user books."""

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


@event("policy.applied")
class PolicyApplied(Event, frozen=True):
    """From now on this policy holds, as a file (``digest``) says."""

    digest: str
    policy: Policy

    def stream(self) -> str:
        return "policy"

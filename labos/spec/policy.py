"""Policy files: the submissions that wait for an approval, the highest priority, and the limits of
bookings."""

from __future__ import annotations

import msgspec
from pydantic import Field

from labos.core.campaigns import Budget
from labos.core.policy import BookingLimits, Policy
from labos.core.structs import make_from
from labos.spec.campaign import BudgetEntry
from labos.spec.findings import FindingList, Remarks
from labos.spec.parts import Label, Part, Version
from labos.spec.source import parse
from labos.spec.validation import expect_valid


class BookingsEntry(Part):
    """Limits for bookings of users who are not operators. ``total_hours`` are all future hours together; the
    default is 24, or the limit for one booking if that is more."""

    hours: float | None = Field(default=None, gt=0, le=8_784)
    """hours of one booking; as many as for all together, if left out"""
    total_hours: float | None = Field(default=None, gt=0, le=1_000_000)
    """future hours of all bookings together"""
    days_ahead: int = Field(default=14, ge=1, le=366)
    """the number of days in advance within which a booking may begin"""


class PolicyFile(Part):
    """A policy file. The defaults are as in a lab without a policy: only submissions of programs need an
    approval."""

    labos: Version
    programs: bool = True
    """whether submissions of service accounts need an approval"""
    trusted: list[Label] = []
    """service accounts whose submissions need no approval"""
    newcomers: int = Field(default=0, ge=0, le=1_000)
    """the number of a user's approved submissions after which others need no approval"""
    dangerous: bool = False
    """whether submissions with dangerous steps need an approval"""
    above: BudgetEntry = BudgetEntry()
    """submissions that use more than this need an approval"""
    deadlines: bool = False
    """whether campaigns with a deadline need an approval"""
    own: bool = False
    """whether operators may approve their own submissions"""
    erasure: bool = False
    """whether people's words are erased only after a second admin has agreed"""
    priority: int | None = Field(default=None, ge=-100_000, le=100_000)
    """the highest priority for users who are not operators and have no quota for it"""
    bookings: BookingsEntry = BookingsEntry()
    """limits for bookings of users who are not operators"""


class CompiledPolicy(msgspec.Struct, frozen=True):
    """The policy as the core has it; ``digest`` is the file's."""

    digest: str
    policy: Policy


def parse_policy(text: str, name: str = "") -> CompiledPolicy:
    """Read a policy file given as text. Raises SpecError, SpecErrors."""
    source = parse(text, name)
    report = FindingList(name)
    remarks = Remarks(source, report)
    file = expect_valid(PolicyFile, source, report)
    if file.trusted and not file.programs:
        what = "Programs need no approval, so a list of trusted programs has no effect."
        remarks.error(what, ("trusted",), "Leave it out, or write `programs: true`.", key=True)
    booked = file.bookings
    if booked.hours and booked.total_hours and booked.hours > booked.total_hours:
        what = (
            f"One booking may have {booked.hours:g} hours, but all bookings together only "
            f"{booked.total_hours:g}."
        )
        remarks.error(what, ("bookings", "hours"), "Give a larger `total_hours`.")
    report.raise_if_failed()
    above = Budget(file.above.runs, file.above.lab_time, dict(file.above.consumables))
    policy = make_from(
        Policy, file, trusted=tuple(dict.fromkeys(file.trusted)), above=above, bookings=_make_limits(booked)
    )
    return CompiledPolicy(source.digest, policy)


def _make_limits(entry: BookingsEntry) -> BookingLimits:
    usual = BookingLimits()
    total = max(usual.total_hours, entry.hours or 0.0) if entry.total_hours is None else entry.total_hours
    return BookingLimits(entry.hours, total, entry.days_ahead)

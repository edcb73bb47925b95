"""Shares files: weights and quotas of groups and users."""

from __future__ import annotations

from typing import Annotated

import msgspec
from pydantic import Field

from labos.core.shares import Group, Member
from labos.spec.findings import FindingList
from labos.spec.parts import Label, Part, Version
from labos.spec.source import parse
from labos.spec.validation import expect_valid

Weight = Annotated[float, Field(gt=0, le=1_000_000)]


class QuotaEntry(Part):
    """Limits; a value that is left out, or 0, means no limit."""

    running: int = Field(default=0, ge=0)
    """started runs at the same time"""
    queued: int = Field(default=0, ge=0)
    """waiting runs at the same time"""
    lab_hours: float = Field(default=0.0, ge=0)
    """module hours in seven days"""
    consumables: dict[Label, Annotated[float, Field(ge=0)]] = {}
    """amounts in seven days by kind, in the unit of each"""
    priority: int | None = Field(default=None, ge=-100_000, le=100_000)
    """the highest priority that may be given; any, if left out"""


class MemberEntry(Part):
    """A user: the weight among the users of the same list, and a quota."""

    weight: Weight = 1.0
    """the user's part of the group's share, relative to the weights of its other members"""
    quota: QuotaEntry = QuotaEntry()
    """the user's limits"""


class GroupEntry(Part):
    """Users who share one part of the lab, with common limits."""

    weight: Weight = 1.0
    """its share of the lab, relative to the weights of others"""
    members: dict[Label, MemberEntry] = Field(min_length=1)
    """its users, by name"""
    quota: QuotaEntry = QuotaEntry()
    """their common limits"""


class SharesFile(Part):
    """A shares file. A user who is not in it forms a group alone, with weight 1."""

    labos: Version
    groups: dict[Label, GroupEntry] = {}
    """groups of users, by name"""
    users: dict[Label, MemberEntry] = {}
    """users who are in no group, each as a group alone"""


class CompiledShares(msgspec.Struct, frozen=True):
    """Weights and quotas as the core has them; ``digest`` is the file's."""

    digest: str
    groups: tuple[Group, ...]
    users: dict[str, Member]


def parse_shares(text: str, name: str = "") -> CompiledShares:
    """Read a shares file given as text. Raises SpecError, SpecErrors."""
    source = parse(text, name)
    report = FindingList(name)
    file = expect_valid(SharesFile, source, report)
    homes: dict[str, str] = {}
    named = [
        (("groups", g, "members", user), g) for g, entry in file.groups.items() for user in entry.members
    ]
    for path, group in [*named, *((("users", user), "") for user in file.users)]:
        user = path[-1]
        if user in homes:
            what = f"{user!r} is in the group {homes[user]!r} already."
            place, field = source.place(path, key=True), source.name_field(path[:-1])
            report.error(what, place, field=field, remedy="Name each user once.")
        homes[user] = group
    report.raise_if_failed()
    written = file.model_dump()
    groups = [{"name": name, **entry} for name, entry in written["groups"].items()]
    return CompiledShares(
        source.digest,
        msgspec.convert(groups, tuple[Group, ...]),
        msgspec.convert(written["users"], dict[str, Member]),
    )

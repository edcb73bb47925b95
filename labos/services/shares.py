"""The ledger: the share of the lab that each user should have, and the share that each has used."""

from __future__ import annotations

import msgspec

from labos.core.shares import Member, Quota, Workload
from labos.core.state import LabState


class ShareAccount(msgspec.Struct, frozen=True):
    """A user. ``wanted`` and ``had`` are parts of the whole; use counts half after a day. ``lab_hours`` and
    ``consumables`` are those of the last seven days."""

    user: str
    group: str
    weight: float
    wanted: float
    had: float
    lab_hours: float
    consumables: dict[str, float]
    running: int
    queued: int
    quota: Quota


def make_ledger(state: LabState, now: int) -> list[ShareAccount]:
    """All users who are named in the shares file or have used the lab, by group and name."""
    shares = state.shares
    users = sorted({*shares.members, *shares.usage, *shares.had})
    groups: dict[str, list[str]] = {}
    for user in users:
        groups.setdefault(shares.group_of.get(user, f"\0{user}"), []).append(user)
    weights = {name: _find_weight(state, name, members) for name, members in groups.items()}
    levels = {user: usage.compute_level(now) for user, usage in shares.usage.items()}
    whole, used = sum(weights.values()), sum(levels.values())
    accounts = []
    for name, members in groups.items():
        among = sum(shares.find_member(user).weight for user in members)
        for user in members:
            member, had = shares.find_member(user), shares.had.get(user, Workload())
            accounts.append(
                ShareAccount(
                    user=user,
                    group=shares.group_of.get(user, ""),
                    weight=member.weight,
                    wanted=weights[name] / whole * member.weight / among,
                    had=levels.get(user, 0.0) / used if used else 0.0,
                    lab_hours=had.week.sum_lab_ns(now) * state.lab.pace / 3.6e12,
                    consumables={kind: had.week.count_used(kind, now) for kind in _list_kinds(had)},
                    running=had.running,
                    queued=had.queued,
                    quota=member.quota,
                )
            )
    return sorted(accounts, key=lambda account: (account.group, account.user))


def _find_weight(state: LabState, name: str, members: list[str]) -> float:
    group = state.shares.groups.get(name)
    return group.weight if group is not None else state.shares.members.get(members[0], Member()).weight


def _list_kinds(had: Workload) -> list[str]:
    return sorted({kind for kinds in had.week.consumed.values() for kind in kinds})

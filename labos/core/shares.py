"""The shares and quotas of users and groups, and the lab time that they have used."""

from __future__ import annotations

import msgspec

from labos.core.actions import ActionEnd, ActionRequested
from labos.core.ids import ActionId, RunId
from labos.core.registry import Event, event
from labos.core.resources import ResourceConsumed
from labos.core.runs import RunEnd, RunStarted, RunSubmitted
from labos.core.users import GroupAdded, GroupRemoved, MemberAdded, MemberRemoved

DAY_NS = 24 * 3600 * 1_000_000_000
HALF_LIFE_NS = DAY_NS
"""Used lab time counts half after a day."""

WEEK_DAYS = 7
"""A week of a quota is the last seven days, today included, by UTC."""


class Quota(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Limits for a user or group (0: no limit): the number of started runs and of waiting runs at the same
    time; lab hours and consumables by kind per week. Started runs count by their plans. ``priority`` is the
    highest that may be given (null: any)."""

    running: int = 0
    queued: int = 0
    lab_hours: float = 0.0
    consumables: dict[str, float] = {}
    priority: int | None = None


class Member(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A user's weight within the group, and the user's own quota."""

    weight: float = 1.0
    quota: Quota = Quota()


class Group(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Users who share one part of the lab. The quota limits all of them together."""

    name: str
    weight: float = 1.0
    members: dict[str, Member] = {}
    quota: Quota = Quota()


@event("shares.applied")
class SharesApplied(Event, frozen=True):
    """A shares file (``digest``) with weights and quotas was applied. A user who is in none of the ``groups``
    forms a group alone, with weight 1 unless ``users`` gives another weight. Groups that the file does not
    name are removed, except those from ``group.added``."""

    digest: str
    groups: tuple[Group, ...] = ()
    users: dict[str, Member] = {}

    def stream(self) -> str:
        return "shares"


class Usage(msgspec.Struct):
    """Module time in nanoseconds, decayed to ``at``."""

    used_ns: float = 0.0
    at: int = 0

    def compute_level(self, now: int) -> float:
        return self.used_ns * float(0.5 ** ((now - self.at) / HALF_LIFE_NS))

    def add(self, spent_ns: int, now: int) -> None:
        self.used_ns, self.at = self.compute_level(now) + spent_ns, now


class Week(msgspec.Struct):
    """The use on each of the last days (days since 1970): module time in nanoseconds, and consumables by
    kind."""

    spent_ns: dict[int, int] = {}
    consumed: dict[int, dict[str, float]] = {}

    def add_spent(self, day: int, spent_ns: int) -> None:
        if day not in self.spent_ns:
            self._forget_before(day)
        self.spent_ns[day] = self.spent_ns.get(day, 0) + spent_ns

    def add_consumed(self, day: int, kind: str, amount: float) -> None:
        if day not in self.consumed:
            self._forget_before(day)
        kinds = self.consumed.setdefault(day, {})
        kinds[kind] = kinds.get(kind, 0.0) + amount

    def _forget_before(self, day: int) -> None:
        """Delete the days that are no longer in the week of ``day``."""
        for table in (self.spent_ns, self.consumed):
            for old in [known for known in table if known <= day - WEEK_DAYS]:
                del table[old]

    def sum_lab_ns(self, now: int) -> int:
        """Module time of the last seven days."""
        return sum(spent for day, spent in self.spent_ns.items() if day > now // DAY_NS - WEEK_DAYS)

    def count_used(self, kind: str, now: int) -> float:
        """The amount of a consumable that was used in the last seven days."""
        days = [day for day in self.consumed if day > now // DAY_NS - WEEK_DAYS]
        return sum(self.consumed[day].get(kind, 0.0) for day in days)


class Workload(msgspec.Struct):
    """The number of runs under way and of waiting runs of a user or group, and the use in a week."""

    running: int = 0
    queued: int = 0
    week: Week = msgspec.field(default_factory=Week)


class Shares(msgspec.Struct):
    """``usage`` is by user, ``group_usage`` by group; ``had`` is by user, ``group_had`` by group.
    ``group_of`` names the group of each user who is in one. ``users`` are the users of runs alive;
    ``started`` are the runs under way. ``clocks`` hold the times at which open actions were requested.
    ``parts`` counts the actions that share the time of their module, because the device carries them out at
    once. ``kept`` are the groups that stay if a file does not name them."""

    digest: str = ""
    groups: dict[str, Group] = {}
    members: dict[str, Member] = {}
    group_of: dict[str, str] = {}
    usage: dict[str, Usage] = {}
    group_usage: dict[str, Usage] = {}
    had: dict[str, Workload] = {}
    group_had: dict[str, Workload] = {}
    users: dict[RunId, str] = {}
    started: dict[RunId, bool] = {}
    clocks: dict[ActionId, int] = {}
    parts: dict[ActionId, int] = {}
    kept: dict[str, bool] = {}

    def find_member(self, user: str) -> Member:
        return self.members.get(user, _ANYBODY)

    def find_share_used(self, user: str, now: int) -> tuple[float, float]:
        """The used share of a user's group, and of the user within it, each divided by the weight. The user
        with the least goes first."""
        member, group = self.find_member(user), self.groups.get(self.group_of.get(user, ""))
        usage = self.usage.get(user)
        own = (usage.compute_level(now) if usage is not None else 0.0) / member.weight
        if group is None:
            return own, own
        together = self.group_usage.get(group.name)
        return (together.compute_level(now) if together is not None else 0.0) / group.weight, own

    def list_limits(self, user: str) -> list[tuple[str, Quota, Workload]]:
        """The quotas that apply to a user: the name of their user or group, the quota, and the use of it."""
        found = [(user, self.find_member(user).quota, self.had.get(user, Workload()))]
        group = self.groups.get(self.group_of.get(user, ""))
        if group is not None:
            found.append((f"the group {group.name}", group.quota, self.group_had.get(group.name, Workload())))
        return [item for item in found if item[1] != _NO_QUOTA]


_ANYBODY = Member()
_NO_QUOTA = Quota()


def fold_shares_applied(shares: Shares, event: SharesApplied, at: int) -> None:
    shares.digest = event.digest
    kept = {name: shares.groups[name] for name in shares.kept}
    shares.groups = kept | {group.name: group for group in event.groups}
    shares.members = dict(event.users)
    shares.group_of = {}
    for group in event.groups:
        shares.members.update(group.members)
    for group in shares.groups.values():
        for user, member in group.members.items():
            shares.members.setdefault(user, member)
            shares.group_of[user] = group.name
    _count_groups(shares, at)


def fold_group_added(shares: Shares, event: GroupAdded, at: int) -> None:
    shares.groups[event.group] = Group(event.group)
    shares.kept[event.group] = True


def fold_group_removed(shares: Shares, event: GroupRemoved, at: int) -> None:
    shares.kept.pop(event.group, None)
    for user in shares.groups.pop(event.group).members:
        del shares.group_of[user]
        shares.members.pop(user, None)
    _count_groups(shares, at)


def fold_member_added(shares: Shares, event: MemberAdded, at: int) -> None:
    member = shares.members.setdefault(event.user, Member())
    _with_members(shares, event.group, shares.groups[event.group].members | {event.user: member})
    shares.group_of[event.user] = event.group
    _count_groups(shares, at)


def fold_member_removed(shares: Shares, event: MemberRemoved, at: int) -> None:
    left = {name: member for name, member in shares.groups[event.group].members.items() if name != event.user}
    _with_members(shares, event.group, left)
    del shares.group_of[event.user]
    shares.members.pop(event.user, None)
    _count_groups(shares, at)


def _with_members(shares: Shares, group: str, members: dict[str, Member]) -> None:
    shares.groups[group] = msgspec.structs.replace(shares.groups[group], members=members)


def _count_groups(shares: Shares, at: int) -> None:
    """The use of a group is the sum of its members' use, of the past and from now on."""
    shares.group_usage, shares.group_had = {}, {}
    for user, name in shares.group_of.items():
        together = shares.group_usage.setdefault(name, Usage(at=at))
        usage = shares.usage.get(user)
        together.used_ns += usage.compute_level(at) if usage is not None else 0.0
        own, had = shares.had.get(user), shares.group_had.setdefault(name, Workload())
        if own is None:
            continue
        had.running += own.running
        had.queued += own.queued
        for day, spent in own.week.spent_ns.items():
            had.week.add_spent(day, spent)
        for day, kinds in own.week.consumed.items():
            for kind, amount in kinds.items():
                had.week.add_consumed(day, kind, amount)


def _list_had(shares: Shares, user: str) -> list[Workload]:
    """The use of a user and of the user's group."""
    own, group = _find_workload(shares.had, user), shares.group_of.get(user)
    return [own] if group is None else [own, _find_workload(shares.group_had, group)]


def _find_workload(workloads: dict[str, Workload], name: str) -> Workload:
    """The workload of a user or group, to which something is added."""
    return workloads.get(name) or workloads.setdefault(name, Workload())


def fold_run_submitted(shares: Shares, event: RunSubmitted, at: int) -> None:
    shares.users[event.run] = event.user
    for had in _list_had(shares, event.user):
        had.queued += 1


def fold_run_started(shares: Shares, event: RunStarted, at: int) -> None:
    shares.started[event.run] = True
    for had in _list_had(shares, shares.users[event.run]):
        had.queued -= 1
        had.running += 1


def fold_run_ended(shares: Shares, event: RunEnd, at: int) -> None:
    user = shares.users.pop(event.run, None)
    if user is None:
        return
    was_started = shares.started.pop(event.run, False)
    for had in _list_had(shares, user):
        if was_started:
            had.running -= 1
        else:
            had.queued -= 1


def fold_action_requested(shares: Shares, event: ActionRequested, at: int) -> None:
    shares.clocks.setdefault(event.action, at)
    if event.together:
        shares.parts[event.action] = len(event.together)


def fold_action_ended(shares: Shares, event: ActionEnd, at: int) -> None:
    spent = (at - shares.clocks.pop(event.action, at)) // shares.parts.pop(event.action, 1)
    user = shares.users.get(event.run)
    if user is None:
        return
    _add_spent(shares.usage, shares.had, user, spent, at)
    group = shares.group_of.get(user)
    if group is not None:
        _add_spent(shares.group_usage, shares.group_had, group, spent, at)


def _add_spent(
    usages: dict[str, Usage], workloads: dict[str, Workload], name: str, spent_ns: int, at: int
) -> None:
    """Add module time to the use of a user or group."""
    (usages.get(name) or usages.setdefault(name, Usage(at=at))).add(spent_ns, at)
    _find_workload(workloads, name).week.add_spent(at // DAY_NS, spent_ns)


def fold_resource_consumed(shares: Shares, event: ResourceConsumed, at: int) -> None:
    user = shares.users.get(RunId(event.run))
    for had in _list_had(shares, user) if user is not None else ():
        had.week.add_consumed(at // DAY_NS, event.resource, event.amount)

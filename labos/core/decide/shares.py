"""Weights and quotas of users and groups."""

from __future__ import annotations

from labos.core.decide._base import Command, Decision, Rejection, decides
from labos.core.shares import Group, Member, SharesApplied
from labos.core.state import LabState


class ApplyShares(Command, frozen=True):
    """Apply new weights and quotas from the file with this ``digest``."""

    digest: str
    groups: tuple[Group, ...] = ()
    users: dict[str, Member] = {}


@decides(ApplyShares)
def apply_shares(state: LabState, command: ApplyShares) -> Decision:
    named: dict[str, str] = {}
    for group in command.groups:
        for user in group.members:
            if user in named:
                both = f"the groups {named[user]} and {group.name}"
                return Rejection("two_groups", f"{user} is in {both}.", "Name each user in only one group.")
            named[user] = group.name
    known = state.shares
    kept = [known.groups[name] for name in known.kept if name not in {group.name for group in command.groups}]
    for group in kept:
        for user in group.members.keys() & named.keys():
            return Rejection(
                "two_groups",
                f"{user} is in the group {group.name}, which this file does not name, and in {named[user]}.",
                f"Take {user} out of it: labos group member remove {group.name} {user}",
            )
    for user in command.users:
        if user in named:
            message = f"{user} is in the group {named[user]} and is also listed under `users`."
            return Rejection("two_groups", message, "Name each user once.")
    weights = [group.weight for group in command.groups]
    weights += [m.weight for g in command.groups for m in g.members.values()]
    weights += [member.weight for member in command.users.values()]
    if any(weight <= 0 for weight in weights):
        return Rejection(
            "bad_weight", "A weight has to be greater than 0.", "To allow a user only little, set a quota."
        )
    groups = {group.name: group for group in (*kept, *command.groups)}
    if (known.digest, known.groups) == (command.digest, groups):
        return []
    return [SharesApplied(command.digest, command.groups, command.users)]

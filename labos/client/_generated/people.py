"""The operations of labos/http/routes/people.py; written by tests/docs/client_code.py."""

from __future__ import annotations

from typing import Any

from labos.client._calls import Calls, in_path


class GeneratedPeople(Calls):
    """One method for each operation."""

    def users(self) -> list[dict[str, Any]]:
        """List the users and their roles."""
        return self._get("/users")["users"]

    def add_user(
        self, user: str, by: str, *, kind: str = "person", role: str | None = None, scope: str = "*"
    ) -> None:
        """Add a user: a person or a program. As soon as there is one user, only users may do anything. The
        first user becomes admin of the whole lab. The owner of the lab's folder adds the first user, with the
        content of ``home.key`` as the token. ``user``: the id, not the person's name: events contain it
        permanently. ``kind``: ``person``, or ``service`` for a program or an agent. ``role``: the first role;
        the first user of a lab is admin in any case. ``scope``: a workcell, or ``*`` for the whole lab.
        Raises Refused."""
        self._post("/users", locals())

    def user(self, user: str) -> dict[str, Any]:
        """Show a user and the user's roles. Returns ``id``, ``kind``, ``disabled``, ``since``, ``group``,
        ``roles``."""
        return self._get(f"/users/{in_path(user)}")

    def disable_user(self, user: str, by: str) -> None:
        """Disable a user. The user may no longer do anything. The user's runs continue; the user's campaigns
        are paused. Raises Refused."""
        self._post("/users/{user}/disable", locals(), repeat=True)

    def enable_user(self, user: str, by: str) -> None:
        """Enable a disabled user. Raises Refused."""
        self._post("/users/{user}/enable", locals(), repeat=True)

    def groups(self) -> list[dict[str, Any]]:
        """Groups, their members and their roles."""
        return self._get("/groups")["groups"]

    def add_group(self, group: str, by: str) -> None:
        """Add a group. The group has weight 1; a shares file may set another weight. ``group``: its name.
        Raises Refused."""
        self._post("/groups", locals())

    def remove_group(self, group: str, by: str) -> None:
        """Remove a group. Its members are then in no group, and its roles are removed. The answer lists the
        remaining groups. Raises Refused."""
        self._post("/groups/{group}/remove", locals())

    def add_member(self, group: str, user: str, by: str) -> None:
        """Add a user to a group. A user can be in only one group. ``user``: a user's id. Raises Refused."""
        self._post("/groups/{group}/members", locals(), repeat=True)

    def remove_member(self, group: str, user: str, by: str) -> None:
        """Take a user out of a group. ``user``: a user's id. Raises Refused."""
        self._post("/groups/{group}/members/remove", locals(), repeat=True)

    def grant_role(self, subject: str, role: str, by: str, *, scope: str = "*") -> None:
        """Give a user or a group a role. It replaces the role that the user or group has there. ``subject``:
        ``user:ID`` or ``group:NAME``. ``role``: ``viewer``, ``submitter``, ``operator`` or ``admin``.
        ``scope``: a workcell, or ``*`` for the whole lab. Raises Refused."""
        self._post("/roles/grant", locals(), repeat=True)

    def revoke_role(self, subject: str, by: str, *, scope: str = "*") -> None:
        """Take a role away. A user without a role may only look. ``subject``: ``user:ID`` or ``group:NAME``.
        ``scope``: a workcell, or ``*`` for the whole lab. Raises Refused."""
        self._post("/roles/revoke", locals(), repeat=True)

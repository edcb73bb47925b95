"""The operations of labos/http/routes/people.py; written by tests/docs/client_code.py."""

from __future__ import annotations

from typing import Any

from labos.client._calls import Calls, in_path


class GeneratedPeople(Calls):
    """One method for each operation."""

    def users(self) -> list[dict[str, Any]]:
        """Who may use the lab, and with which roles."""
        return self._get("/users")["users"]

    def add_user(
        self, user: str, by: str, *, kind: str = "person", role: str | None = None, scope: str = "*"
    ) -> None:
        """Let a person or a program use the lab. From the first user on, nobody else may do anything: that
        user becomes admin of the whole lab. It is added by the owner of the lab's folder, with what is in its
        ``home.key`` as a token. ``user``: the id, which is no name: events bear it for ever. ``kind``:
        ``person``, or ``service`` for a program or an agent. ``role``: a role to begin with; the first user
        is admin in any case. ``scope``: a workcell, or ``*`` for the whole lab. Raises Refused."""
        self._post("/users", {"user": user, "by": by, "kind": kind, "role": role, "scope": scope})

    def user(self, user: str) -> dict[str, Any]:
        """A user, with the roles of that user. Returns ``id``, ``kind``, ``disabled``, ``since``, ``group``,
        ``roles``."""
        return self._get(f"/users/{in_path(user)}")

    def disable_user(self, user: str, by: str) -> None:
        """Let a user do nothing any more. The user may do nothing any more. Runs go on; campaigns are paused.
        Raises Refused."""
        self._post(f"/users/{in_path(user)}/disable", {"by": by}, repeat=True)

    def enable_user(self, user: str, by: str) -> None:
        """Let a disabled user act again. Raises Refused."""
        self._post(f"/users/{in_path(user)}/enable", {"by": by}, repeat=True)

    def groups(self) -> list[dict[str, Any]]:
        """Groups, their members and their roles."""
        return self._get("/groups")["groups"]

    def add_group(self, group: str, by: str) -> None:
        """Add a group. Of weight 1; a shares file may say another one. ``group``: its name. Raises
        Refused."""
        self._post("/groups", {"group": group, "by": by})

    def remove_group(self, group: str, by: str) -> None:
        """Remove a group. Its members are in no group then, and its roles are gone. Answers those that are
        left. Raises Refused."""
        self._post(f"/groups/{in_path(group)}/remove", {"by": by})

    def add_member(self, group: str, user: str, by: str) -> None:
        """Add a user to a group. Nobody is in two groups. ``user``: a user's id. Raises Refused."""
        self._post(f"/groups/{in_path(group)}/members", {"user": user, "by": by}, repeat=True)

    def remove_member(self, group: str, user: str, by: str) -> None:
        """Take a user out of a group. ``user``: a user's id. Raises Refused."""
        self._post(f"/groups/{in_path(group)}/members/remove", {"user": user, "by": by}, repeat=True)

    def grant_role(self, subject: str, role: str, by: str, *, scope: str = "*") -> None:
        """Give a user or a group a role. In place of the role that the user or group has there. ``subject``:
        ``user:ID`` or ``group:NAME``. ``role``: ``viewer``, ``submitter``, ``operator`` or ``admin``.
        ``scope``: a workcell, or ``*`` for the whole lab. Raises Refused."""
        self._post("/roles/grant", {"subject": subject, "role": role, "by": by, "scope": scope}, repeat=True)

    def revoke_role(self, subject: str, by: str, *, scope: str = "*") -> None:
        """Take a role away. Without a role somebody may look, and no more. ``subject``: ``user:ID`` or
        ``group:NAME``. ``scope``: a workcell, or ``*`` for the whole lab. Raises Refused."""
        self._post("/roles/revoke", {"subject": subject, "by": by, "scope": scope}, repeat=True)

"""The calls of a client about users, groups and roles."""

from __future__ import annotations

from typing import Any, Literal

from labos.client._calls import Calls
from labos.core.lab import WHOLE_LAB


class PeopleCalls(Calls):
    """Who may use the lab, and for what. ``by`` is who asks, in a lab that has no users yet."""

    def users(self) -> list[dict[str, Any]]:
        """Each with ``id``, ``kind``, ``disabled``, ``since`` (UTC ns), ``group`` and ``roles`` by workcell
        (``*``: the whole lab). None are known in a lab that is open to everybody."""
        return list(self._get("/users")["users"])

    def user(self, user: str) -> dict[str, Any]:
        """As one of ``users``. Raises NotFound."""
        return self._get(f"/users/{user}")

    def add_user(
        self,
        user: str,
        by: str,
        *,
        kind: Literal["person", "service"] = "person",
        role: str | None = None,
        scope: str = "*",
    ) -> None:
        """Let a person, or a program or agent (``service``), use the lab, with a ``role`` in a workcell or in
        the whole lab (``*``). The first becomes its admin."""
        self._post("/users", {"user": user, "kind": kind, "role": role, "scope": scope, "by": by})

    def disable_user(self, user: str, by: str) -> None:
        self._post(f"/users/{user}/disable", {"by": by}, repeat=True)

    def enable_user(self, user: str, by: str) -> None:
        self._post(f"/users/{user}/enable", {"by": by}, repeat=True)

    def groups(self) -> list[dict[str, Any]]:
        """Each with ``name``, ``weight``, ``members`` and ``roles`` by workcell (``*``: the whole lab)."""
        return list(self._get("/groups")["groups"])

    def add_group(self, group: str, by: str) -> None:
        self._post("/groups", {"group": group, "by": by})

    def remove_group(self, group: str, by: str) -> None:
        self._post(f"/groups/{group}/remove", {"by": by})

    def add_member(self, group: str, user: str, by: str) -> None:
        """Nobody is in two groups."""
        self._post(f"/groups/{group}/members", {"user": user, "by": by}, repeat=True)

    def remove_member(self, group: str, user: str, by: str) -> None:
        self._post(f"/groups/{group}/members/remove", {"user": user, "by": by}, repeat=True)

    def grant_role(self, subject: str, role: str, by: str, *, scope: str = WHOLE_LAB) -> None:
        """``subject`` is ``user:ID`` or ``group:NAME``; ``scope`` a workcell, or ``*``."""
        body = {"subject": subject, "role": role, "scope": scope, "by": by}
        self._post("/roles/grant", body, repeat=True)

    def revoke_role(self, subject: str, by: str, *, scope: str = WHOLE_LAB) -> None:
        self._post("/roles/revoke", {"subject": subject, "scope": scope, "by": by}, repeat=True)

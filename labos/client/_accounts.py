"""The calls of a client about signing in, tokens, and who users are."""

from __future__ import annotations

from typing import Any

from labos.client._calls import Calls


class AccountCalls(Calls):
    """Who asks, and with what."""

    def sign_in(self, user: str, password: str, *, label: str = "", days: float = 30.0) -> dict[str, Any]:
        """A ``token`` for the user of this password, good ``until`` (UTC ns). Raises NotSignedIn."""
        body = {"user": user, "password": password, "token": True, "label": label, "days": days}
        return self._post("/login", body)

    def sign_out(self) -> None:
        """The token that is shown is good no more."""
        self._post("/logout", {})

    def identity(self) -> dict[str, Any]:
        """Who asks, how that is known, and which roles they have."""
        return self._get("/whoami")

    def tokens(self, user: str = "") -> list[dict[str, Any]]:
        found: list[dict[str, Any]] = self._get("/tokens", user=user)["tokens"]
        return found

    def make_token(
        self, label: str = "", *, scope: str = "submitter", days: float = 90.0, user: str = ""
    ) -> dict[str, Any]:
        """A new ``token``, and its ``secret``, which nobody is told again."""
        return self._post("/tokens", {"label": label, "scope": scope, "days": days, "user": user})

    def revoke_token(self, token: str) -> None:
        self._post(f"/tokens/{token}/revoke", {}, repeat=True)

    def set_password(self, user: str, password: str, present: str = "") -> None:
        self._post(f"/users/{user}/password", {"password": password, "present": present})

    def sign_run(self, run: str, meaning: str, password: str, *, why: str = "") -> dict[str, Any]:
        """Sign the record of a run that has ended, as whoever asks. ``meaning``: authored, responsible,
        reviewed, approved or rejected. Raises Forbidden for a wrong password."""
        body = {"meaning": meaning, "password": password, "why": why}
        return self._post(f"/runs/{run}/signatures", body, repeat=True)

    def signatures(self, run: str) -> list[dict[str, Any]]:
        """Each with ``by``, ``meaning``, ``why``, ``at`` (UTC ns), and ``holds``: whether the record of the
        run is the one that was signed."""
        found: list[dict[str, Any]] = self._get(f"/runs/{run}/signatures")["signatures"]
        return found

    def people(self) -> list[dict[str, str]]:
        """Who users are, as far as somebody has said so."""
        found: list[dict[str, str]] = self._get("/people")["people"]
        return found

    def set_person(self, user: str, *, name: str | None = None, mail: str | None = None) -> None:
        self._post(f"/users/{user}/person", {"name": name, "mail": mail}, repeat=True)

    def erase_person(self, user: str) -> None:
        """Name, address, password, tokens and sessions of a user are gone; events remain."""
        self._post(f"/users/{user}/erase", {}, repeat=True)

    def link_identity(self, user: str, issuer: str, subject: str) -> None:
        self._post(f"/users/{user}/identity", {"issuer": issuer, "subject": subject}, repeat=True)

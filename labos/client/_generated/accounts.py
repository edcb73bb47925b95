"""The operations of labos/http/routes/accounts.py; written by tests/docs/client_code.py."""

from __future__ import annotations

from typing import Any

from labos.client._calls import Calls, in_path


class GeneratedAccounts(Calls):
    """One method for each operation."""

    def sign_in(
        self, user: str, password: str, *, label: str = "signed in", scope: str = "admin", days: float = 30.0
    ) -> dict[str, Any]:
        """Sign in with a password. A browser gets a session of 12 hours as a cookie that no script can read;
        a program asks for a ``token``. Six wrong tries within a minute are too many. ``user``: the user's id.
        ``password``: the password. ``label``: what the token is for. ``scope``: the most that the token is
        good for. ``days``: how long the token is good. Returns ``user``, ``until``, ``token``. Raises
        Refused."""
        return self._post(
            "/login",
            {"user": user, "password": password, "label": label, "scope": scope, "days": days, "token": True},
        )

    def begin_sign_in(self, port: int, *, device: bool = False) -> dict[str, Any]:
        """Sign in with an identity provider: the address of its page. For a command line. The address is for
        a browser: on the same computer it comes back to a port there; of a ``device`` it is any browser, in
        which the code is typed in. Ten minutes are given for it. ``port``: of the asker, to which a browser
        comes back. ``device``: there is no browser: a code for one elsewhere. Returns ``address``, ``state``,
        ``key``, ``code``, ``wait_s``. Raises NotFound, Refused."""
        return self._post("/login/provider", {"port": port, "device": device})

    def finish_sign_in(
        self,
        state: str,
        key: str,
        *,
        code: str = "",
        iss: str = "",
        error: str = "",
        label: str = "signed in",
        scope: str = "admin",
        days: float = 30.0,
    ) -> dict[str, Any]:
        """Sign in with an identity provider: a token. What the provider's page has sent with the browser; of
        a ``device`` nothing, again after ``wait_s`` until there is a token. ``state``: as it was told at the
        beginning. ``key``: as it was told at the beginning. ``code``: what came with the browser. ``iss``:
        what came with the browser. ``error``: what came with the browser. ``label``: what the token is for.
        ``scope``: the most that the token is good for. ``days``: how long the token is good; the lab may give
        less. Returns ``user``, ``until``, ``token``, ``wait_s``. Raises NotFound, Refused."""
        return self._post(
            "/login/provider/finish",
            {
                "state": state,
                "key": key,
                "code": code,
                "iss": iss,
                "error": error,
                "label": label,
                "scope": scope,
                "days": days,
            },
        )

    def sign_out(self) -> None:
        """Sign out. The session of the cookie ends, or the token that was shown is revoked. Streams that they
        opened end."""
        self._post("/logout", {})

    def identity(self) -> dict[str, Any]:
        """Who asks, and what they may do. Returns ``user``, ``how``, ``scope``, ``kind``, ``group``,
        ``roles``, ``name``, ``mail``, ``until``."""
        return self._get("/whoami")

    def tokens(self, user: str = "") -> list[dict[str, Any]]:
        """Tokens of programs. Without their secrets, which the lab does not know. ``user``: whose, if not the
        asking user's own; for admins."""
        return self._get("/tokens", user=user)["tokens"]

    def make_token(
        self, label: str = "", *, scope: str = "submitter", days: float = 90.0, user: str = ""
    ) -> dict[str, Any]:
        """Make a token for a program. The secret is told this once. A token that makes another one outlives
        it, and allows more than it, never. ``label``: what it is for. ``scope``: the most that it is good
        for. ``days``: how long it is good. ``user``: whose it is, if not the asking user's own; for admins.
        Returns ``token``, ``secret``. Raises NotFound, Refused."""
        return self._post("/tokens", {"label": label, "scope": scope, "days": days, "user": user})

    def revoke_token(self, token: str) -> None:
        """Revoke a token. It is good for nothing from now on; streams that were opened with it end."""
        self._post(f"/tokens/{in_path(token)}/revoke", {}, repeat=True)

    def people(self) -> list[dict[str, Any]]:
        """Who users are."""
        return self._get("/people")["people"]

    def set_password(self, user: str, password: str, present: str = "") -> None:
        """Change a user's password. All sessions of the user end; tokens stay. ``password``: the new one, of
        10 characters at least. ``present``: the present one; needed by a user who changes their own."""
        self._post(f"/users/{in_path(user)}/password", {"password": password, "present": present})

    def set_person(self, user: str, *, name: str | None = None, mail: str | None = None) -> None:
        """Say who a user is. Kept beside the log, which knows users by their ids alone. ``name``: the user's
        name. ``mail``: an address."""
        self._post(f"/users/{in_path(user)}/person", {"name": name, "mail": mail}, repeat=True)

    def erase_person(self, user: str) -> None:
        """Forget who a user is. The name, the address, the password, all tokens and sessions are gone. Events
        remain, and say the id; one more says that this was done."""
        self._post(f"/users/{in_path(user)}/erase", {}, repeat=True)

    def link_identity(self, user: str, issuer: str, subject: str) -> None:
        """Say whom an identity provider means by a user. The person with this name at the identity provider
        is this user. ``issuer``: the identity provider, as ``https://login.example.org``. ``subject``: what
        it calls the user (the claim ``sub``)."""
        self._post(f"/users/{in_path(user)}/identity", {"issuer": issuer, "subject": subject}, repeat=True)

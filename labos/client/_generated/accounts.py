"""The operations of labos/http/routes/accounts.py; written by tests/docs/client_code.py."""

from __future__ import annotations

from typing import Any

from labos.client._calls import Calls


class GeneratedAccounts(Calls):
    """One method for each operation."""

    def sign_in(
        self, user: str, password: str, *, label: str = "signed in", scope: str = "admin", days: float = 30.0
    ) -> dict[str, Any]:
        """Sign in with a password. A browser gets a session of 12 hours, as a cookie that scripts cannot
        read. A program asks for a ``token``. After six wrong attempts within a minute, further attempts are
        refused. ``user``: the user's id. ``password``: the password. ``label``: what the token is for.
        ``scope``: the highest role that the token allows. ``days``: the number of days for which the token is
        valid. Returns ``user``, ``until``, ``token``. Raises Refused."""
        return self._post("/login", locals() | {"token": True})

    def begin_sign_in(self, port: int, *, device: bool = False) -> dict[str, Any]:
        """Begin to sign in with an identity provider: get the address of its page. For a command line. The
        user opens the address in a browser. On the same computer, the browser returns to a local port. For a
        ``device`` without a browser, the user enters the code in a browser elsewhere. The sign-in expires
        after ten minutes. ``port``: the local port to which the browser returns. ``device``: there is no
        browser on this computer: get a code for a browser elsewhere. Returns ``address``, ``state``, ``key``,
        ``code``, ``wait_s``. Raises NotFound, Refused."""
        return self._post("/login/provider", locals())

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
        """Finish signing in with an identity provider: get a token. The request holds the parameters with
        which the browser returned from the provider. For a ``device`` there are none: repeat the request
        every ``wait_s`` seconds until there is a token. ``state``: the value from the answer that began the
        sign-in. ``key``: the value from the answer that began the sign-in. ``code``: the parameter with which
        the browser returned. ``iss``: the parameter with which the browser returned. ``error``: the parameter
        with which the browser returned. ``label``: what the token is for. ``scope``: the highest role that
        the token allows. ``days``: the number of days for which the token is valid; the lab may allow fewer.
        Returns ``user``, ``until``, ``token``, ``wait_s``. Raises NotFound, Refused."""
        return self._post("/login/provider/finish", locals())

    def sign_out(self) -> None:
        """Sign out. The session of the cookie ends, or the token of the request is revoked. Their open
        streams end too."""
        self._post("/logout", locals())

    def identity(self) -> dict[str, Any]:
        """Show the user who asks, and the user's rights. Returns ``user``, ``how``, ``scope``, ``kind``,
        ``group``, ``roles``, ``name``, ``mail``, ``until``."""
        return self._get("/whoami")

    def tokens(self, user: str = "") -> list[dict[str, Any]]:
        """Tokens of programs. The answer has no secrets: the lab does not store them. ``user``: the owner;
        only admins may name another user."""
        return self._get("/tokens", user=user)["tokens"]

    def make_token(
        self, label: str = "", *, scope: str = "submitter", days: float = 90.0, user: str = ""
    ) -> dict[str, Any]:
        """Make a token for a program. The secret is shown only in this answer. A token that was made with
        another token is never valid longer and never allows more than that one. ``label``: its purpose.
        ``scope``: the highest role that it allows. ``days``: the number of days for which it is valid.
        ``user``: the owner; only admins may name another user. Returns ``token``, ``secret``. Raises
        NotFound, Refused."""
        return self._post("/tokens", locals())

    def revoke_token(self, token: str) -> None:
        """Revoke a token. The token is invalid from now on; streams that were opened with it end."""
        self._post("/tokens/{token}/revoke", locals(), repeat=True)

    def people(self) -> list[dict[str, Any]]:
        """List the names of users."""
        return self._get("/people")["people"]

    def set_password(self, user: str, password: str, present: str = "") -> None:
        """Change a user's password. All sessions of the user end; tokens stay. ``password``: the new
        password, at least 10 characters. ``present``: the present password; required from users who change
        their own."""
        self._post("/users/{user}/password", locals())

    def set_person(self, user: str, *, name: str | None = None, mail: str | None = None) -> None:
        """Change the name and address of a user. They are stored beside the log, which contains only the ids
        of users. ``name``: the user's name. ``mail``: an address."""
        self._post("/users/{user}/person", locals(), repeat=True)

    def erase_person(self, user: str) -> None:
        """Erase a user's name, address and means of signing in. The name, the address, the password and all
        tokens and sessions are deleted. Events remain and contain the id. A further event records the
        erasure."""
        self._post("/users/{user}/erase", locals(), repeat=True)

    def link_identity(self, user: str, issuer: str, subject: str) -> None:
        """Link a user to an account at an identity provider. The account with this ``subject`` at the
        identity provider belongs to this user. ``issuer``: the identity provider, as
        ``https://login.example.org``. ``subject``: the provider's id of the user (the claim ``sub``)."""
        self._post("/users/{user}/identity", locals(), repeat=True)

"""Identifies the requesting user: by a token, by the cookie of a session, or by the key in the lab's
folder."""

from __future__ import annotations

import hmac
from collections.abc import Callable
from typing import TYPE_CHECKING, Literal

import msgspec
import structlog
from starlette.requests import Request

from labos.core.users import Users, on_behalf
from labos.errors import Forbidden, LabosError, NotSignedIn, StoreUnavailable
from labos.services.accounts import HOME, Accounts, Credential, Need, allows, make_digest

if TYPE_CHECKING:
    from labos.services.accounts.command_line import CommandLineSignIn
    from labos.services.accounts.oidc import Provider

COOKIE = "labos-session"
SECURE_COOKIE = f"__Host-{COOKIE}"
"""Browsers accept it only over TLS, and send it only to the host that set it."""

BEHALF = "labos-on-behalf-of"

SIGN_IN = "Sign in with `labos login`, or send a token (LABOS_TOKEN)."

IN_LINK = "Make one for it: labos token create --scope viewer"

_log = structlog.get_logger(__name__)


class Who(msgspec.Struct, frozen=True):
    """The requesting user. ``user`` is empty in a lab without users, where the request names the user
    (``open``), and for the owner of the lab's folder (``home``), who may view, stop modules, and help users
    to sign in."""

    how: Literal["open", "home", "token", "session"]
    user: str = ""
    behalf: str = ""
    credential: Credential | None = None

    @property
    def actor(self) -> str:
        """The name of the signed-in user in the log: for a service account, together with the person for whom
        it acts."""
        return on_behalf(self.user, self.behalf) if self.behalf else self.user

    @property
    def is_known(self) -> bool:
        """Whether this name is used, and not the name in the request."""
        return self.how in ("token", "session")


class Gate:
    """Admits requests. ``home_key`` is the secret in the lab's folder; ``secure``: browsers reach the lab
    over TLS. The functions in ``on_refusal`` are called with the reason of each refusal."""

    def __init__(
        self,
        accounts: Accounts,
        users: Callable[[], Users],
        home_key: str = "",
        *,
        secure: bool = False,
        provider: Provider | None = None,
    ) -> None:
        self.accounts, self.secure, self.provider = accounts, secure, provider
        self.command_line: CommandLineSignIn | None = None
        if provider is not None:
            from labos.services.accounts.command_line import CommandLineSignIn

            self.command_line = CommandLineSignIn(provider)
        self._read_users = users
        self._last_users: Users | None = None
        self._home = make_digest(home_key) if home_key else b""
        self.on_refusal: list[Callable[[str], None]] = []

    def users(self) -> Users:
        """The users of the lab; while its log cannot be read, the last known ones. Raises StoreUnavailable if
        none have been read yet."""
        try:
            self._last_users = self._read_users()
        except StoreUnavailable:
            if self._last_users is None:
                raise
        return self._last_users

    @property
    def cookie(self) -> str:
        return SECURE_COOKIE if self.secure else COOKIE

    async def admit(
        self, request: Request, need: Need, *, by_home: bool = False, by_link: bool = False
    ) -> Who:
        """The user who sends a request that needs this role. ``by_home``: the owner of the lab's folder may
        send it too; ``by_link``: the token may be in the address, if its scope is viewer. Raises NotSignedIn,
        Forbidden."""
        try:
            who = await (self._find_user_by_link(request) if by_link else self.identify(request))
            self._check(who, need, by_home)
        except (NotSignedIn, Forbidden) as error:
            self._report_refusal(request, error)
            raise
        return who

    def confirm(self, who: Who, need: Need) -> None:
        """Check the user that an API process names: one who could not have signed in is refused. Raises
        NotSignedIn, Forbidden."""
        users = self.users()
        if who.how == "home" or (who.how == "open") is not users.is_open:
            raise NotSignedIn(
                "The API process and the kernel find different users for this request.", remedy="Ask again."
            )
        if who.how != "open":
            if who.credential is None or who.credential.user != who.user or users.get(who.user) is None:
                raise NotSignedIn(f"The user {who.user[:100]!r} is disabled.", remedy=SIGN_IN)
            self._expect_service(who.behalf, who.user)
        self._check(who, need, by_home=False)

    async def _find_user_by_link(self, request: Request) -> Who:
        """The user of a token in the address. Such addresses are stored in many places, so the token's scope
        must be viewer. Raises NotSignedIn, Forbidden."""
        shown = request.query_params.get("token", "")[:200]
        if not shown or request.headers.get("authorization"):
            return await self.identify(request)
        if shown.startswith(HOME):
            raise NotSignedIn("The key in the lab's folder is not allowed in an address.", remedy=IN_LINK)
        credential = await self.accounts.find(shown)
        if credential.how != "token" or credential.scope != "viewer":
            raise Forbidden("Only a token with the role viewer is allowed in an address.", remedy=IN_LINK)
        return Who("token", credential.user, "", credential)

    async def identify(self, request: Request) -> Who:
        """The requesting user, for any kind of request. Raises NotSignedIn, Forbidden."""
        shown = _bearer(request)
        if shown.startswith(HOME):
            if not self._home or not hmac.compare_digest(make_digest(shown), self._home):
                raise NotSignedIn("The key is not the one in the lab's folder.", remedy=SIGN_IN)
            return Who("home")
        cookie = "" if shown else request.cookies.get(self.cookie, "")
        if not shown and not cookie:
            if self.users().is_open:
                return Who("open")
            raise NotSignedIn("This lab has users, and the request is not authenticated.", remedy=SIGN_IN)
        if cookie and request.method not in ("GET", "HEAD"):
            _expect_own_page(request)
        credential = await self.accounts.find(shown or cookie)
        if credential.how != ("token" if shown else "session"):
            raise NotSignedIn("Send the token in the header Authorization.", remedy=SIGN_IN)
        behalf = request.headers.get(BEHALF, "")
        self._expect_service(behalf, credential.user)
        return Who(credential.how, credential.user, behalf, credential)

    def _expect_service(self, named: str, user: str) -> None:
        """Raises Forbidden if a user may not act for the named person."""
        if not named:
            return
        known = self.users().get(user)
        if known is None or known.kind != "service":
            raise Forbidden(
                f"{user} is not a service account, and cannot act on behalf of {named[:100]!r}.",
                remedy="Leave the header LabOS-On-Behalf-Of out.",
            )
        if self.users().get(named) is None:
            raise Forbidden(
                f"There is no user {named[:100]!r}, so nobody can act on behalf of this name.",
                remedy="List them: labos user list",
            )

    def _check(self, who: Who, need: Need, by_home: bool) -> None:
        if who.how == "home" and not (self.users().is_open or need == "viewer" or by_home):
            raise NotSignedIn(
                "The key in the lab's folder allows only reading, stopping modules, and help with sign-in.",
                remedy=SIGN_IN,
            )
        if who.credential is not None and not allows(who.credential.scope, need):
            raise Forbidden(
                f"The token {who.credential.token} has the rights of a {who.credential.scope} at most; this "
                f"request needs {need}.",
                remedy="Create one with a higher role: labos token create --scope " + need,
            )

    def _report_refusal(self, request: Request, error: LabosError) -> None:
        for listener in self.on_refusal:
            listener("not_signed_in" if isinstance(error, NotSignedIn) else "forbidden")
        address = request.client.host if request.client is not None else ""
        _log.info("request_refused", path=request.url.path[:200], address=address, why=error.message)


def _bearer(request: Request) -> str:
    """The token in the header Authorization; empty if there is none. Raises NotSignedIn for another
    scheme."""
    shown = request.headers.get("authorization", "")
    scheme, _, secret = shown.partition(" ")
    if not shown:
        return ""
    if scheme.lower() != "bearer" or not secret.strip():
        raise NotSignedIn("The header Authorization is not `Bearer TOKEN`.", remedy=SIGN_IN)
    return secret.strip()[:200]


def _expect_own_page(request: Request) -> None:
    """A browser sends its cookie with every request, whichever page caused it; it also names the site of that
    page. The check that an ``Origin`` is this server was made before. Raises Forbidden."""
    headers = request.headers
    if headers.get("origin") or headers.get("sec-fetch-site") == "same-origin":
        return
    raise Forbidden(
        "The request has the cookie of a session, but no header that names its page.",
        remedy="Programs send a token (Authorization: Bearer …).",
    )

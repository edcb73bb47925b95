"""Signs users in, and identifies a user by the credential that a later request shows."""

from __future__ import annotations

import asyncio
import hashlib
import secrets
from collections.abc import Callable, Collection
from typing import Literal

import msgspec
import structlog

from labos.clock import Clock
from labos.errors import BadInput, NotFound, NotSignedIn, TooManyTries
from labos.ports import AccountStore, Person, Session, Token
from labos.services.accounts.passwords import Passwords, check_password
from labos.services.accounts.tries import Tries

Need = Literal["viewer", "submitter", "operator", "admin"]
NEEDS: tuple[Need, ...] = ("viewer", "submitter", "operator", "admin")
"""From the lowest to the highest."""

SESSION_S = 12 * 3600.0
TOKEN_DAYS, MOST_DAYS = 90, 366
FRESH_S = 5.0
"""For so many seconds a credential is accepted without a query to the database. If it is revoked in this
process, that has an effect at once."""
USED_EVERY_S = 60.0
"""The time at which a token was last used is exact to so many seconds."""
MOST_KNOWN = 10_000
MOST_TOKENS = 100
"""The largest number of valid tokens of one user."""

TOKEN, SESSION, HOME = "labos_token_", "labos_session_", "labos_home_"
"""The prefixes of secrets, which are 256 random bits. By the prefix, people and programs that search for
leaked secrets recognise them."""

_SECOND = 1_000_000_000
_log = structlog.get_logger(__name__)


def make_secret(prefix: str) -> str:
    """The prefix and 43 letters, digits, ``-`` and ``_``."""
    return prefix + secrets.token_urlsafe(32)


def make_digest(secret: str) -> bytes:
    """The digest that is stored in place of a secret. A secret is random, so no slower hash is needed."""
    return hashlib.sha256(secret.encode()).digest()


def make_id() -> str:
    """The public id of a token; nothing about the token follows from it."""
    return secrets.token_hex(4)


class Credential(msgspec.Struct, frozen=True):
    """The identity that a secret has proved. ``key`` identifies it for those who wait for its end, and is not
    secret; ``until`` is when it expires (UTC ns)."""

    user: str
    how: Literal["token", "session"]
    scope: Need
    key: str
    until: int
    token: str = ""


Which = Callable[[Credential], bool]


def allows(scope: Need, need: Need) -> bool:
    """Whether a credential with this scope is enough for what needs ``need``."""
    return NEEDS.index(scope) >= NEEDS.index(need)


class Accounts:
    """``is_active`` tells whether a user exists and may act. The functions in ``on_end`` are called when
    credentials are revoked, with a predicate that tells which ones."""

    def __init__(self, store: AccountStore, clock: Clock, is_active: Callable[[str], bool]) -> None:
        self._store, self._clock, self._is_active = store, clock, is_active
        self._passwords, self._tries = Passwords(), Tries()
        self._known: dict[bytes, tuple[Credential, float]] = {}
        self._used: dict[str, float] = {}
        self.on_end: list[Callable[[Which], None]] = []
        self.on_try: list[Callable[[str], None]] = []
        """Called with the outcome of each attempt to sign in: `right`, `wrong` or `too_many`."""

    # -- identity ------------------------------------------------------------------------------

    async def find(self, secret: str) -> Credential:
        """The credential that belongs to a secret. Raises NotSignedIn."""
        digest = make_digest(secret)
        known, fresh_until = self._known.get(digest, (None, 0.0))
        now = self._clock.monotonic()
        if known is None or now >= fresh_until:
            self._known.pop(digest, None)
            known = await self._find(secret, digest)
            while len(self._known) >= MOST_KNOWN:
                del self._known[next(iter(self._known))]
            self._known[digest] = known, now + FRESH_S
        if known.until <= self._clock.now_ns():
            raise NotSignedIn(f"The {known.how} has expired.", remedy=_explain_sign_in(known.how))
        if not self._is_active(known.user):
            raise NotSignedIn(f"The user {known.user} is disabled.", remedy="Ask an admin of the lab.")
        await self._note_use(known, now)
        return known

    async def _find(self, secret: str, digest: bytes) -> Credential:
        key = _make_key(digest)
        if secret.startswith(SESSION):
            session = await asyncio.to_thread(self._store.session, digest)
            if session is None:
                raise NotSignedIn("The session has ended.", remedy=_explain_sign_in("session"))
            return Credential(session.user, "session", "admin", key, session.expires_at)
        token = await asyncio.to_thread(self._store.token, digest) if secret.startswith(TOKEN) else None
        if token is None:
            raise NotSignedIn("The token does not belong to this lab.", remedy=_explain_sign_in("token"))
        if token.revoked_at:
            raise NotSignedIn(f"The token {token.id} was revoked.", remedy=_explain_sign_in("token"))
        return Credential(token.user, "token", _parse_scope(token.scope), key, token.expires_at, token.id)

    async def _note_use(self, credential: Credential, now: float) -> None:
        id_ = credential.token
        if id_ and now - self._used.get(id_, -USED_EVERY_S) >= USED_EVERY_S:
            self._used[id_] = now
            await asyncio.to_thread(self._store.use_token, id_, self._clock.now_ns())

    # -- signing in ----------------------------------------------------------------------------

    async def expect_password(self, user: str, password: str, address: str) -> None:
        """Raises NotSignedIn for a wrong password, TooManyTries."""
        wait = self._tries.wait_s(user, address, self._clock.monotonic())
        known = self._is_active(user)
        # A user may type a password into the field for the name: it must not appear in a log.
        named = user if known else "unknown"
        if wait > 0:
            self.count_try("too_many")
            _log.warning("sign_in_refused", user=named, address=address, why="too many tries")
            raise TooManyTries("There were too many tries to sign in.", wait_s=wait)
        hash_ = await asyncio.to_thread(self._store.password, user) if known else ""
        if not await self._passwords.is_right(hash_, password):
            self.count_try("wrong")
            _log.warning("sign_in_refused", user=named, address=address, why="wrong password or user")
            raise NotSignedIn("User or password is wrong.", remedy="Try again, or ask an admin of the lab.")
        if self._passwords.is_old(hash_):
            await self._keep_password(user, password)
        self.count_try("right")

    async def begin_session(self, user: str, how: str, before: str = "") -> tuple[str, Session]:
        """The secret of a new session, and the session. The browser's earlier session, ``before``, ends."""
        if before:
            await self.end_session(before)
        secret, now = make_secret(SESSION), self._clock.now_ns()
        session = Session(user, how, now, now + int(SESSION_S * _SECOND))
        await asyncio.to_thread(self._store.add_session, session, make_digest(secret))
        return secret, session

    async def end_session(self, secret: str) -> None:
        digest = make_digest(secret)
        await asyncio.to_thread(self._store.end_session, digest)
        self._forget_key(_make_key(digest))

    # -- tokens --------------------------------------------------------------------------------

    async def make_token(self, user: str, label: str, scope: Need, days: float) -> tuple[str, Token]:
        """A new token, whose secret cannot be shown again, and its record. Raises BadInput."""
        if not 0 < days <= MOST_DAYS:
            raise BadInput(
                f"A token cannot be valid for {days:g} days.", remedy=f"Give at most {MOST_DAYS} days."
            )
        now = self._clock.now_ns()
        good = [t for t in await self.tokens(user) if not t.revoked_at and t.expires_at > now]
        if len(good) >= MOST_TOKENS:
            raise BadInput(
                f"{user} has {len(good)} tokens.", remedy="Revoke some first: labos token revoke ID"
            )
        secret = make_secret(TOKEN)
        token = Token(make_id(), user, label, scope, now, now + int(days * 86400 * _SECOND))
        await asyncio.to_thread(self._store.add_token, token, make_digest(secret))
        return secret, token

    async def tokens(self, user: str = "") -> list[Token]:
        return await asyncio.to_thread(self._store.tokens, user)

    async def revoke_token(self, id_: str, user: str = "") -> Token:
        """Revoke a token; with ``user``, only if it belongs to that user. Raises NotFound."""
        found = next((t for t in await self.tokens(user) if t.id == id_), None)
        if found is None:
            whose = f"{user} has" if user else "There is"
            raise NotFound(f"{whose} no token {id_!r}.", remedy="List them: labos token list")
        await asyncio.to_thread(self._store.revoke_token, id_, self._clock.now_ns())
        self._forget(lambda credential: credential.token == id_)
        return found

    # -- users ---------------------------------------------------------------------------------

    async def set_password(self, user: str, password: str) -> None:
        """Set a new password; all sessions of the user end. Raises BadInput."""
        check_password(password, user)
        await self._keep_password(user, password)
        await asyncio.to_thread(self._store.end_sessions, user)
        self._forget(lambda credential: credential.user == user and credential.how == "session")

    async def _keep_password(self, user: str, password: str) -> None:
        hash_ = await self._passwords.hash(password)
        await asyncio.to_thread(self._store.set_password, user, hash_, self._clock.now_ns())

    async def has_password(self, user: str) -> bool:
        return bool(await asyncio.to_thread(self._store.password, user))

    async def people(self) -> dict[str, Person]:
        return await asyncio.to_thread(self._store.people)

    async def set_person(self, person: Person) -> None:
        await asyncio.to_thread(self._store.set_person, person)

    async def erase(self, user: str) -> None:
        """Erase the user's name and everything with which they sign in; events with the user's id remain."""
        await asyncio.to_thread(self._store.erase, user)
        self._forget(lambda credential: credential.user == user)

    async def user_of(self, issuer: str, subject: str) -> str:
        return await asyncio.to_thread(self._store.user_of, issuer, subject)

    async def link(self, issuer: str, subject: str, user: str) -> None:
        await asyncio.to_thread(self._store.link, issuer, subject, user)

    async def check_again(self, keys: Collection[str]) -> None:
        """Ask the database whether the credentials with these keys are still valid: another process may have
        revoked them. The functions in ``on_end`` are called for those that are not."""
        for digest, (known, _) in list(self._known.items()):
            if known.key not in keys:
                continue
            if known.how == "session":
                is_good = await asyncio.to_thread(self._store.session, digest) is not None
            else:
                token = await asyncio.to_thread(self._store.token, digest)
                is_good = token is not None and not token.revoked_at
            if not is_good:
                self._forget_key(known.key)

    # -- internal ------------------------------------------------------------------------------

    def end_of_user(self, user: str) -> None:
        """The user may not act any more: streams that were opened with one of their credentials are
        closed."""
        self._forget(lambda credential: credential.user == user)

    def _forget_key(self, key: str) -> None:
        self._forget(lambda credential: credential.key == key)

    def _forget(self, which: Which) -> None:
        for digest, (credential, _) in list(self._known.items()):
            if which(credential):
                del self._known[digest]
        for listener in self.on_end:
            listener(which)

    def count_try(self, outcome: str) -> None:
        """Report an attempt to sign in, at the lab or with an identity provider."""
        for listener in self.on_try:
            listener(outcome)


def _make_key(digest: bytes) -> str:
    return digest.hex()[:16]


def _explain_sign_in(how: str) -> str:
    return "Sign in again." if how == "session" else "Sign in with `labos login`, or make a new token."


def _parse_scope(text: str) -> Need:
    return next((need for need in NEEDS if need == text), "viewer")

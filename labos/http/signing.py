"""Signing in and out, with a password or an identity provider; tokens, passwords, and names of users."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import msgspec
from starlette.responses import Response

from labos.core.state import LabState
from labos.errors import Forbidden, NotFound, Refused
from labos.http.identity import Gate
from labos.http.limits import Line, Name, Secret, says
from labos.ports import Person, Session, Token
from labos.services.accounts import Need, allows
from labos.services.accounts.accounts import MOST_DAYS, NEEDS, TOKEN_DAYS

if TYPE_CHECKING:
    from labos.http.operation import Call
    from labos.services.accounts.command_line import CommandLineSignIn

Days = Annotated[float, msgspec.Meta(gt=0, le=MOST_DAYS)]
Mail = Annotated[str, msgspec.Meta(max_length=254, pattern=r"\A([^\s@<>,]+@[^\s@<>,]+)?\Z")]
Sent = Annotated[str, msgspec.Meta(max_length=3_500)]
"""Data that a provider sends with a browser."""

_SECOND = 1_000_000_000


class SignIn(msgspec.Struct, forbid_unknown_fields=True):
    """The credentials with which a person signs in."""

    user: Annotated[Name, says("the user's id")]
    password: Annotated[Secret, says("the password")]
    token: Annotated[bool, says("a token for a program instead of a session for a browser")] = False
    label: Annotated[Line, says("what the token is for")] = "signed in"
    scope: Annotated[Need, says("the highest role that the token allows")] = "admin"
    days: Annotated[Days, says("the number of days for which the token is valid")] = 30.0


class SignedIn(msgspec.Struct, frozen=True):
    """``until`` is the end of the session or token (UTC nanoseconds). The ``token`` is shown only in this
    answer."""

    user: str
    until: int
    token: str = ""


class BeginSignIn(msgspec.Struct, forbid_unknown_fields=True):
    port: Annotated[int, msgspec.Meta(ge=0, le=65_535), says("the local port to which the browser returns")]
    device: Annotated[
        bool, says("there is no browser on this computer: get a code for a browser elsewhere")
    ] = False


class ProviderSignIn(msgspec.Struct, frozen=True):
    """``address`` is for a browser. ``state`` and ``key`` are needed to finish; the key is secret. ``code``
    is the code that the user enters if the browser does not return to this computer, and ``wait_s`` is the
    time to wait before the next request."""

    address: str
    state: str
    key: str
    code: str = ""
    wait_s: float = 0.0


class FinishSignIn(msgspec.Struct, forbid_unknown_fields=True):
    state: Annotated[Line, says("the value from the answer that began the sign-in")]
    key: Annotated[Line, says("the value from the answer that began the sign-in")]
    code: Annotated[Sent, says("the parameter with which the browser returned")] = ""
    iss: Annotated[Sent, says("the parameter with which the browser returned")] = ""
    error: Annotated[Sent, says("the parameter with which the browser returned")] = ""
    label: Annotated[Line, says("what the token is for")] = "signed in"
    scope: Annotated[Need, says("the highest role that the token allows")] = "admin"
    days: Annotated[
        Days, says("the number of days for which the token is valid; the lab may allow fewer")
    ] = 30.0


class FinishedSignIn(msgspec.Struct, frozen=True):
    """The ``token`` is shown only in this answer; ``until`` is its end (UTC nanoseconds). If ``wait_s`` is
    not 0, the code has not been entered yet, and the other fields are empty."""

    user: str = ""
    until: int = 0
    token: str = ""
    wait_s: float = 0.0


class Identity(msgspec.Struct, frozen=True):
    """The user who asks. ``how``: ``token``, ``session``, ``home`` (the owner of the lab's folder) or
    ``open`` (the lab has no users). ``scope`` is the highest role that the token or session allows; ``roles``
    are by workcell, ``*`` for the whole lab."""

    user: str
    how: str
    scope: str
    kind: str
    group: str
    roles: dict[str, str]
    name: str
    mail: str
    until: int


class NewToken(msgspec.Struct, forbid_unknown_fields=True):
    label: Annotated[Line, says("its purpose")] = ""
    scope: Annotated[Need, says("the highest role that it allows")] = "submitter"
    days: Annotated[Days, says("the number of days for which it is valid")] = float(TOKEN_DAYS)
    user: Annotated[Name, says("the owner; only admins may name another user")] = ""


class MadeToken(msgspec.Struct, frozen=True):
    """The ``secret`` is shown only in this answer: the lab stores only its digest."""

    token: Token
    secret: str


class Tokens(msgspec.Struct, frozen=True):
    tokens: list[Token]


class NewPassword(msgspec.Struct, forbid_unknown_fields=True):
    password: Annotated[Secret, says("the new password, at least 10 characters")]
    present: Annotated[Secret, says("the present password; required from users who change their own")] = ""


class PersonDetails(msgspec.Struct, forbid_unknown_fields=True):
    """Fields that are left out do not change."""

    name: Annotated[Line | None, says("the user's name")] = None
    mail: Annotated[Mail | None, says("an address")] = None


class ProviderIdentity(msgspec.Struct, forbid_unknown_fields=True):
    issuer: Annotated[Line, says("the identity provider, as `https://login.example.org`")]
    subject: Annotated[Line, says("the provider's id of the user (the claim `sub`)")]


class People(msgspec.Struct, frozen=True):
    """The users with a known name or address. Admins see all addresses; other users see only their own."""

    people: list[Person]


class UserReference(msgspec.Struct, frozen=True):
    user: str


def is_admin(call: Call) -> bool:
    """Whether the requesting user may help others to sign in."""
    if not call.who.is_known:
        return call.who.how == "home"
    state = call.kernel.state
    credential = call.who.credential
    group = state.shares.group_of.get(call.who.user, "")
    wide = credential is not None and allows(credential.scope, "admin")
    return wide and state.users.rank_role(call.who.user, group, "*") == NEEDS.index("admin")


def expect_self_or_admin(call: Call, user: str) -> None:
    """Raises Forbidden, also for a program that wants to change how another user signs in; NotFound."""
    who, known = call.who.user, call.kernel.state.users.known
    if who != user and not is_admin(call):
        raise Forbidden(
            f"Only {user} and admins of the lab may do that.", remedy="Ask an admin, or name yourself."
        )
    if user not in known:
        raise NotFound(f"This lab has no user {user!r}.", remedy="List them: labos user list")
    if who != user and is_program(call):
        raise Forbidden(
            f"{who} is a service account, and cannot change credentials of others: a program that signs in "
            "as a person could approve its own requests, and as another program could act in its name.",
            remedy="Ask an admin who is a person.",
        )


def is_program(call: Call) -> bool:
    """Whether the requesting user is a service account."""
    known = call.kernel.state.users.known.get(call.who.user) if call.who.is_known else None
    return known is not None and known.kind == "service"


def expect_users(state: LabState) -> None:
    """Raises Refused in a lab without users."""
    if state.users.is_open:
        raise Refused(
            "This lab has no users: nobody needs to sign in.",
            remedy="Add the first, on the lab's computer: labos user add NAME",
        )


def give_cookie(gate: Gate, answer: Response, secret: str, session: Session) -> None:
    """Set the cookie of a session: scripts cannot read it, and it is not sent with requests that pages of
    other sites cause."""
    answer.set_cookie(
        gate.cookie,
        secret,
        max_age=(session.expires_at - session.created_at) // _SECOND,
        path="/",
        secure=gate.secure,
        httponly=True,
        samesite="strict",
    )


def answer_secret(value: msgspec.Struct, status: int = 200) -> Response:
    # Not for a cache: it may contain a secret.
    headers = {"cache-control": "no-store"}
    return Response(msgspec.json.encode(value), status, headers, "application/json")


def find_way(call: Call) -> CommandLineSignIn:
    """Raises Refused, NotFound."""
    expect_users(call.kernel.state)
    found = call.api.gate.command_line
    if found is None:
        raise NotFound(
            "This lab has no identity provider.", remedy="Sign in with a password: labos login --user NAME"
        )
    return found

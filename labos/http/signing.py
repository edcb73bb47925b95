"""Signing in and out, tokens, passwords, and names of users."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import msgspec
from starlette.responses import Response

from labos.core.decide.users import EraseUser
from labos.core.state import LabState
from labos.core.users import LABOS, group_subject, user_subject
from labos.errors import BadInput, Forbidden, NotFound, NotSignedIn, Refused
from labos.http.identity import SIGN_IN, Gate, Who
from labos.http.limits import Line, Name, Secret, says
from labos.ports import Person, Session, Token
from labos.services.accounts import Accounts, Need, allows
from labos.services.accounts.accounts import MOST_DAYS, NEEDS, TOKEN_DAYS

if TYPE_CHECKING:
    from labos.http.operation import Call

Days = Annotated[float, msgspec.Meta(gt=0, le=MOST_DAYS)]
Mail = Annotated[str, msgspec.Meta(max_length=254, pattern=r"\A([^\s@<>,]+@[^\s@<>,]+)?\Z")]

_SECOND = 1_000_000_000
_DAY = 86_400 * _SECOND


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
    if who != user and _is_program(call):
        raise Forbidden(
            f"{who} is a service account, and cannot change credentials of others: a program that signs in "
            "as a person could approve its own requests, and as another program could act in its name.",
            remedy="Ask an admin who is a person.",
        )


def _is_program(call: Call) -> bool:
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


async def sign_in(call: Call, body: SignIn) -> Response:
    expect_users(call.kernel.state)
    gate, accounts = call.api.gate, call.api.gate.accounts
    client = call.request.client
    await accounts.expect_password(body.user, body.password, client.host if client is not None else "")
    if body.token:
        secret, token = await accounts.make_token(body.user, body.label, body.scope, body.days)
        return answer_secret(SignedIn(body.user, token.expires_at, secret))
    secret, session = await accounts.begin_session(
        body.user, "password", before=call.request.cookies.get(gate.cookie, "")
    )
    answer = answer_secret(SignedIn(body.user, session.expires_at))
    give_cookie(gate, answer, secret, session)
    return answer


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


async def sign_out(call: Call) -> Response:
    gate, accounts = call.api.gate, call.api.gate.accounts
    credential = call.who.credential
    if credential is not None and credential.token:
        await accounts.revoke_token(credential.token)
    cookie = call.request.cookies.get(gate.cookie, "")
    if cookie and call.who.how == "session":
        await accounts.end_session(cookie)
    answer = answer_secret(UserReference(call.who.user))
    answer.delete_cookie(gate.cookie, path="/", secure=gate.secure, httponly=True, samesite="strict")
    return answer


async def find_identity(call: Call) -> Identity:
    who, state = call.who, call.kernel.state
    known = state.users.known.get(who.user)
    person = (await call.api.gate.accounts.people()).get(who.user, Person(who.user))
    group = state.shares.group_of.get(who.user, "")
    roles = dict(state.users.roles.get(group_subject(group), {})) | dict(
        state.users.roles.get(user_subject(who.user), {})
    )
    is_open = state.users.is_open
    scope = "admin" if is_open else "viewer"
    return Identity(
        who.user,
        "open" if is_open else who.how,
        who.credential.scope if who.credential is not None else scope,
        known.kind if known is not None else "",
        group,
        {str(scope): str(role) for scope, role in roles.items()},
        person.name,
        person.mail,
        who.credential.until if who.credential is not None else 0,
    )


async def make_token(call: Call, body: NewToken) -> MadeToken:
    """Raises Forbidden, NotFound, BadInput."""
    expect_users(call.kernel.state)
    user = body.user or call.who.user
    if not user:
        raise BadInput("The token needs a user.", remedy="Name its user: --user NAME")
    expect_self_or_admin(call, user)
    credential, days = call.who.credential, body.days
    if credential is not None:
        if not allows(credential.scope, body.scope):
            raise Forbidden(
                f"The token {credential.token} has the role {credential.scope}, so it cannot make a "
                f"token with the role {body.scope}.",
                remedy=SIGN_IN,
            )
        if credential.token:  # a stolen token must not live on in tokens that were made with it
            now = call.kernel.clock.now_ns()
            days = min(days, (credential.until - now) / _DAY)
    secret, token = await call.api.gate.accounts.make_token(user, body.label, body.scope, days)
    return MadeToken(token, secret)


async def list_tokens(call: Call, user: str) -> list[Token]:
    """Raises Forbidden."""
    if call.who.is_known and user != call.who.user and user and not is_admin(call):
        raise Forbidden(f"Only {user} and admins can manage the tokens of {user}.", remedy="Name yourself.")
    return await call.api.gate.accounts.tokens(user or call.who.user)


async def revoke_token(call: Call, id_: str) -> Token:
    """Raises NotFound, also for a token of another user; admins who are persons may revoke any token."""
    any_ = is_admin(call) and not _is_program(call)
    return await call.api.gate.accounts.revoke_token(id_, "" if any_ else call.who.user)


async def change_password(call: Call, user: str, body: NewPassword) -> None:
    """Raises Forbidden, NotFound, NotSignedIn for a wrong present password, BadInput for an unsuitable new
    one."""
    expect_self_or_admin(call, user)
    accounts: Accounts = call.api.gate.accounts
    if call.kernel.state.users.known[user].kind == "service":
        raise BadInput(
            f"{user} is a service account.", remedy=f"Make a token for it: labos token create --user {user}"
        )
    if call.who.user == user and await accounts.has_password(user):
        client = call.request.client
        try:
            await accounts.expect_password(user, body.present, client.host if client is not None else "")
        except NotSignedIn:
            raise Forbidden(
                "The present password is wrong.", remedy="Ask an admin if you forgot it."
            ) from None
    await accounts.set_password(user, body.password)


async def change_person(call: Call, user: str, body: PersonDetails) -> Person:
    """Raises Forbidden, NotFound."""
    expect_self_or_admin(call, user)
    accounts = call.api.gate.accounts
    present = (await accounts.people()).get(user, Person(user))
    name = present.name if body.name is None else body.name
    mail = present.mail if body.mail is None else body.mail
    person = Person(user, name, mail)
    await accounts.set_person(person)
    return person


async def erase_person(call: Call, user: str) -> None:
    """Erase a user's name, address, password, tokens and sessions; then record the erasure in the log, with
    the id alone. Raises Forbidden, NotFound."""
    expect_self_or_admin(call, user)
    by = call.who.user if call.who.is_known else LABOS  # the owner of the lab's folder has no name
    await call.api.gate.accounts.erase(user)
    await call.kernel.execute(EraseUser(user, by), call.who.actor if call.who.is_known else LABOS)


async def list_people(call: Call) -> People:
    people = (await call.api.gate.accounts.people()).values()
    all_mails = is_admin(call)
    return People(
        [
            person if all_mails or person.user == call.who.user else Person(person.user, person.name)
            for person in people
        ]
    )


def expect_admin(who: Who, call: Call) -> None:
    """Raises Forbidden."""
    if not is_admin(call):
        raise Forbidden("Only admins of the lab may do that.", remedy="Ask one of them.")


def answer_secret(value: msgspec.Struct) -> Response:
    # Not for a cache: it may contain a secret.
    headers = {"cache-control": "no-store"}
    return Response(msgspec.json.encode(value), 200, headers, "application/json")

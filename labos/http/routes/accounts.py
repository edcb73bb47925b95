"""Users: signing in and out, tokens of programs, names and passwords."""

from __future__ import annotations

from functools import partial
from typing import Annotated

import msgspec
from starlette.responses import Response

from labos.core.decide.users import EraseUser
from labos.core.recurrence import DAY_NS
from labos.core.users import LABOS, group_subject, user_subject
from labos.errors import BadInput, Forbidden, NotSignedIn
from labos.http import signing
from labos.http.identity import SIGN_IN
from labos.http.limits import Name, says
from labos.http.operation import Call, Method, Operation, read
from labos.http.providing import find_user_meant
from labos.http.queries import OfUser
from labos.http.signing import (
    answer_secret,
    expect_self_or_admin,
    expect_users,
    give_cookie,
    is_admin,
    is_program,
)
from labos.ports import Person
from labos.services.accounts import allows


class OfToken(msgspec.Struct, frozen=True):
    token: Annotated[Name, says("a token's id, which is not a secret", "3f9a01c4")]


class TokensQuery(msgspec.Struct, frozen=True):
    user: Annotated[Name, says("the owner; only admins may name another user")] = ""


_TOKEN = {
    "id": "3f9a01c4",
    "user": "ada",
    "label": "color picker",
    "scope": "submitter",
    "created_at": 1767225600000000000,
    "expires_at": 1775001600000000000,
    "used_at": 0,
    "revoked_at": 0,
}
_USER = {"user": "ada"}

_of_user = partial(Operation, needs="viewer", by_home=True)
"""What users do for themselves; admins and the owner of the lab's folder may do it for them."""


@Operation(
    route="POST /login",
    client=Method("sign_in", fixed={"token": True}),
    answer=signing.SignedIn,
    summary="Sign in with a password",
    needs="nobody",
    secret=True,
    problems=("refused", "too_many_tries"),
    example={"user": "ada", "password": "four words of yours"},
    example_answer={"user": "ada", "until": 1767268800000000000, "token": ""},
)
async def sign_in(call: Call, body: signing.SignIn) -> Response:
    """A browser gets a session of 12 hours, as a cookie that scripts cannot read. A program asks for a
    `token`. After six wrong attempts within a minute, further attempts are refused."""
    expect_users(call.kernel.state)
    gate, accounts = call.api.gate, call.api.gate.accounts
    await accounts.expect_password(body.user, body.password, call.address)
    if body.token:
        secret, token = await accounts.make_token(body.user, body.label, body.scope, body.days)
        return answer_secret(signing.SignedIn(body.user, token.expires_at, secret))
    before = call.request.cookies.get(gate.cookie, "")
    secret, session = await accounts.begin_session(body.user, "password", before=before)
    answer = answer_secret(signing.SignedIn(body.user, session.expires_at))
    give_cookie(gate, answer, secret, session)
    return answer


@Operation(
    route="POST /login/provider",
    client=Method("begin_sign_in"),
    answer=signing.ProviderSignIn,
    summary="Begin to sign in with an identity provider: get the address of its page",
    needs="nobody",
    secret=True,
    at_kernel=True,
    problems=("refused", "not_found", "too_many_tries"),
    example={"port": 49152, "device": False},
    example_answer={
        "address": "https://login.example.org/auth?client_id=labos",
        "state": "q4",
        "key": "b7",
        "code": "",
        "wait_s": 0.0,
    },
)
async def begin_sign_in(call: Call, body: signing.BeginSignIn) -> Response:
    """For a command line. The user opens the address in a browser. On the same computer, the browser returns
    to a local port. For a `device` without a browser, the user enters the code in a browser elsewhere. The
    sign-in expires after ten minutes."""
    way = signing.find_way(call)
    if body.device:
        begun, shown = await way.begin_device()
        found = signing.ProviderSignIn(
            begun.address, begun.state, begun.browser, shown.user_code, max(shown.interval, 1.0)
        )
    else:
        begun = await way.begin(body.port)
        found = signing.ProviderSignIn(begun.address, begun.state, begun.browser)
    return answer_secret(found)


@Operation(
    route="POST /login/provider/finish",
    client=Method("finish_sign_in", "state, key"),
    answer=signing.FinishedSignIn,
    summary="Finish signing in with an identity provider: get a token",
    needs="nobody",
    secret=True,
    at_kernel=True,
    problems=("refused", "not_found"),
    example={"state": "q4", "key": "b7", "code": "x9", "iss": "https://login.example.org"},
    example_answer={"user": "ada", "until": 1767268800000000000, "token": "", "wait_s": 5.0},
)
async def finish_sign_in(call: Call, body: signing.FinishSignIn) -> Response:
    """The request holds the parameters with which the browser returned from the provider. For a `device`
    there are none: repeat the request every `wait_s` seconds until there is a token."""
    from labos.services.accounts.command_line import RetryAfter  # few labs have a provider

    way, accounts = signing.find_way(call), call.api.gate.accounts
    sent = {"state": body.state, "code": body.code, "iss": body.iss, "error": body.error}
    try:
        claims = await way.finish({name: text for name, text in sent.items() if text}, body.key)
        if isinstance(claims, RetryAfter):
            return answer_secret(signing.FinishedSignIn(wait_s=claims.seconds))
        user = await find_user_meant(call.api, way.provider, claims)
    except NotSignedIn:
        accounts.count_try("wrong")
        raise
    accounts.count_try("right")
    secret, token = await accounts.make_token(user, body.label, body.scope, min(body.days, way.most_days))
    return answer_secret(signing.FinishedSignIn(user, token.expires_at, secret))


@Operation(
    route="POST /logout",
    client=Method("sign_out", take=None),
    answer=signing.UserReference,
    summary="Sign out",
    needs="viewer",
    secret=True,
    example_answer=_USER,
)
async def sign_out(call: Call) -> Response:
    """The session of the cookie ends, or the token of the request is revoked. Their open streams end too."""
    gate, accounts = call.api.gate, call.api.gate.accounts
    credential = call.who.credential
    if credential is not None and credential.token:
        await accounts.revoke_token(credential.token)
    cookie = call.request.cookies.get(gate.cookie, "")
    if cookie and call.who.how == "session":
        await accounts.end_session(cookie)
    answer = answer_secret(signing.UserReference(call.who.user))
    answer.delete_cookie(gate.cookie, path="/", secure=gate.secure, httponly=True, samesite="strict")
    return answer


@read(
    route="GET /whoami",
    client=Method("identity"),
    summary="Show the user who asks, and the user's rights",
)
async def get_identity(call: Call) -> signing.Identity:
    who, state = call.who, call.kernel.state
    known = state.users.known.get(who.user)
    person = (await call.api.gate.accounts.people()).get(who.user, Person(who.user))
    group = state.shares.group_of.get(who.user, "")
    roles = {
        **state.users.roles.get(group_subject(group), {}),
        **state.users.roles.get(user_subject(who.user), {}),
    }
    is_open = state.users.is_open
    scope = "admin" if is_open else "viewer"
    return signing.Identity(
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


@read(
    route="GET /tokens",
    client=Method("tokens", "user", take="tokens"),
    summary="Tokens of programs",
    example_answer={"tokens": [_TOKEN]},
)
async def list_tokens(call: Call, query: TokensQuery) -> signing.Tokens:
    """The answer has no secrets: the lab does not store them."""
    user = query.user
    if call.who.is_known and user != call.who.user and user and not is_admin(call):
        raise Forbidden(f"Only {user} and admins can manage the tokens of {user}.", remedy="Name yourself.")
    return signing.Tokens(await call.api.gate.accounts.tokens(user or call.who.user))


@_of_user(
    route="POST /tokens",
    client=Method("make_token", "label"),
    answer=signing.MadeToken,
    summary="Make a token for a program",
    secret=True,
    status=201,
    problems=("refused", "not_found"),
    example={"label": "color picker", "scope": "submitter", "days": 90},
    example_answer={"token": _TOKEN, "secret": "labos_token_…"},
)
async def make_token(call: Call, body: signing.NewToken) -> Response:
    """The secret is shown only in this answer. A token that was made with another token is never valid longer
    and never allows more than that one."""
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
            days = min(days, (credential.until - now) / DAY_NS)
    secret, token = await call.api.gate.accounts.make_token(user, body.label, body.scope, days)
    return answer_secret(signing.MadeToken(token, secret), 201)


@_of_user(
    route="POST /tokens/{token}/revoke",
    client=Method("revoke_token", take=None, repeat=True),
    summary="Revoke a token",
    example_answer=_USER,
)
async def revoke_token(call: Call, path: OfToken) -> signing.UserReference:
    """The token is invalid from now on; streams that were opened with it end."""
    any_ = is_admin(call) and not is_program(call)
    token = await call.api.gate.accounts.revoke_token(path.token, "" if any_ else call.who.user)
    return signing.UserReference(token.user)


@read(
    route="GET /people",
    client=Method("people", take="people"),
    summary="List the names of users",
    example_answer={"people": [{"user": "ada", "name": "Ada Byron", "mail": ""}]},
)
async def list_people(call: Call) -> signing.People:
    people = (await call.api.gate.accounts.people()).values()
    all_mails = is_admin(call)
    return signing.People(
        [
            person if all_mails or person.user == call.who.user else Person(person.user, person.name)
            for person in people
        ]
    )


@_of_user(
    route="POST /users/{user}/password",
    client=Method("set_password", "user, password, present", take=None),
    summary="Change a user's password",
    secret=True,
    problems=("too_many_tries",),
    example={"password": "four other words of yours", "present": "four words of yours"},
    example_answer=_USER,
)
async def change_password(call: Call, path: OfUser, body: signing.NewPassword) -> signing.UserReference:
    """All sessions of the user end; tokens stay."""
    user, accounts = path.user, call.api.gate.accounts
    expect_self_or_admin(call, user)
    if call.kernel.state.users.known[user].kind == "service":
        raise BadInput(
            f"{user} is a service account.", remedy=f"Make a token for it: labos token create --user {user}"
        )
    if call.who.user == user and await accounts.has_password(user):
        try:
            await accounts.expect_password(user, body.present, call.address)
        except NotSignedIn:
            raise Forbidden(
                "The present password is wrong.", remedy="Ask an admin if you forgot it."
            ) from None
    await accounts.set_password(user, body.password)
    return signing.UserReference(path.user)


@_of_user(
    route="POST /users/{user}/person",
    client=Method("set_person", take=None, repeat=True),
    summary="Change the name and address of a user",
    secret=True,
    example={"name": "Ada Byron", "mail": "ada@example.org"},
    example_answer={"user": "ada", "name": "Ada Byron", "mail": "ada@example.org"},
)
async def change_person(call: Call, path: OfUser, body: signing.PersonDetails) -> Person:
    """They are stored beside the log, which contains only the ids of users."""
    expect_self_or_admin(call, path.user)
    accounts = call.api.gate.accounts
    present = (await accounts.people()).get(path.user, Person(path.user))
    name = present.name if body.name is None else body.name
    mail = present.mail if body.mail is None else body.mail
    person = Person(path.user, name, mail)
    await accounts.set_person(person)
    return person


@_of_user(
    route="POST /users/{user}/erase",
    client=Method("erase_person", take=None, repeat=True),
    summary="Erase a user's name, address and means of signing in",
    example_answer=_USER,
)
async def erase_person(call: Call, path: OfUser) -> signing.UserReference:
    """The name, the address, the password and all tokens and sessions are deleted. Events remain and contain
    the id. A further event records the erasure."""
    expect_self_or_admin(call, path.user)
    by = call.who.user if call.who.is_known else LABOS  # the owner of the lab's folder has no name
    await call.api.gate.accounts.erase(path.user)
    await call.kernel.execute(EraseUser(path.user, by), call.who.actor if call.who.is_known else LABOS)
    return signing.UserReference(path.user)


@Operation(
    route="POST /users/{user}/identity",
    client=Method("link_identity", take=None, repeat=True),
    summary="Link a user to an account at an identity provider",
    needs="admin",
    by_home=True,
    example={"issuer": "https://login.example.org", "subject": "248289761001"},
    example_answer=_USER,
)
async def link_identity(call: Call, path: OfUser, body: signing.ProviderIdentity) -> signing.UserReference:
    """The account with this `subject` at the identity provider belongs to this user."""
    if not is_admin(call):
        raise Forbidden("Only admins of the lab may do that.", remedy="Ask one of them.")
    expect_self_or_admin(call, path.user)
    await call.api.gate.accounts.link(body.issuer, body.subject, path.user)
    return signing.UserReference(path.user)

"""Users: signing in and out, tokens of programs, names and passwords."""

from __future__ import annotations

from typing import Annotated

import msgspec
from starlette.responses import Response

from labos.http import provider_sign_in, signing
from labos.http.limits import Name
from labos.http.method import Method
from labos.http.operation import Call, Operation, list_operations
from labos.http.queries import OfUser
from labos.ports import Person


class OfToken(msgspec.Struct, frozen=True):
    token: Annotated[
        Name, msgspec.Meta(description="a token's id, which is not a secret", examples=["3f9a01c4"])
    ]


class TokensQuery(msgspec.Struct, frozen=True):
    user: Annotated[Name, msgspec.Meta(description="the owner; only admins may name another user")] = ""


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
    return await signing.sign_in(call, body)


@Operation(
    route="POST /login/provider",
    client=Method("begin_sign_in"),
    answer=provider_sign_in.ProviderSignIn,
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
async def begin_sign_in(call: Call, body: provider_sign_in.BeginSignIn) -> Response:
    """For a command line. The user opens the address in a browser. On the same computer, the browser returns
    to a local port. For a `device` without a browser, the user enters the code in a browser elsewhere. The
    sign-in expires after ten minutes."""
    return await provider_sign_in.begin(call, body)


@Operation(
    route="POST /login/provider/finish",
    client=Method("finish_sign_in", "state, key"),
    answer=provider_sign_in.FinishedSignIn,
    summary="Finish signing in with an identity provider: get a token",
    needs="nobody",
    secret=True,
    at_kernel=True,
    problems=("refused", "not_found"),
    example={"state": "q4", "key": "b7", "code": "x9", "iss": "https://login.example.org"},
    example_answer={"user": "ada", "until": 1767268800000000000, "token": "", "wait_s": 5.0},
)
async def finish_sign_in(call: Call, body: provider_sign_in.FinishSignIn) -> Response:
    """The request holds the parameters with which the browser returned from the provider. For a `device`
    there are none: repeat the request every `wait_s` seconds until there is a token."""
    return await provider_sign_in.finish(call, body)


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
    return await signing.sign_out(call)


@Operation(
    route="GET /whoami",
    client=Method("identity"),
    summary="Show the user who asks, and the user's rights",
    needs="viewer",
)
async def get_identity(call: Call) -> signing.Identity:
    return await signing.find_identity(call)


@Operation(
    route="GET /tokens",
    client=Method("tokens", "user", take="tokens"),
    summary="Tokens of programs",
    needs="viewer",
    example_answer={"tokens": [_TOKEN]},
)
async def list_tokens(call: Call, query: TokensQuery) -> signing.Tokens:
    """The answer has no secrets: the lab does not store them."""
    return signing.Tokens(await signing.list_tokens(call, query.user))


@Operation(
    route="POST /tokens",
    client=Method("make_token", "label"),
    answer=signing.MadeToken,
    summary="Make a token for a program",
    needs="viewer",
    by_home=True,
    secret=True,
    status=201,
    problems=("refused", "not_found"),
    example={"label": "color picker", "scope": "submitter", "days": 90},
    example_answer={"token": _TOKEN, "secret": "labos_token_…"},
)
async def make_token(call: Call, body: signing.NewToken) -> Response:
    """The secret is shown only in this answer. A token that was made with another token is never valid longer
    and never allows more than that one."""
    found = await signing.make_token(call, body)
    headers = {"cache-control": "no-store"}
    return Response(msgspec.json.encode(found), 201, headers, "application/json")


@Operation(
    route="POST /tokens/{token}/revoke",
    client=Method("revoke_token", take=None, repeat=True),
    summary="Revoke a token",
    needs="viewer",
    by_home=True,
    example_answer=_USER,
)
async def revoke_token(call: Call, path: OfToken) -> signing.UserReference:
    """The token is invalid from now on; streams that were opened with it end."""
    return signing.UserReference((await signing.revoke_token(call, path.token)).user)


@Operation(
    route="GET /people",
    client=Method("people", take="people"),
    summary="List the names of users",
    needs="viewer",
    example_answer={"people": [{"user": "ada", "name": "Ada Byron", "mail": ""}]},
)
async def list_people(call: Call) -> signing.People:
    return await signing.list_people(call)


@Operation(
    route="POST /users/{user}/password",
    client=Method("set_password", "user, password, present", take=None),
    summary="Change a user's password",
    needs="viewer",
    by_home=True,
    secret=True,
    problems=("too_many_tries",),
    example={"password": "four other words of yours", "present": "four words of yours"},
    example_answer=_USER,
)
async def change_password(call: Call, path: OfUser, body: signing.NewPassword) -> signing.UserReference:
    """All sessions of the user end; tokens stay."""
    await signing.change_password(call, path.user, body)
    return signing.UserReference(path.user)


@Operation(
    route="POST /users/{user}/person",
    client=Method("set_person", take=None, repeat=True),
    summary="Change the name and address of a user",
    needs="viewer",
    by_home=True,
    secret=True,
    example={"name": "Ada Byron", "mail": "ada@example.org"},
    example_answer={"user": "ada", "name": "Ada Byron", "mail": "ada@example.org"},
)
async def change_person(call: Call, path: OfUser, body: signing.PersonDetails) -> Person:
    """They are stored beside the log, which contains only the ids of users."""
    return await signing.change_person(call, path.user, body)


@Operation(
    route="POST /users/{user}/erase",
    client=Method("erase_person", take=None, repeat=True),
    summary="Erase a user's name, address and means of signing in",
    needs="viewer",
    by_home=True,
    example_answer=_USER,
)
async def erase_person(call: Call, path: OfUser) -> signing.UserReference:
    """The name, the address, the password and all tokens and sessions are deleted. Events remain and contain
    the id. A further event records the erasure."""
    await signing.erase_person(call, path.user)
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
    signing.expect_admin(call.who, call)
    signing.expect_self_or_admin(call, path.user)
    await call.api.gate.accounts.link(body.issuer, body.subject, path.user)
    return signing.UserReference(path.user)


OPERATIONS = list_operations(globals(), "accounts")

"""Signing in from a command line with an identity provider."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import msgspec
from starlette.responses import Response

from labos.errors import NotFound, NotSignedIn
from labos.http.limits import Line, says
from labos.http.providing import find_user_meant
from labos.http.signing import Days, answer_secret, expect_users
from labos.services.accounts import Need

if TYPE_CHECKING:
    from labos.http.operation import Call
    from labos.services.accounts.command_line import CommandLineSignIn

Sent = Annotated[str, msgspec.Meta(max_length=3_500)]
"""Data that a provider sends with a browser."""


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


async def begin(call: Call, body: BeginSignIn) -> Response:
    """Raises Refused, NotFound, NotSignedIn, TooManyTries."""
    way = _find_way(call)
    if body.device:
        begun, shown = await way.begin_device()
        found = ProviderSignIn(
            begun.address, begun.state, begun.browser, shown.user_code, max(shown.interval, 1.0)
        )
    else:
        begun = await way.begin(body.port)
        found = ProviderSignIn(begun.address, begun.state, begun.browser)
    return answer_secret(found)


async def finish(call: Call, body: FinishSignIn) -> Response:
    """Raises Refused, NotFound, NotSignedIn, BadInput."""
    from labos.services.accounts.command_line import RetryAfter  # few labs have a provider

    way, accounts = _find_way(call), call.api.gate.accounts
    sent = {"state": body.state, "code": body.code, "iss": body.iss, "error": body.error}
    try:
        claims = await way.finish({name: text for name, text in sent.items() if text}, body.key)
        if isinstance(claims, RetryAfter):
            return answer_secret(FinishedSignIn(wait_s=claims.seconds))
        user = await find_user_meant(call.api, way.provider, claims)
    except NotSignedIn:
        accounts.count_try("wrong")
        raise
    accounts.count_try("right")
    secret, token = await accounts.make_token(user, body.label, body.scope, min(body.days, way.most_days))
    return answer_secret(FinishedSignIn(user, token.expires_at, secret))


def _find_way(call: Call) -> CommandLineSignIn:
    expect_users(call.kernel.state)
    found = call.api.gate.command_line
    if found is None:
        raise NotFound(
            "This lab has no identity provider.", remedy="Sign in with a password: labos login --user NAME"
        )
    return found

"""Signing in from a command line with an identity provider."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import msgspec

from labos.errors import NotFound
from labos.http.limits import Line, says
from labos.http.signing import Days, expect_users
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


def find_way(call: Call) -> CommandLineSignIn:
    """Raises Refused, NotFound."""
    expect_users(call.kernel.state)
    found = call.api.gate.command_line
    if found is None:
        raise NotFound(
            "This lab has no identity provider.", remedy="Sign in with a password: labos login --user NAME"
        )
    return found

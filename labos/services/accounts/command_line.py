"""Signing in from a command line with an identity provider: through a browser on the same computer, which the
provider redirects back to the command line (RFC 8252), or with a code that the user types into a browser
elsewhere (device grant, RFC 8628).

The lab is the provider's client, not the command line: the PKCE verifier, the client's secret and the
provider's claims about users stay in the lab.
"""

from __future__ import annotations

import hmac
import secrets
from collections.abc import Mapping
from typing import Any
from urllib.parse import urlsplit

import httpx
import msgspec

from labos.errors import NotFound, TooManyTries
from labos.services.accounts.oidc import (
    TIMEOUT_S,
    AuthorizationRequest,
    Provider,
    ProviderClaims,
    ProviderClient,
    ProviderTokens,
    ask_provider,
    make_auth,
    make_refusal,
)

MOST_DEVICES = 100
"""The largest number of device codes that wait for users at the same time."""
LONGEST_S = 1_800.0
"""A device code expires after so many seconds at the latest, even if the provider allows more."""
GRANT = "urn:ietf:params:oauth:grant-type:device_code"
PENDING = ("authorization_pending", "slow_down")


class Shown(msgspec.Struct, frozen=True):
    """The code and the address that a device shows to its user. ``interval`` and ``expires_in`` in
    seconds."""

    device_code: str
    user_code: str
    verification_uri: str
    expires_in: float
    verification_uri_complete: str = ""
    interval: float = 5.0


class DeviceSignIn(msgspec.Struct):
    """A user is typing in a device code. The provider is asked again not before ``next`` (monotonic s)."""

    browser: str
    shown: Shown
    until: float
    interval: float
    next: float


class RetryAfter(msgspec.Struct, frozen=True):
    """The user has not typed in the code yet: ask again after so many seconds."""

    seconds: float


class CommandLineSignIn:
    """Signs in from a command line with one provider. Raises NotFound if the provider's file has no entry for
    command lines."""

    def __init__(self, provider: Provider) -> None:
        self.provider = provider
        self._devices: dict[str, DeviceSignIn] = {}

    @property
    def most_days(self) -> float:
        """The longest validity, in days, of a token that is issued here."""
        client = self.provider.settings.command_line
        return client.days if client is not None else 0.0

    def _make_client(self, port: int = 0) -> ProviderClient:
        settings = self.provider.settings
        if settings.command_line is None:
            raise NotFound(
                "In this lab, signing in from the command line with the identity provider is not enabled.",
                remedy="Sign in with a password (labos login --user NAME), or add a `command_line` client "
                "to oidc.yaml.",
            )
        return ProviderClient(
            settings.command_line.client_id,
            settings.secret_of_command_line,
            make_return_url(settings.lab, port),
        )

    async def begin(self, port: int) -> AuthorizationRequest:
        """The address for the user's browser; the browser returns to a port of the computer on which it runs.
        Raises NotFound, NotSignedIn."""
        return await self.provider.begin(self._make_client(port))

    async def begin_device(self) -> tuple[AuthorizationRequest, Shown]:
        """Begin a device grant: the code that the user has to type in, and the address where. Raises
        NotFound, NotSignedIn, TooManyTries."""
        client, now = self._make_client(), self.provider.clock.monotonic()
        known = await self.provider.discover()
        if not known.device_authorization_endpoint:
            raise NotFound(
                "The identity provider has no device grant.",
                remedy="Use a browser on this computer, or one elsewhere: labos login --code",
            )
        self._devices = {state: device for state, device in self._devices.items() if device.until > now}
        if len(self._devices) >= MOST_DEVICES:
            raise TooManyTries("Too many sign-ins with a code are open.", wait_s=60.0)
        form = {"client_id": client.id, "scope": " ".join(self.provider.settings.scopes)}
        async with httpx.AsyncClient(timeout=TIMEOUT_S) as http:
            shown = await ask_provider(
                http,
                "POST",
                known.device_authorization_endpoint,
                Shown,
                data=form,
                auth=make_auth(client),
            )
        state, browser = secrets.token_urlsafe(32), secrets.token_urlsafe(32)
        interval = max(shown.interval, 1.0)
        until = now + min(shown.expires_in, LONGEST_S)
        self._devices[state] = DeviceSignIn(browser, shown, until, interval, now + interval)
        address = shown.verification_uri_complete or shown.verification_uri
        return AuthorizationRequest(address, state, browser), shown

    async def finish(self, answer: Mapping[str, str], browser: str) -> ProviderClaims | RetryAfter:
        """The provider's claims about the user who has signed in, or when to ask again. Raises
        NotSignedIn."""
        device = self._devices.get(answer.get("state", ""))
        if device is None:
            return await self.provider.finish(answer, browser, by_command_line=True)
        if not hmac.compare_digest(device.browser.encode(), browser.encode()):
            raise make_refusal("another command line started this sign-in")
        now = self.provider.clock.monotonic()
        if now >= device.until:
            del self._devices[answer["state"]]
            raise make_refusal("the code was not entered")
        if now < device.next:
            return RetryAfter(device.next - now)
        device.next = now + device.interval
        return await self._ask(answer["state"], device)

    async def _ask(self, state: str, device: DeviceSignIn) -> ProviderClaims | RetryAfter:
        client, known = self._make_client(), await self.provider.discover()
        form = {"grant_type": GRANT, "device_code": device.shown.device_code, "client_id": client.id}
        async with httpx.AsyncClient(timeout=TIMEOUT_S, auth=make_auth(client)) as http:
            try:
                found = await http.post(known.token_endpoint, data=form)
            except httpx.HTTPError:
                return RetryAfter(device.interval)  # RFC 8628, 3.5: ask again
        if found.status_code == 400 and (error := _find_error(found.content)) in PENDING:
            if error == "slow_down":
                device.interval += 5.0
                device.next += 5.0
            return RetryAfter(device.interval)
        # From here on the code is used up: two command lines cannot get a token with the same code.
        if self._devices.pop(state, None) is None:
            raise make_refusal("the sign-in was not started here, or it has expired")
        if found.status_code != 200:
            raise make_refusal(f"the provider answers {_find_error(found.content)[:100]!r}")
        try:
            tokens = msgspec.json.decode(found.content, type=ProviderTokens)
        except (msgspec.MsgspecError, UnicodeDecodeError):
            raise make_refusal("its answer has no ID token") from None
        async with httpx.AsyncClient(timeout=TIMEOUT_S) as http:
            return await self.provider.claims_of(http, known, tokens, client)


def make_return_url(lab: str, port: int) -> str:
    """The address at which a browser returns to the command line that signs in to a lab. The lab's name is a
    part of it: if an attacker has led the command line to another lab's sign-in, nothing waits at that
    address (RFC 9700, 4.4)."""
    return f"http://127.0.0.1:{port}/login/{urlsplit(lab).netloc.lower().replace(':', '-')}"


def _find_error(content: bytes) -> str:
    try:
        found: Any = msgspec.json.decode(content)
    except (msgspec.MsgspecError, UnicodeDecodeError):
        return ""
    return str(found.get("error", "")) if isinstance(found, dict) else ""

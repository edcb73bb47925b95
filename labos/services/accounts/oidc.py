"""Signing in with an identity provider: OpenID Connect Core 1.0, authorization code flow with PKCE (RFC 7636,
S256), the issuer in the answer (RFC 9207), and keys by the provider's JWKS."""

from __future__ import annotations

import hashlib
import hmac
import secrets
from base64 import urlsafe_b64encode
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, TypeVar
from urllib.parse import urlencode

import httpx
import msgspec
import structlog

from labos.clock import Clock
from labos.errors import BadInput, NotSignedIn
from labos.services.accounts.provider_file import ProviderFile

if TYPE_CHECKING:
    from joserfc.jwk import KeySet

TIMEOUT_S = 10.0
KNOWN_S = 3600.0
"""For so many seconds the provider's metadata and keys are used without a new request."""
PENDING_S = 600.0
MOST_PENDING = 1_000
LEEWAY_S = 60
ALGORITHMS = (
    "RS256",
    "RS384",
    "RS512",
    "PS256",
    "PS384",
    "PS512",
    "ES256",
    "ES384",
    "ES512",
    "EdDSA",
    "Ed25519",
)
"""Signature algorithms with a private key that only the provider has."""
AGAIN = "Try again; if it fails again, ask an admin of the lab."

_log = structlog.get_logger(__name__)


T = TypeVar("T")


class ProviderClient(msgspec.Struct, frozen=True):
    """The lab's registration with the provider, and the address to which the provider sends users back."""

    id: str
    secret: str
    way_back: str


class Pending(msgspec.Struct, frozen=True):
    """A user who is at the provider's page now. ``browser`` is the secret that the user's browser or command
    line presents when it returns."""

    browser: str
    nonce: str
    verifier: str
    since: float
    client: ProviderClient


class ProviderClaims(msgspec.Struct, frozen=True):
    """The provider's claims about a user."""

    subject: str
    name: str = ""
    mail: str = ""
    groups: tuple[str, ...] = ()


class ProviderMetadata(msgspec.Struct, frozen=True):
    """The part of the provider's metadata that LabOS needs."""

    issuer: str
    authorization_endpoint: str
    token_endpoint: str
    jwks_uri: str
    userinfo_endpoint: str = ""
    device_authorization_endpoint: str = ""
    authorization_response_iss_parameter_supported: bool = False
    id_token_signing_alg_values_supported: tuple[str, ...] = ("RS256",)


class AuthorizationRequest(msgspec.Struct, frozen=True):
    """The address at which a user signs in, the ``state`` by which the return is recognised, and the secret
    that the browser presents then."""

    address: str
    state: str
    browser: str


class ProviderTokens(msgspec.Struct, frozen=True):
    """The tokens that a provider issues for a code."""

    id_token: str
    access_token: str = ""


class Provider:
    """One identity provider. Raises BadInput where joserfc is not installed."""

    def __init__(self, settings: ProviderFile, clock: Clock, way_back: str) -> None:
        try:
            import joserfc  # noqa: F401
        except ModuleNotFoundError:
            raise BadInput(
                "Signing in with an identity provider needs joserfc, which is not installed.",
                remedy='Run: pip install "labos-sdl[oidc]"',
            ) from None
        self.settings, self.clock = settings, clock
        self._browsers = ProviderClient(
            settings.client_id, settings.secret, settings.lab.rstrip("/") + way_back
        )
        self._pending: dict[str, Pending] = {}
        self._known: tuple[ProviderMetadata, float] | None = None
        self._keys: KeySet | None = None

    async def begin(self, client: ProviderClient | None = None) -> AuthorizationRequest:
        """Send a user to the provider: with a browser, or as another ``client``. Raises NotSignedIn if the
        provider does not answer."""
        client = client or self._browsers
        known = await self.discover()
        now = self.clock.monotonic()
        self._pending = {s: p for s, p in self._pending.items() if now - p.since < PENDING_S}
        while len(self._pending) >= MOST_PENDING:
            del self._pending[next(iter(self._pending))]
        state, browser, nonce, verifier = (secrets.token_urlsafe(32) for _ in range(4))
        self._pending[state] = Pending(browser, nonce, verifier, now, client)
        asked = {
            "response_type": "code",
            "client_id": client.id,
            "redirect_uri": client.way_back,
            "scope": " ".join(self.settings.scopes),
            "state": state,
            "nonce": nonce,
            "code_challenge": _encode_unpadded(hashlib.sha256(verifier.encode()).digest()),
            "code_challenge_method": "S256",
        }
        mark = "&" if "?" in known.authorization_endpoint else "?"
        return AuthorizationRequest(f"{known.authorization_endpoint}{mark}{urlencode(asked)}", state, browser)

    async def finish(
        self, answer: Mapping[str, str], browser: str, *, by_command_line: bool = False
    ) -> ProviderClaims:
        """The claims about the user whom the provider has sent back. An answer is accepted once, only from
        the browser that began the sign-in, and only in the way (browser or command line) in which it began.
        Raises NotSignedIn."""
        pending = self._pending.pop(answer.get("state", ""), None)
        if pending is None or self.clock.monotonic() - pending.since >= PENDING_S:
            raise make_refusal("the sign-in was not started here, or it has expired")
        if not hmac.compare_digest(pending.browser.encode(), browser.encode()):
            raise make_refusal("another browser started this sign-in")
        if by_command_line is (pending.client == self._browsers):
            raise make_refusal("another user started this sign-in")
        known = await self.discover()
        issuer = answer.get("iss", "")
        if issuer != known.issuer and (issuer or known.authorization_response_iss_parameter_supported):
            raise make_refusal(f"the answer is from {issuer[:100]!r}")
        if "error" in answer or not answer.get("code"):
            raise make_refusal(f"the provider answers {answer.get('error', 'nothing')[:100]!r}")
        async with httpx.AsyncClient(timeout=TIMEOUT_S) as http:
            tokens = await self._exchange(http, known, answer["code"], pending)
            return await self.claims_of(http, known, tokens, pending.client, pending.nonce)

    async def claims_of(
        self,
        http: httpx.AsyncClient,
        known: ProviderMetadata,
        tokens: ProviderTokens,
        client: ProviderClient,
        nonce: str = "",
    ) -> ProviderClaims:
        """The claims about the user whom the provider's tokens for ``client`` name; some providers send name
        and groups only on a separate request. Raises NotSignedIn."""
        claims = await self._verify(http, known, tokens.id_token, client.id, nonce)
        if known.userinfo_endpoint and self.settings.groups_claim not in claims:
            shown = {"authorization": f"Bearer {tokens.access_token}"}
            more = await ask_provider(http, "GET", known.userinfo_endpoint, dict, headers=shown)
            if more.get("sub") != claims["sub"]:
                raise make_refusal("its user data is about another user")
            claims = {**more, **claims}
        groups = claims.get(self.settings.groups_claim, [])
        return ProviderClaims(
            str(claims["sub"])[:500],
            str(claims.get("name", ""))[:500] if self.settings.keep_names else "",
            str(claims.get("email", ""))[:254] if self.settings.keep_names else "",
            tuple(str(group) for group in groups) if isinstance(groups, list) else (str(groups),),
        )

    # -- the provider ------------------------------------------------------------------------------

    async def discover(self) -> ProviderMetadata:
        now = self.clock.monotonic()
        if self._known is not None and now < self._known[1]:
            return self._known[0]
        address = self.settings.issuer.rstrip("/") + "/.well-known/openid-configuration"
        async with httpx.AsyncClient(timeout=TIMEOUT_S) as http:
            found = await ask_provider(http, "GET", address, ProviderMetadata)
        if found.issuer != self.settings.issuer:
            raise make_refusal(
                f"{address} belongs to {found.issuer[:100]!r}, not to {self.settings.issuer!r}"
            )
        self._known, self._keys = (found, now + KNOWN_S), None
        return found

    async def _exchange(
        self, http: httpx.AsyncClient, known: ProviderMetadata, code: str, pending: Pending
    ) -> ProviderTokens:
        client = pending.client
        form = {
            "grant_type": "authorization_code",
            "code": code,
            "redirect_uri": client.way_back,
            "client_id": client.id,
            "code_verifier": pending.verifier,
        }
        return await ask_provider(
            http, "POST", known.token_endpoint, ProviderTokens, data=form, auth=make_auth(client)
        )

    async def _fetch_keys(self, http: httpx.AsyncClient, known: ProviderMetadata) -> KeySet:
        from joserfc.errors import JoseError
        from joserfc.jwk import KeySet

        if self._keys is None:
            answer: Any = await ask_provider(http, "GET", known.jwks_uri, dict)
            try:
                self._keys = KeySet.import_key_set(answer)
            except (JoseError, ValueError, KeyError, TypeError) as error:
                raise make_refusal(f"its keys cannot be read ({type(error).__name__})") from None
        return self._keys

    async def _verify(
        self, http: httpx.AsyncClient, known: ProviderMetadata, token: str, client: str, nonce: str
    ) -> dict[str, Any]:
        """The claims of an id token, checked according to OpenID Connect Core 1.0, 3.1.3.7; an id token that
        no browser has requested has no ``nonce``."""
        from joserfc import jwt
        from joserfc.errors import JoseError

        allowed = [name for name in ALGORITHMS if name in known.id_token_signing_alg_values_supported]
        rules = jwt.JWTClaimsRegistry(
            now=int(self.clock.now_ns() // 1_000_000_000),
            leeway=LEEWAY_S,
            iss={"essential": True, "value": known.issuer},
            aud={"essential": True, "value": client},
            sub={"essential": True},
            exp={"essential": True},
            iat={"essential": True},
            nonce={"essential": True, "value": nonce} if nonce else {},
        )
        fresh = self._keys is None
        for _ in range(1 if fresh else 2):  # the provider may have changed its keys since
            keys = await self._fetch_keys(http, known)
            try:
                found = jwt.decode(token, keys, algorithms=allowed)
                rules.validate(found.claims)
                break
            except (JoseError, ValueError) as error:
                reason, self._keys = error, None
        else:
            raise make_refusal(f"its ID token is not valid ({type(reason).__name__}: {reason})")
        claims = dict(found.claims)
        others = isinstance(claims["aud"], list) and len(claims["aud"]) > 1
        if others and claims.get("azp") != client:
            raise make_refusal("its ID token is for another client")
        return claims


async def ask_provider(http: httpx.AsyncClient, method: str, url: str, kind: type[T], **options: Any) -> T:
    """The provider's answer. Raises NotSignedIn."""
    try:
        answer = await http.request(method, url, **options)
    except httpx.HTTPError as error:
        raise make_refusal(f"{url} does not answer ({type(error).__name__})") from None
    if answer.status_code != 200:
        try:
            why = str(answer.json().get("error", ""))[:100]
        except (ValueError, AttributeError):
            why = ""
        raise make_refusal(f"{url} answers {answer.status_code} {why}".rstrip())
    try:
        return msgspec.json.decode(answer.content, type=kind)
    except (msgspec.MsgspecError, UnicodeDecodeError):
        raise make_refusal(f"{url} sends an unexpected answer") from None


def make_auth(client: ProviderClient) -> httpx.BasicAuth | None:
    """The way in which a client with a secret authenticates itself."""
    return httpx.BasicAuth(client.id, client.secret) if client.secret else None


def make_refusal(why: str) -> NotSignedIn:
    """The refusal; it is also written to the program's log."""
    _log.warning("sign_in_refused", by="identity provider", why=why)
    return NotSignedIn(f"Signing in with the identity provider failed: {why}.", remedy=AGAIN)


def _encode_unpadded(data: bytes) -> str:
    return urlsafe_b64encode(data).rstrip(b"=").decode()

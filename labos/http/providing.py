"""Signing in with an identity provider: the two addresses that a browser opens, and the roles in the lab that
follow from the provider's groups."""

from __future__ import annotations

import html
from typing import TYPE_CHECKING

import structlog
from starlette.requests import Request
from starlette.responses import HTMLResponse, RedirectResponse, Response
from starlette.routing import Route

from labos.core.decide import LABOS, Command, Rejection
from labos.core.decide.users import AddMember, AddUser, GrantRole, RemoveMember, RevokeRole
from labos.core.users import Role, rank, user_subject
from labos.errors import NotSignedIn
from labos.http.door import WAY_BACK
from labos.http.signing import expect_users, give_cookie
from labos.ports import Person
from labos.services.accounts.accounts import make_id

if TYPE_CHECKING:
    from labos.http.operation import Api
    from labos.services.accounts.oidc import Provider, ProviderClaims

START = "/login/oidc"
COOKIE = "labos-way-back"

# A browser does not send strict cookies after a redirect from another site: this page makes it request the
# next page itself.
PAGE = (
    '<!doctype html><html lang="en"><meta charset="utf-8"><title>LabOS</title>\n<meta '
    'http-equiv="refresh" content="0;url=/"><p>{}</p><p><a href="/">Continue</a></p></html>\n'
)
HEADERS = {
    "cache-control": "no-store",
    "content-security-policy": "default-src 'none'; frame-ancestors 'none'",
    "referrer-policy": "no-referrer",
}

_log = structlog.get_logger(__name__)


def list_provider_routes(api: Api, provider: Provider) -> list[Route]:
    """The routes for one lab."""

    async def start(request: Request) -> Response:
        """Send the browser to the provider."""
        expect_users(api.kernel.state)
        begun = await provider.begin()
        answer = RedirectResponse(begun.address, 303, headers=HEADERS)
        secure = api.gate.secure
        # Lax: the cookie must be sent when the provider's page redirects the browser back.
        answer.set_cookie(
            _name_cookie(secure),
            begun.browser,
            max_age=600,
            path="/",
            secure=secure,
            httponly=True,
            samesite="lax",
        )
        return answer

    async def come_back(request: Request) -> Response:
        """The provider has redirected the browser back."""
        shown = request.cookies.get(_name_cookie(api.gate.secure), "")
        try:
            claims = await provider.finish(request.query_params, shown)
            user = await find_user_meant(api, provider, claims)
        except NotSignedIn:
            api.gate.accounts.count_try("wrong")
            raise
        api.gate.accounts.count_try("right")
        before = request.cookies.get(api.gate.cookie, "")
        secret, session = await api.gate.accounts.begin_session(user, "oidc", before)
        answer = HTMLResponse(PAGE.format(html.escape(f"You are {user}.")), headers=HEADERS)
        give_cookie(api.gate, answer, secret, session)
        answer.delete_cookie(_name_cookie(api.gate.secure), path="/", secure=api.gate.secure, httponly=True)
        return answer

    return [Route(START, start, methods=["GET"]), Route(WAY_BACK, come_back, methods=["GET"])]


def _name_cookie(secure: bool) -> str:
    return f"__Host-{COOKIE}" if secure else COOKIE


async def find_user_meant(api: Api, provider: Provider, claims: ProviderClaims) -> str:
    """The user for a provider's claims; a new user, if the provider file allows it. Raises NotSignedIn."""
    accounts, settings, state = api.gate.accounts, provider.settings, api.kernel.state
    user = await accounts.user_of(settings.issuer, claims.subject)
    if not user and settings.new_users:
        user = f"u-{make_id()}"
        await accounts.link(settings.issuer, claims.subject, user)
    if user and settings.new_users and user not in state.users.known:  # perhaps linked before a crash
        await api.kernel.execute(AddUser(user), LABOS)
    if not user:
        raise NotSignedIn(
            "The identity provider knows you, but this lab does not.",
            remedy=f"Ask an admin of the lab to run: labos user link NAME {settings.issuer} {claims.subject}",
        )
    if state.users.get(user) is None:
        raise NotSignedIn(f"The user {user} is disabled.", remedy="Ask an admin of the lab.")
    if claims.name or claims.mail:
        await accounts.set_person(Person(user, claims.name, claims.mail))
    for command in _list_changes(api, provider, user, frozenset(claims.groups)):
        answer = api.kernel.submit(command, LABOS)
        if isinstance(answer, Rejection):  # the file names a group or workcell that does not exist
            _log.warning("claim_not_followed", user=user, why=answer.message)
    await api.kernel.flush()
    return user


def _list_changes(api: Api, provider: Provider, user: str, claimed: frozenset[str]) -> list[Command]:
    """The commands that give the user the group and the roles of the provider file; others stay unchanged."""
    settings, state = provider.settings, api.kernel.state
    found: list[Command] = []
    wanted = next((group for claim, group in settings.groups.items() if claim in claimed), "")
    present = state.shares.group_of.get(user, "")
    if present != wanted and (present in settings.groups.values() or not present):
        found += [RemoveMember(present, user)] if present else []
        found += [AddMember(wanted, user)] if wanted else []
    subject = user_subject(user)
    held = state.users.roles.get(subject, {})
    named = [(claim in claimed, grant) for claim, grants in settings.roles.items() for grant in grants]
    given: dict[str, Role] = {}
    for _, grant in filter(lambda pair: pair[0], named):
        given[grant.workcell] = max(grant.role, given.get(grant.workcell, grant.role), key=rank)
    for scope, role in given.items():
        if held.get(scope) != role:
            found.append(GrantRole(subject, role, scope))
    for scope in {grant.workcell for has, grant in named if not has} - given.keys():
        if any(grant.role == held.get(scope) for _, grant in named if grant.workcell == scope):
            found.append(RevokeRole(subject, scope))
    return found

"""Signing in with a real identity provider (oidc-provider of npm), and what is tried against it."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any

import httpx
import msgspec
import pytest

from labos.bootstrap import LabThread
from labos.client import LabClient
from labos.core.decide.users import DisableUser, EnableUser
from tests.integration.http.provider import (
    Issuer,
    lab_with_provider,
    run_provider,
    sign_in_at_provider,
)
from tests.integration.http.signed import execute

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def issuer(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Issuer]:
    with run_provider(tmp_path_factory.mktemp("provider")) as found:
        yield found


@pytest.fixture(scope="module")
def lab(issuer: Issuer, tmp_path_factory: pytest.TempPathFactory) -> Iterator[LabThread]:
    with lab_with_provider(tmp_path_factory.mktemp("oidc"), issuer) as running:
        yield running


@pytest.fixture
def browser(lab: LabThread) -> Iterator[httpx.Client]:
    with httpx.Client(base_url=lab.url, timeout=30) as found:
        yield found


def to_the_way_back(browser: httpx.Client, name: str) -> httpx.URL:
    """Go to the provider, sign in and agree there; the address to which it sends the browser back."""
    answer = browser.get("/login/oidc")
    assert answer.status_code == 303, answer.text
    return sign_in_at_provider(browser, answer, name, "/login/oidc/callback")


def sign_in(browser: httpx.Client, name: str) -> httpx.Response:
    browser.cookies.clear()
    # As a browser says it that a page of another site has sent here.
    return browser.get(to_the_way_back(browser, name), headers={"sec-fetch-site": "cross-site"})


def check_refused(answer: httpx.Response) -> str:
    told: dict[str, Any] = answer.json()
    assert (answer.status_code, told["code"]) == (401, "not_signed_in"), answer.text
    assert "labos-session" not in answer.headers.get("set-cookie", "")
    return str(told["detail"])


def whoami(browser: httpx.Client) -> dict[str, Any]:
    found: dict[str, Any] = browser.get("/api/v1/whoami").json()
    return found


def test_whom_the_lab_does_not_know_it_does_not_let_in(browser: httpx.Client) -> None:
    assert "this lab does not" in check_refused(sign_in(browser, "eve-heads"))


def test_groups_and_roles_are_those_of_the_provider(
    lab: LabThread, browser: httpx.Client, issuer: Issuer
) -> None:
    with LabClient(home=lab.settings.home) as home:
        home.link_identity("bob", issuer.url, "bob-operators-chemists")
        home.link_identity("bob", issuer.url, "bob")
    answer = sign_in(browser, "bob-operators-chemists")
    assert answer.status_code == 200, answer.text
    assert "bob" in answer.text
    cookies = answer.headers["set-cookie"].lower()
    assert "samesite=strict" in cookies
    assert "httponly" in cookies
    found = whoami(browser)
    assert (found["user"], found["how"], found["group"]) == ("bob", "session", "chemistry")
    assert found["roles"] == {"*": "submitter", "rpl": "operator"}
    assert found["name"] == "Person bob-operators-chemists"
    # Another time the provider says less of him; what it never gave stays.
    assert sign_in(browser, "bob").status_code == 200
    found = whoami(browser)
    assert (found["user"], found["group"], found["roles"]) == ("bob", "", {"*": "submitter"})


def test_a_way_back_is_good_once_and_for_one_browser(lab: LabThread, browser: httpx.Client) -> None:
    address = to_the_way_back(browser, "bob")
    with httpx.Client(base_url=lab.url) as another:
        assert "another browser" in check_refused(another.get(address))
    check_refused(browser.get(address))  # it was tried
    address = to_the_way_back(browser, "bob")
    assert browser.get(address).status_code == 200
    assert "the sign-in was not started here" in check_refused(browser.get(address))


@pytest.mark.parametrize(
    ("change", "why"),
    [
        ({"state": "x"}, "the sign-in was not started here"),
        ({"iss": "https://evil.example"}, "the answer is from"),
        ({"iss": ""}, "the answer is from"),
        ({"code": ""}, "answers 'nothing'"),
        ({"code": "x"}, "invalid_grant"),
        ({"error": "access_denied"}, "access_denied"),
    ],
)
def test_a_forged_answer_is_refused(browser: httpx.Client, change: dict[str, str], why: str) -> None:
    address = to_the_way_back(browser, "bob")
    assert why in check_refused(browser.get(address.copy_merge_params(change)))


@pytest.mark.parametrize(
    ("field", "why"), [("verifier", "invalid_grant"), ("nonce", "ID token is not valid")]
)
def test_a_code_of_somebody_else_is_refused(
    lab: LabThread, browser: httpx.Client, field: str, why: str
) -> None:
    """Without PKCE and nonce a code that was caught elsewhere would be as good as one's own."""
    address = to_the_way_back(browser, "bob")
    provider = lab.runtime.gate.provider
    assert provider is not None
    for state, pending in provider._pending.items():
        provider._pending[state] = msgspec.structs.replace(pending, **{field: "another" * 8})
    assert why in check_refused(browser.get(address))


def test_a_disabled_user_stays_out(lab: LabThread, browser: httpx.Client) -> None:
    execute(lab, DisableUser("bob"), "ada")
    assert "disabled" in check_refused(sign_in(browser, "bob"))
    execute(lab, EnableUser("bob"), "ada")


def test_new_users_get_an_id_that_says_nothing(
    lab: LabThread, browser: httpx.Client, monkeypatch: pytest.MonkeyPatch
) -> None:
    provider = lab.runtime.gate.provider
    assert provider is not None
    monkeypatch.setattr(provider, "settings", provider.settings.model_copy(update={"new_users": True}))
    assert sign_in(browser, "carol-heads").status_code == 200
    found = whoami(browser)
    assert re.fullmatch(r"u-[0-9a-f]{8}", found["user"])
    assert found["roles"] == {"*": "admin", "rpl": "viewer"}
    again = found["user"]
    assert sign_in(browser, "carol-heads").status_code == 200
    assert whoami(browser)["user"] == again
    events = browser.get("/api/v1/events").text
    assert "arol" not in events

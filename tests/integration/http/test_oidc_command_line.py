"""`labos login` with a real identity provider: by a browser that comes back, by a code typed in elsewhere, by
an address that is pasted; and what is tried against each."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from threading import Thread
from typing import Any
from urllib.parse import parse_qs, urlsplit

import httpx
import pytest

from labos.bootstrap import LabThread
from labos.cli._provider import OWN, _Listener
from labos.client import LabClient
from labos.errors import NotFound, NotSignedIn
from tests.foreign.make import ROOT
from tests.integration.http.provider import (
    Issuer,
    lab_with_provider,
    run_provider,
    sign_in_at_provider,
)

pytestmark = pytest.mark.slow

BROWSER = f"{sys.executable} -m tests.integration.http.provider bob %s &"


@pytest.fixture(scope="module")
def issuer(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Issuer]:
    with run_provider(tmp_path_factory.mktemp("provider")) as found:
        yield found


@pytest.fixture(scope="module")
def lab(issuer: Issuer, tmp_path_factory: pytest.TempPathFactory) -> Iterator[LabThread]:
    with lab_with_provider(tmp_path_factory.mktemp("oidc"), issuer) as running:
        with LabClient(home=running.settings.home) as home:
            home.link_identity("bob", issuer.url, "bob")
        yield running


@pytest.fixture
def anybody(lab: LabThread) -> Iterator[LabClient]:
    with LabClient(lab.url, token="") as found:
        yield found


class Shell:
    """A person's command line, with files of their own."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        clean = {name: text for name, text in os.environ.items() if not name.startswith("LABOS_")}
        self.environment = {**clean, "XDG_CONFIG_HOME": str(folder), "BROWSER": BROWSER}

    @property
    def tokens(self) -> dict[str, str]:
        file = self._folder / "labos" / "tokens.json"
        assert file.stat().st_mode & 0o777 == 0o600
        found: dict[str, str] = json.loads(file.read_text())
        return found

    def start(self, *words: str, **environment: str) -> subprocess.Popen[str]:
        return subprocess.Popen(
            [sys.executable, "-m", "labos", *words],
            env={**self.environment, **environment},
            cwd=ROOT,
            text=True,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
        )

    def run(self, *words: str, typed: str = "", fails: bool = False, **environment: str) -> str:
        with self.start(*words, **environment) as process:
            said, complained = process.communicate(typed, timeout=120)
        assert (process.returncode != 0) is fails, said + complained
        return said + complained


@pytest.fixture
def shell(tmp_path: Path) -> Shell:
    return Shell(tmp_path)


def line_with(process: subprocess.Popen[str], begin: str) -> str:
    """The next line on standard error that begins so."""
    assert process.stderr is not None
    for line in process.stderr:
        if line.strip().startswith(begin):
            return line.strip()
    raise AssertionError(f"no line begins with {begin!r}")


def test_a_browser_comes_back_to_the_command(lab: LabThread, shell: Shell) -> None:
    said = shell.run("login", lab.url, "--scope", "submitter", "--days", "30")
    assert f"You are signed in as bob at {lab.url}" in said
    assert list(shell.tokens) == [lab.url]
    told = json.loads(shell.run("whoami", "--json", LABOS_URL=lab.url))
    assert (told["user"], told["how"], told["scope"]) == ("bob", "token", "submitter")
    secret = shell.tokens[lab.url]
    with LabClient(lab.url, token=secret) as bob:
        (token,) = bob.tokens()
    assert token["expires_at"] - token["created_at"] == 2 * 86_400 * 10**9  # the lab's file allows no more
    assert "labos login on" in shell.run("token", "list", LABOS_URL=lab.url)
    # One that is shown by the environment goes before it, and is not what signing out revokes.
    assert "does not belong to this lab" in shell.run(
        "whoami", LABOS_URL=lab.url, LABOS_TOKEN="x", fails=True
    )
    assert "signed out" in shell.run("logout", lab.url, LABOS_TOKEN="x")
    assert shell.tokens == {}
    with LabClient(lab.url, token=secret) as late, pytest.raises(NotSignedIn, match="revoked"):
        late.identity()


def test_a_code_is_typed_into_a_browser_elsewhere(lab: LabThread, shell: Shell) -> None:
    with shell.start("login", lab.url, "--device") as process:
        address = line_with(process, "http")
        code = line_with(process, "Its code is").removeprefix("Its code is ").partition(";")[0]
        assert code in address
        with httpx.Client(timeout=30) as browser:
            sign_in_at_provider(browser, browser.get(address), "bob", "")
        said, complained = process.communicate(timeout=120)
    assert process.returncode == 0, complained
    assert "You are signed in as bob" in said
    assert json.loads(shell.run("whoami", "--json", LABOS_URL=lab.url))["user"] == "bob"


def test_an_address_is_pasted(lab: LabThread, shell: Shell) -> None:
    with shell.start("login", lab.url, "--code") as process:
        address = line_with(process, "http")
        with httpx.Client(timeout=30) as browser:
            back = sign_in_at_provider(browser, browser.get(address), "bob", "/login/")
        said, complained = process.communicate(f"{back}\n", timeout=120)
    assert process.returncode == 0, complained
    assert "You are signed in as bob" in said
    # The same address another time: it belongs to a sign-in that is over.
    said = shell.run("login", lab.url, "--code", typed=f"{back}\n", fails=True)
    assert "not the address of the last page of this sign-in" in said


def test_whom_the_lab_does_not_know_gets_no_token(lab: LabThread, shell: Shell) -> None:
    browser = BROWSER.replace("bob", "eve-heads")
    said = shell.run("login", lab.url, fails=True, BROWSER=browser)
    assert "knows you, but this lab does not" in said
    assert "labos user link" in said


# -- what is tried at the lab ------------------------------------------------------------------------


def way_back(client: LabClient, name: str = "bob", port: int = 9) -> tuple[dict[str, Any], dict[str, str]]:
    """A sign-in that has begun, and what the provider's page sends with the browser."""
    begun = client.begin_sign_in(port)
    with httpx.Client(timeout=30) as browser:
        back = sign_in_at_provider(browser, browser.get(begun["address"]), name, "/login/")
    sent = dict(back.params)
    assert sent.pop("state") == begun["state"]
    return begun, {name: text for name, text in sent.items() if name in ("code", "iss")}


def check_refused(client: LabClient, state: str, key: str, sent: dict[str, Any]) -> str:
    with pytest.raises(NotSignedIn) as told:
        client.finish_sign_in(state, key, **sent)
    return str(told.value)


def test_a_code_is_good_once(anybody: LabClient) -> None:
    begun, sent = way_back(anybody)
    assert anybody.finish_sign_in(begun["state"], begun["key"], **sent)["user"] == "bob"  # type: ignore[arg-type]
    assert "the sign-in was not started here" in check_refused(anybody, begun["state"], begun["key"], sent)
    # The provider does not take it again either, for another sign-in.
    other = anybody.begin_sign_in(9)
    assert "invalid_grant" in check_refused(anybody, other["state"], other["key"], sent)


def test_a_code_that_was_caught_is_good_for_nobody_else(anybody: LabClient) -> None:
    """Another program of the computer has seen the address to which the browser was sent."""
    begun, sent = way_back(anybody)
    assert "another browser" in check_refused(anybody, begun["state"], "x" * 43, sent)
    begun, sent = way_back(anybody)
    thief = anybody.begin_sign_in(9)  # PKCE: the code belongs to another verifier
    assert "invalid_grant" in check_refused(anybody, thief["state"], thief["key"], sent)
    assert "the sign-in was not started here" in check_refused(anybody, "x", begun["key"], sent)


@pytest.mark.parametrize(
    ("change", "why"),
    [
        ({"iss": "https://evil.example"}, "the answer is from"),
        ({"iss": ""}, "the answer is from"),
        ({"code": ""}, "answers 'nothing'"),
        ({"code": "x"}, "invalid_grant"),
        ({"error": "access_denied"}, "access_denied"),
    ],
)
def test_a_forged_answer_is_refused(anybody: LabClient, change: dict[str, str], why: str) -> None:
    begun, sent = way_back(anybody)
    assert why in check_refused(anybody, begun["state"], begun["key"], sent | change)


def test_a_browsers_sign_in_and_a_command_lines_are_no_other(
    lab: LabThread, anybody: LabClient, issuer: Issuer
) -> None:
    """What was begun for a cookie gives no token, and the other way round."""
    with httpx.Client(base_url=lab.url, timeout=30) as browser:
        answer = browser.get("/login/oidc")
        back = sign_in_at_provider(browser, answer, "bob", "/login/oidc/callback")
        sent, cookie = dict(back.params), browser.cookies["labos-way-back"]
        asked = {name: sent[name] for name in ("code", "iss")}
        assert "another user started" in check_refused(anybody, sent["state"], cookie, asked)
        begun, asked = way_back(anybody)
        browser.cookies.set("labos-way-back", begun["key"], domain="127.0.0.1")
        answer = browser.get("/login/oidc/callback", params={"state": begun["state"], **asked})
        assert answer.status_code == 401
        assert "another user started" in answer.json()["detail"]


def test_a_device_is_asked_for_no_faster_than_the_provider_says(lab: LabThread, anybody: LabClient) -> None:
    begun = anybody.begin_sign_in(0, device=True)
    found = anybody.finish_sign_in(begun["state"], begun["key"])
    assert 0 < found["wait_s"] <= begun["wait_s"]
    assert (found["user"], found["token"]) == ("", "")
    assert "another command line" in check_refused(anybody, begun["state"], "x" * 43, {})
    command_line = lab.runtime.gate.command_line
    assert command_line is not None
    command_line._devices[begun["state"]].until = 0.0
    assert "the code was not entered" in check_refused(anybody, begun["state"], begun["key"], {})
    assert "the sign-in was not started here" in check_refused(anybody, begun["state"], begun["key"], {})


# -- what is tried at the command line ----------------------------------------------------------------


def test_the_listener_is_reached_from_this_computer_alone_and_waits_for_one_answer() -> None:
    with _Listener(0) as listener:
        assert listener.server_address[0] == OWN
        url = f"http://{OWN}:{listener.server_port}"
        listener.expect(f"{url}/login/lab7", "right")
        found: list[dict[str, str]] = []
        waiting = Thread(target=lambda: found.append(listener.wait(60)))
        waiting.start()
        for address in (
            "/login/lab7?code=evil&state=wrong",
            "/login/lab7?code=evil",
            "/login/other?code=evil&state=right",
            "/login/lab7?state=right",
            "/",
        ):
            assert httpx.get(url + address).status_code == 404, address
        assert found == []
        answer = httpx.get(f"{url}/login/lab7?code=a+b&state=right&iss=https://id.example&more=x")
        assert answer.status_code == 200
        waiting.join(60)
    assert found == [{"code": "a b", "iss": "https://id.example"}]


def test_nobody_who_comes_is_waited_for_forever() -> None:
    with _Listener(0) as listener, pytest.raises(NotSignedIn, match="The sign-in was not completed"):
        listener.wait(0.05)


class _EvilLab(BaseHTTPRequestHandler):
    """A lab that sends whoever signs in to it on to another lab's sign-in, to get what comes back."""

    def do_POST(self) -> None:
        body = self.rfile.read(int(self.headers["content-length"]))
        self.server.asked.append((self.path, body))  # type: ignore[attr-defined]
        lab = self.server.lab  # type: ignore[attr-defined]
        headers = {"content-type": "application/json"}
        answer = httpx.post(lab + self.path, content=body, headers=headers)
        content = self.server.change(answer.content)  # type: ignore[attr-defined]
        self.send_response(answer.status_code)
        self.send_header("content-type", "application/json")
        self.send_header("content-length", str(len(content)))
        self.end_headers()
        self.wfile.write(content)

    def log_message(self, format: str, *args: Any) -> None:
        pass


@pytest.fixture
def evil(lab: LabThread) -> Iterator[ThreadingHTTPServer]:
    server = ThreadingHTTPServer(("127.0.0.1", 0), _EvilLab)
    server.lab, server.asked, server.change = lab.url, [], lambda content: content  # type: ignore[attr-defined]
    thread = Thread(target=server.serve_forever)
    thread.start()
    yield server
    server.shutdown()
    thread.join()
    server.server_close()


@pytest.mark.parametrize("way", [(), ("--code",)])
def test_a_lab_gets_no_code_of_another_lab(
    evil: Any, lab: LabThread, shell: Shell, way: tuple[str, ...]
) -> None:
    said = shell.run("login", f"http://127.0.0.1:{evil.server_port}", *way, fails=True)
    assert "sends you to the sign-in of another one" in said
    assert [path for path, _ in evil.asked] == ["/api/v1/login/provider"]


@pytest.mark.parametrize(
    ("address", "why"),
    [
        ("file:///etc/passwd", "sends the browser to 'file:"),
        ("http://evil.example/auth", "sends the browser to 'http:"),
        ("https://evil.example/auth?redirect_uri=https://evil.example/back", "another site"),
        ("https://evil.example/auth?redirect_uri=http://127.0.0.1:1/login/x", "another site"),
    ],
)
def test_no_browser_is_opened_at_an_odd_address(evil: Any, shell: Shell, address: str, why: str) -> None:
    def change(content: bytes) -> bytes:
        return json.dumps({**json.loads(content), "address": address}).encode()

    evil.change = change
    opened = shell.environment["XDG_CONFIG_HOME"] + "/opened"
    browser = f'{sys.executable} -c \'open("{opened}", "w")\' %s'
    said = shell.run("login", f"http://127.0.0.1:{evil.server_port}", fails=True, BROWSER=browser)
    assert why in said
    assert not Path(opened).exists()


def test_the_address_of_the_provider_names_the_lab_and_the_port(anybody: LabClient, lab: LabThread) -> None:
    begun = anybody.begin_sign_in(4711)
    asked = parse_qs(urlsplit(begun["address"]).query)
    port = lab.url.rpartition(":")[2]
    assert asked["redirect_uri"] == [f"http://127.0.0.1:4711/login/127.0.0.1-{port}"]
    assert asked["code_challenge_method"] == ["S256"]
    assert asked["client_id"] == ["labos-login"]


def test_a_lab_without_a_client_for_it_asks_for_a_password(
    lab: LabThread, anybody: LabClient, shell: Shell, monkeypatch: pytest.MonkeyPatch
) -> None:
    provider = lab.runtime.gate.provider
    assert provider is not None
    monkeypatch.setattr(provider, "settings", provider.settings.model_copy(update={"command_line": None}))
    for more in ({}, {"device": True}):
        with pytest.raises(NotFound, match="from the command line"):
            anybody.begin_sign_in(1, **more)
    said = shell.run("login", lab.url, typed="staple of four words\n", LABOS_USER="bob")
    assert "You are signed in as bob" in said
    said = shell.run("login", lab.url, "--device", fails=True)
    assert "from the command line" in said

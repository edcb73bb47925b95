"""Signing in with the identity provider of a lab, in a browser that returns to this command (RFC 8252), or
with a code that the user types in elsewhere."""

from __future__ import annotations

import html
import ipaddress
import sys
import threading
import time
import webbrowser
from collections.abc import Mapping
from http.server import BaseHTTPRequestHandler, HTTPServer
from typing import TYPE_CHECKING, Any, Literal
from urllib.parse import parse_qs, urlsplit

import click

from labos.errors import NotSignedIn
from labos.settings import free_port

if TYPE_CHECKING:
    from labos.client import LabClient

Way = Literal["browser", "device", "code"]
OWN = "127.0.0.1"
"""A server at this address is not reached from other computers."""
PATIENCE_S = 600.0
LONGEST_WAIT_S = 60.0
SENT = ("code", "iss", "error")
PAGE = '<!doctype html><html lang="en"><meta charset="utf-8"><title>LabOS</title><p>{}</p></html>\n'
HEADERS = {
    "content-type": "text/html; charset=utf-8",
    "cache-control": "no-store",
    "content-security-policy": "default-src 'none'; frame-ancestors 'none'",
    "referrer-policy": "no-referrer",
    "connection": "close",
}


def sign_in(client: LabClient, way: Way, port: int, **token: Any) -> dict[str, Any]:
    """The user who has signed in, with the requested ``token``. Raises NotFound for a lab without this way to
    sign in, NotSignedIn."""
    if way == "device":
        return _with_device(client, **token)
    if way == "code":
        begun = client.begin_sign_in(port or free_port())
        expected = _find_way_back(client, begun)
        click.echo(
            f"Open this address in a browser, and sign in there:\n\n  {begun['address']}\n\n"
            "The browser cannot show the last page. Copy the address of that page, and paste it here.",
            err=True,
        )
        return _finish(client, begun, _read_pasted(begun, expected), **token)
    with _Listener(port) as listener:
        begun = client.begin_sign_in(listener.server_port)
        listener.expect(_find_way_back(client, begun), begun["state"])
        click.echo(f"Sign in on the page that opens, or at:\n\n  {begun['address']}\n", err=True)
        threading.Thread(target=_open, args=(begun["address"],), daemon=True).start()
        return _finish(client, begun, listener.wait(PATIENCE_S), **token)


def _open(address: str) -> None:
    """Open a browser; some browsers run in the foreground until they are closed."""
    if not webbrowser.open(address):
        click.echo("No browser opens here; `labos login --device` needs none.", err=True)


def _finish(
    client: LabClient, begun: Mapping[str, Any], sent: Mapping[str, str], **token: Any
) -> dict[str, Any]:
    return client.finish_sign_in(begun["state"], begun["key"], **{**sent, **token})


def _with_device(client: LabClient, **token: Any) -> dict[str, Any]:
    begun = client.begin_sign_in(0, device=True)
    _expect_page(begun["address"])
    click.echo(
        f"Open this address in a browser, and sign in there:\n\n  {begun['address']}\n\n"
        f"Its code is {begun['code']}; continue only if the page shows the same code.",
        err=True,
    )
    wait_s = begun["wait_s"]
    deadline = time.monotonic() + PATIENCE_S
    while True:
        time.sleep(min(wait_s, LONGEST_WAIT_S))
        found = client.finish_sign_in(begun["state"], begun["key"], **token)
        if found["token"]:
            return found
        wait_s = found["wait_s"]
        if time.monotonic() > deadline:
            raise _give_up()


def _find_way_back(client: LabClient, begun: Mapping[str, Any]) -> str:
    """The address to which the browser returns, as the provider knows it. Raises NotSignedIn if it does not
    belong to this lab's sign-in: another program would get the answer."""
    _expect_page(begun["address"])
    asked = parse_qs(urlsplit(begun["address"]).query)
    found = str(asked.get("redirect_uri", [""])[0])
    place = client.token_place
    lab = urlsplit(place).netloc.lower().replace(":", "-")
    parts = urlsplit(found)
    is_own = (parts.scheme, parts.hostname) == ("http", OWN) and not parts.query
    if not is_own or asked.get("state") != [begun["state"]]:
        raise NotSignedIn("The lab sends the browser to another site.", remedy="Ask an admin of the lab.")
    if lab and parts.path != f"/login/{lab}":
        raise NotSignedIn(
            f"The lab at {place} sends you to the sign-in of another one "
            f"({parts.path.removeprefix('/login/')}).",
            remedy="Use the address in `lab:` of the lab's oidc.yaml. If you did, do not sign in, and report "
            "this to an admin of the lab.",
        )
    return found


def _expect_page(address: str) -> None:
    """Raises NotSignedIn for an address that cannot be a page of a provider."""
    parts = urlsplit(address)
    if parts.scheme == "https" and parts.hostname:
        return
    if parts.scheme == "http" and (parts.hostname == "localhost" or _is_loopback(parts.hostname or "")):
        return
    raise NotSignedIn(
        f"The lab sends the browser to {address[:100]!r}.", remedy="Report this to an admin of the lab."
    )


def _is_loopback(host: str) -> bool:
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def _read_pasted(begun: Mapping[str, Any], expected: str) -> dict[str, str]:
    """The parameters in the address that the user pastes. Raises NotSignedIn."""
    if sys.stdin.isatty():
        text = str(click.prompt("Address", err=True)).strip()
    else:
        text = sys.stdin.readline().strip()
    address, _, query = text.partition("?")
    sent = _parse_answer(query)
    if address != expected or sent.pop("state", "") != begun["state"]:
        raise NotSignedIn(
            "This is not the address of the last page of this sign-in.",
            remedy=f"The address begins with {expected}.",
        )
    return sent


def _parse_answer(query: str) -> dict[str, str]:
    found = parse_qs(query)
    return {name: found[name][0] for name in (*SENT, "state") if name in found}


def _give_up() -> NotSignedIn:
    return NotSignedIn("The sign-in was not completed.", remedy="Start again with `labos login`.")


class _Listener(HTTPServer):
    """Waits for one browser, at an address that only this computer reaches."""

    allow_reuse_address = False
    daemon_threads = True

    def __init__(self, port: int) -> None:
        super().__init__((OWN, port), _Handler)
        self._path = self._state = ""
        self.answer: dict[str, str] | None = None

    def expect(self, way_back: str, state: str) -> None:
        self._path, self._state = urlsplit(way_back).path, state

    def wait(self, within_s: float) -> dict[str, str]:
        """The parameters that the provider has sent with the browser. Raises NotSignedIn when the time is
        over."""
        deadline = time.monotonic() + within_s
        while self.answer is None:
            self.timeout = deadline - time.monotonic()
            if self.timeout <= 0:
                raise _give_up()
            self.handle_request()
        return self.answer

    def take(self, target: str) -> bool:
        """Whether a request is the expected one. Any program here can send other requests: they do not end
        the wait."""
        path, _, query = target.partition("?")
        sent = _parse_answer(query)
        if path != self._path or not self._state or sent.pop("state", "") != self._state:
            return False
        if "code" not in sent and "error" not in sent:
            return False
        self.answer = sent
        return True

    def handle_error(self, request: Any, client_address: Any) -> None:
        """A client that closes its connection early is not reported to the user."""


class _Handler(BaseHTTPRequestHandler):
    server: _Listener
    timeout = 5.0
    """A client that connects and sends nothing blocks the browser for at most so long."""

    def do_GET(self) -> None:
        is_it = self.server.take(self.path)
        words = (
            "You can close this page and return to the command."
            if is_it
            else "The command does not wait for a sign-in."
        )
        body = PAGE.format(html.escape(words)).encode()
        self.send_response(200 if is_it else 404)
        for name, value in {**HEADERS, "content-length": str(len(body))}.items():
            self.send_header(name, value)
        self.end_headers()
        self.wfile.write(body)

    def log_message(self, format: str, *args: Any) -> None:
        """Write no log: the first line of the request contains the code."""

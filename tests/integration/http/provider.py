"""A real identity provider (oidc-provider of npm), a lab that knows it, and a person at its pages."""

from __future__ import annotations

import re
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import httpx
import msgspec

from labos.bootstrap import LabThread
from labos.core.decide.users import AddGroup
from labos.settings import free_port
from tests.foreign.make import ROOT
from tests.integration.http.signed import execute, lab_with_users
from tests.support.foreign import node_modules_of

FILE = """
labos: 1
issuer: http://127.0.0.1:{port}
client_id: labos
lab: http://127.0.0.1:{lab_port}
command_line: {{client_id: labos-login, days: 2}}
groups: {{chemists: chemistry}}
roles:
  operators: [{{role: operator, workcell: rpl}}]
  heads: [{{role: admin}}, {{role: viewer, workcell: rpl}}]
"""


class Issuer(msgspec.Struct, frozen=True):
    """The provider's name, and the port of the lab that it knows."""

    url: str
    lab_port: int


@contextmanager
def run_provider(folder: Path) -> Iterator[Issuer]:
    modules, port, lab_port = node_modules_of("oidc"), free_port(), free_port()
    way_back = f"http://127.0.0.1:{lab_port}/login/oidc/callback"
    command = ["node", ROOT / "tests" / "foreign" / "oidc_provider.mjs", str(port), way_back, modules]
    log = (folder / "log").open("wb")
    with log, subprocess.Popen(command, stdout=subprocess.PIPE, stderr=log) as process:
        try:
            assert process.stdout is not None
            assert process.stdout.readline() == b"ready\n"
            yield Issuer(f"http://127.0.0.1:{port}", lab_port)
        finally:
            process.kill()


@contextmanager
def lab_with_provider(folder: Path, issuer: Issuer) -> Iterator[LabThread]:
    (folder / "lab").mkdir()
    port = issuer.url.rpartition(":")[2]
    (folder / "lab" / "oidc.yaml").write_text(FILE.format(port=port, lab_port=issuer.lab_port))
    with lab_with_users(folder, http_port=issuer.lab_port) as running:
        execute(running, AddGroup("chemistry"), "ada")
        yield running


def sign_in_at_provider(browser: httpx.Client, answer: httpx.Response, name: str, way_back: str) -> httpx.URL:
    """Sign in and agree on the pages to which an answer leads; the address to which the provider sends the
    browser back, not yet gone to. Without a ``way_back``: the last page."""
    for _ in range(14):
        if answer.is_redirect:
            address = answer.request.url.join(answer.headers["location"])
            if way_back and address.path.startswith(way_back):
                return address
            answer = browser.get(address)
            continue
        action = re.search(r'action="([^"]+)"', answer.text)
        if action is None and not way_back:
            return answer.request.url
        assert action, answer.text
        hidden = dict(re.findall(r'type="hidden" name="(\w+)" value="([^"]*)"', answer.text))
        answer = browser.post(
            answer.request.url.join(action[1]), data={**hidden, "login": name, "password": "any"}
        )
    raise AssertionError(answer.text)


if __name__ == "__main__":  # a browser that a person uses: NAME ADDRESS
    with httpx.Client(timeout=30) as _browser:
        _page = _browser.get(sys.argv[2])
        _browser.get(sign_in_at_provider(_browser, _page, sys.argv[1], "/login/"))

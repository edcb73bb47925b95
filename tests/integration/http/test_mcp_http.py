"""Agents at a lab over HTTP, by the protocol's own client: each acts with its own token, and can start
nothing."""

from __future__ import annotations

import asyncio
import json
import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import httpx2
import pytest
from mcp import Client, MCPError
from mcp.client.streamable_http import streamable_http_client

from labos.bootstrap import LabThread
from labos.client import LabClient
from labos.core.decide.users import AddUser, GrantRole
from labos.mcp.server import INSTRUCTIONS, LOOK, PLAN, PROPOSE
from tests.foreign.make import ROOT
from tests.integration.http.signed import execute, lab_with_users, token_of

pytestmark = pytest.mark.slow

SEAL = (
    "labos: 1\nname: seal\nsteps:\n"
    "  - {name: seal it, module: sealer, action: seal, args: {time: payload.time, temperature: 175}}\n"
)
MODES: tuple[Any, ...] = ("auto", "legacy")
"""The present protocol, which has no sessions, and those before it."""
HEADERS = {
    "content-type": "application/json",
    "accept": "application/json, text/event-stream",
}
ASKED = {"jsonrpc": "2.0", "id": 1, "method": "tools/list", "params": {}}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("mcp_http")


@pytest.fixture(scope="module")
def lab(folder: Path) -> Iterator[LabThread]:
    with lab_with_users(folder) as running:
        execute(running, AddUser("helper", "service"), "ada")
        execute(running, GrantRole("user:helper", "submitter"), "ada")
        execute(running, GrantRole("user:agent", "admin"), "ada")
        yield running


@contextmanager
def serve(*words: str, **environment: str) -> Iterator[str]:
    """The server as a process; its address."""
    with subprocess.Popen(
        [sys.executable, "-m", "labos", "mcp", "--http-port", "0", *words],
        env={**os.environ, **environment},
        cwd=ROOT,
        text=True,
        stdout=subprocess.PIPE,
    ) as process:
        try:
            assert process.stdout is not None
            line = process.stdout.readline()
            assert "Agents reach the lab at http" in line
            yield line.split()[-1]
        finally:
            process.terminate()
            process.wait(30)


@pytest.fixture(scope="module")
def url(lab: LabThread, folder: Path) -> Iterator[str]:
    """A server that finds the key of the lab's folder, and a token that would allow everything, if it looked
    for them."""
    mighty = token_of(folder, "agent", scope="admin")
    with serve("--home", str(folder / "lab"), LABOS_TOKEN=mighty) as found:
        yield found


async def calls(
    url: str, token: str, *asked: tuple[str, dict[str, Any]], mode: Any = "auto", **headers: str
) -> list[Any]:
    """What the server answers to calls of tools, one after the other; the first is the list of tools."""
    shown = {"authorization": f"Bearer {token}", **headers}
    async with (
        httpx2.AsyncClient(headers=shown, timeout=60, trust_env=False) as http,
        Client(streamable_http_client(url, http_client=http), mode=mode) as session,
    ):
        found: list[Any] = [(await session.list_tools()).tools, session.instructions]
        for name, args in asked:
            found.append(await session.call_tool(name, args))
        return found


def data_of(answer: Any) -> Any:
    assert not answer.is_error, answer.content
    return json.loads(answer.content[0].text)["data"]


@pytest.mark.parametrize("mode", MODES)
def test_an_agent_looks_plans_and_proposes_as_itself(
    lab: LabThread, folder: Path, url: str, mode: Any
) -> None:
    token = token_of(folder, "helper")
    tools, instructions, you, checked, proposed, approve = asyncio.run(
        calls(
            url,
            token,
            ("lab", {}),
            ("check_workflow", {"workflow": SEAL, "payload": {"time": 3}}),
            ("propose_run", {"workflow": SEAL, "payload": {"time": 3}, "key": f"once {mode}"}),
            ("approve", {"subject": "R1"}),
            mode=mode,
        )
    )
    assert {tool.name for tool in tools} == {*LOOK, *PLAN, *PROPOSE}
    assert instructions == INSTRUCTIONS
    assert data_of(you)["you"]["user"] == "helper"
    assert data_of(checked)["steps"][0]["module"] == "sealer"
    run = data_of(proposed)["run"]
    assert run in lab.runtime.kernel.state.approvals.open
    assert lab.runtime.kernel.state.runs.queued[run].user == "helper"
    assert approve.is_error
    assert "Unknown tool" in approve.content[0].text


@pytest.mark.parametrize("mode", MODES)
def test_agents_at_the_same_time_act_each_with_its_own_token(
    lab: LabThread, folder: Path, url: str, mode: Any
) -> None:
    tokens = {user: token_of(folder, user, scope="submitter") for user in ("agent", "helper")}

    async def both() -> list[list[Any]]:
        asked = [("lab", {})] * 4
        return await asyncio.gather(
            *(calls(url, token, *asked, mode=mode) for token in tokens.values() for _ in range(2))
        )

    found = asyncio.run(both())
    users = [[data_of(answer)["you"]["user"] for answer in told[2:]] for told in found]
    assert users == [[user] * 4 for user in tokens for _ in range(2)]


def test_for_whom_it_acts_is_said_with_each_request(lab: LabThread, folder: Path, url: str) -> None:
    token = token_of(folder, "helper")
    asked = ("propose_run", {"workflow": SEAL, "payload": {"time": 3}})
    *_, proposed = asyncio.run(calls(url, token, asked, **{"labos-on-behalf-of": "bob"}))
    run = data_of(proposed)["run"]
    assert lab.runtime.kernel.state.runs.queued[run].user == "bob"
    *_, refused = asyncio.run(calls(url, token, ("lab", {}), **{"labos-on-behalf-of": "nobody"}))
    assert refused.is_error
    assert "no user 'nobody'" in refused.content[0].text


def post(url: str, token: str = "", headers: dict[str, str] | None = None) -> httpx2.Response:
    shown = {"authorization": f"Bearer {token}"} if token else {}
    with httpx2.Client(timeout=60, trust_env=False) as http:
        return http.post(url, json=ASKED, headers={**HEADERS, **shown, **(headers or {})})


def test_who_shows_no_token_of_a_program_is_not_let_in(lab: LabThread, folder: Path, url: str) -> None:
    """Not by the token that the server's own environment has, nor by the key of the lab's folder."""
    home_key = (folder / "lab" / "home.key").read_text().strip()
    revoked = token_of(folder, "helper")
    with LabClient(home=folder / "lab") as home:
        newest = max(home.tokens("helper"), key=lambda token: token["created_at"])
        home.revoke_token(newest["id"])
    for token in ("", "x", home_key, "labos_token_" + "x" * 43, "labos_token_" + "x" * 5_000, revoked):
        answer = post(url, token)
        assert answer.status_code == 401, token
        assert answer.headers["www-authenticate"] == "Bearer"
    basic = post(url, headers={"authorization": "Basic YTpi"})
    assert basic.status_code == 401
    answer = post(url, token_of(folder, "bob"))
    assert answer.status_code == 403
    assert "signs in as a service account, and this would be bob" in answer.json()["detail"]


def test_a_token_that_is_revoked_is_good_for_nothing_in_the_midst_of_a_talk(
    lab: LabThread, folder: Path, url: str
) -> None:
    token = token_of(folder, "helper")

    async def talk() -> None:
        shown = {"authorization": f"Bearer {token}"}
        async with (
            httpx2.AsyncClient(headers=shown, timeout=60, trust_env=False) as http,
            Client(streamable_http_client(url, http_client=http)) as session,
        ):
            assert not (await session.call_tool("lab", {})).is_error
            with LabClient(home=folder / "lab") as home:
                newest = max(home.tokens("helper"), key=lambda each: each["created_at"])
                home.revoke_token(newest["id"])
            with pytest.raises(MCPError):
                await session.call_tool("lab", {})
            assert post(url, token).status_code == 401

    asyncio.run(talk())


def test_a_token_to_look_with_proposes_nothing(folder: Path, url: str) -> None:
    token = token_of(folder, "helper", scope="viewer")
    asked = ("propose_run", {"workflow": SEAL, "payload": {"time": 3}})
    *_, you, refused = asyncio.run(calls(url, token, ("lab", {}), asked))
    assert data_of(you)["you"]["scope"] == "viewer"
    assert refused.is_error
    assert "submitter" in refused.content[0].text


@pytest.mark.parametrize(
    ("headers", "status"),
    [
        ({"host": "evil.example"}, 421),
        ({"host": "127.0.0.1.evil.example:80"}, 421),
        ({"origin": "https://evil.example"}, 403),
        ({"origin": "null"}, 403),
        ({"content-type": "text/plain"}, 400),
        ({"content-type": "application/x-www-form-urlencoded"}, 400),
    ],
)
def test_no_web_page_speaks_to_it(folder: Path, url: str, headers: dict[str, str], status: int) -> None:
    """A page whose name was made to mean this computer, one of another site, and a form."""
    answer = post(url, token_of(folder, "helper"), headers)
    assert answer.status_code == status
    assert post(url, "", headers).status_code == status


def test_what_is_too_large_or_no_request_is_not_read(folder: Path, url: str) -> None:
    shown = {**HEADERS, "authorization": f"Bearer {token_of(folder, 'helper')}"}
    with httpx2.Client(timeout=60, trust_env=False) as http:
        answer = http.post(url, content=b"x" * (5 * 1024 * 1024), headers=shown)
        assert answer.status_code == 413
        assert http.get(url, headers=shown).status_code == 405
        assert http.post(url.replace("/mcp", "/other"), json=ASKED, headers=shown).status_code == 404


@pytest.mark.parametrize(
    ("words", "why"),
    [
        (("--http-port", "0", "--host", "0.0.0.0"), "tokens would be sent over the network unencrypted"),
        (("--http-port", "0", "--behalf", "bob"), "each agent names its user"),
        (("--host", "127.0.0.1"), "goes with --http-port"),
    ],
)
def test_what_is_not_served(folder: Path, lab: LabThread, words: tuple[str, ...], why: str) -> None:
    done = subprocess.run(
        [sys.executable, "-m", "labos", "mcp", "--home", str(folder / "lab"), *words],
        capture_output=True,
        text=True,
        cwd=ROOT,
        timeout=120,
        check=False,
    )
    assert done.returncode != 0
    assert why in done.stderr

"""What is said in an argument stays in its part of a path: no argument leads a call to another operation."""

from __future__ import annotations

import inspect
import re
import threading
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, HTTPServer
from typing import Any
from urllib.parse import unquote

import pytest

from labos.client import LabClient
from labos.errors import BadInput, LabosError
from labos.http.routes import OPERATIONS
from labos.mcp.look import Look

ASIDE = (
    "../tokens",
    "..",
    ".",
    "",
    "R1/../../tokens",
    "./R1",
    "R1/",
    "/R1",
    "/etc/passwd",
    "R1//",
    "..\\tokens",
    "rpl\\sealer",
    "a/b/c",
    "rpl/..",
    "rpl/.",
    "R1\x00",
    "R1\n",
    "\ud800",
    "R1\r\nx: y",
)
"""What no thing in a lab is called."""

ODD = ("R1?scope=admin", "R1#x", "%2e%2e%2ftokens", "R1;x=y", "R 1", "ä", "a%2Fb", "@evil.example", ":80")
"""What nothing is called either, but says one part of a path."""

WITH_PATH = [op for op in OPERATIONS if "{" in op.path and op.id != "get_file"]


class Recorder(BaseHTTPRequestHandler):
    """Writes down what is asked for."""

    asked: list[str]

    def do_GET(self) -> None:
        self.rfile.read(int(self.headers.get("content-length", 0)))
        self.asked.append(self.path)
        body = b'{"code": "not_found", "detail": "no", "status": 404, "title": "", "type": "", "remedy": ""}'
        self.send_response(404)
        self.send_header("content-type", "application/problem+json")
        self.send_header("content-length", str(len(body)))
        self.end_headers()
        self.wfile.write(body)

    do_POST = do_GET  # noqa: N815

    def log_message(self, *args: Any) -> None:
        pass


@pytest.fixture(scope="module")
def lab() -> Iterator[tuple[LabClient, list[str]]]:
    asked: list[str] = []
    server = HTTPServer(("127.0.0.1", 0), type("Kept", (Recorder,), {"asked": asked}))
    thread = threading.Thread(target=server.serve_forever, daemon=True)
    thread.start()
    with LabClient(f"http://127.0.0.1:{server.server_port}", patience_s=0.0) as client:
        yield client, asked
    server.shutdown()
    thread.join()
    server.server_close()


def arguments(method: Any, said: dict[str, str]) -> dict[str, Any]:
    """Arguments of a call: those of its path as ``said``, a text for each other one that it must have."""
    parameters = inspect.signature(method).parameters.values()
    return {p.name: "x" for p in parameters if p.default is p.empty} | said


def call(client: LabClient, name: str, said: dict[str, str]) -> None:
    method = getattr(client, name)
    method(**arguments(method, said))


@pytest.mark.parametrize("operation", WITH_PATH, ids=lambda op: op.id)
def test_no_argument_leads_elsewhere(operation: Any, lab: tuple[LabClient, list[str]]) -> None:
    client, asked = lab
    name = operation.client.name
    places = re.findall(r"\{(\w+)\}", operation.path)
    asked.clear()
    for place in places:
        for text in ASIDE:
            with pytest.raises(BadInput, match="is not a name in the lab"):
                call(client, name, dict.fromkeys(places, "x") | {place: text})
    assert asked == []
    for place in places:
        for text in ODD:
            with pytest.raises(LabosError):
                call(client, name, dict.fromkeys(places, "x") | {place: text})
            parts = asked.pop().partition("?")[0].split("/")[3:]
            declared = operation.path.split("/")[1:]
            assert len(parts) == len(declared)
            for part, wanted in zip(parts, declared, strict=True):
                meant = {f"{{{place}}}": text}.get(wanted, "x" if "{" in wanted else wanted)
                assert unquote(part) == meant


def test_a_module_may_be_named_with_its_workcell(lab: tuple[LabClient, list[str]]) -> None:
    client, asked = lab
    with pytest.raises(LabosError):
        client.actions("rpl/sealer")
    assert asked.pop() == "/api/v1/modules/rpl%2Fsealer/actions"


@pytest.mark.parametrize("text", [*ASIDE, *ODD, "0" * 63, "0" * 64 + "/..", "A" * 64])
def test_files_are_named_by_digests_alone(text: str, lab: tuple[LabClient, list[str]]) -> None:
    client, asked = lab
    asked.clear()
    for named in (text, {"sha256": text, "file": text}):
        with pytest.raises(BadInput):
            client.file(named)
    assert asked == []


@pytest.mark.parametrize(
    ("tool", "argument"),
    [
        ("run", "run"),
        ("module_actions", "module"),
        ("proposals", "subject"),
        ("read_file", "sha256"),
    ],
)
def test_an_agent_cannot_lead_a_tool_elsewhere(
    tool: str, argument: str, lab: tuple[LabClient, list[str]]
) -> None:
    client, asked = lab
    asked.clear()
    for text in filter(None, ASIDE):
        with pytest.raises(BadInput):
            getattr(Look(client), tool)(**{argument: text})
    assert asked == []

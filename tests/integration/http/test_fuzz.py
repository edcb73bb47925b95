"""Thousands of odd requests over every route: each is refused or answered, and the lab works on.

Seeded: ``FUZZ_SEED`` repeats one campaign, and a failure names the request.
"""

from __future__ import annotations

import copy
import json
import os
import random
import time
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest

from labos.bootstrap import LabThread, descriptions
from labos.client import LabClient
from labos.http.routes import OPERATIONS, PREFIX
from labos.settings import Settings
from labos.spec import parse_workcell

CELL = """
labos: 1
name: {name}
modules:
  - {{name: stacker, model: sciclops}}
  - {{name: arm, model: pf400}}
  - {{name: sealer, model: A4S_sealer, resources: {{foil: 400}}}}
stations:
  wc.shelf: {{shelves: 3}}
  wc.trash: {{kind: waste, capacity: 50}}
"""
FLOW = "labos: 1\nname: f\nsteps:\n  - {name: seal, module: sealer, action: seal}\n"
CAMPAIGN = """
labos: 1
campaign: c
workflow: f.yaml
rows: {list: [{time: 1}, {time: 2}]}
until: steps.seal.result.x > 1
"""
TIMED = FLOW.replace("action: seal}", "action: seal, args: {time: payload.time}}")
POLICY = "labos: 1\ntrusted: [lims]\ndangerous: true\npriority: 100000\n"
SHARES = "labos: 1\ngroups:\n  chemistry: {weight: 2, members: {ada: {quota: {running: 9}}}}\n"
TAKE = "labos: 1\nname: t\nsteps:\n  - {name: look, module: arm, action: read_pose}\n"

SLOWEST_S = 20.0
"""No answer may take longer, on a loaded machine."""

SIGNATURE = {"meaning": "reviewed", "password": "four words of mine", "why": "x"}
EXAMPLES: dict[str, dict[str, Any]] = {
    "/login": {"user": "ada", "password": "four words of hers", "token": True, "label": "x", "days": 1.0},
    "/logout": {},
    "/tokens": {"label": "x", "scope": "viewer", "days": 1.0, "user": "ada"},
    "/tokens/{token}/revoke": {},
    "/users": {"user": "ada", "kind": "person", "by": "ada"},
    "/users/{user}/disable": {"by": "ada"},
    "/users/{user}/enable": {"by": "ada"},
    "/groups": {"group": "chemistry", "by": "ada"},
    "/groups/{group}/remove": {"by": "ada"},
    "/groups/{group}/members": {"user": "ada", "by": "ada"},
    "/groups/{group}/members/remove": {"user": "ada", "by": "ada"},
    "/roles/grant": {"subject": "user:ada", "role": "viewer", "scope": "*", "by": "ada"},
    "/roles/revoke": {"subject": "user:ada", "scope": "*", "by": "ada"},
    "/users/{user}/password": {"password": "four words of hers", "present": "others"},
    "/users/{user}/person": {"name": "Ada", "mail": "ada@example.org"},
    "/users/{user}/erase": {},
    "/login/provider": {"port": 49152, "device": False},
    "/login/provider/finish": {"state": "s", "key": "k", "code": "c", "iss": "i"},
    "/users/{user}/identity": {"issuer": "https://login.example.org", "subject": "1"},
    "/runs": {
        "workflow": {"text": FLOW, "name": "f.yaml", "files": {"a.txt": "YQ=="}},
        "user": "ada",
        "payload": {"a": {"b": [1, 2.5, None]}},
        "workcell": "fuzz",
        "priority": 1,
        "experiment": "E1",
        "place": [{"station": "sealer.default", "labware": "plate96"}],
        "propose": True,
    },
    "/runs/batch": {
        "workflow": {"text": FLOW, "name": "f.yaml", "files": {"a.txt": "YQ=="}},
        "user": "ada",
        "payloads": [{"a": {"b": [1, 2.5, None]}}, {}],
        "workcell": "fuzz",
        "priority": 1,
        "place": [{"station": "sealer.default", "labware": "plate96"}],
        "keys": ["k1", "k2"],
        "files": [["a.txt"], []],
        "first": 3,
    },
    "/runs/check": {"workflow": {"text": FLOW, "name": "f.yaml"}, "user": "ada", "payload": {"a": [1]}},
    "/runs/forecast": {"workflow": {"text": FLOW, "name": "f.yaml"}, "user": "ada", "payload": {"a": [1]}},
    "/runs/{run}/cancel": {"by": "ada", "stay": True},
    "/runs/{run}/pause": {"by": "ada", "why": "x"},
    "/runs/{run}/resume": {"by": "ada"},
    "/experiments": {
        "name": "e",
        "user": "ada",
        "closing": {"text": TAKE},
        "parking": ["wc.shelf"],
        "payload": {},
        "workcell": "fuzz",
        "priority": 0,
    },
    "/experiments/{experiment}/resume": {"name": "color picker"},
    "/experiments/{experiment}/end": {"why": "over"},
    "/experiments/{experiment}/notes": {"kind": "decision", "name": "n", "facts": {"a": [1]}},
    "/experiments/{experiment}/files": {"content": "aGVsbG8="},
    "/experiments/{experiment}/heartbeat": {},
    "/campaigns/forecast": {
        "text": CAMPAIGN,
        "workflow": {"text": TIMED, "name": "f.yaml"},
        "user": "ada",
        "name": "c.yaml",
        "files": {"a.csv": "YQ=="},
        "dry_run": False,
    },
    "/campaigns": {
        "text": CAMPAIGN,
        "workflow": {"text": TIMED, "name": "f.yaml"},
        "user": "ada",
        "name": "c.yaml",
        "files": {"a.csv": "YQ=="},
        "dry_run": False,
    },
    "/campaigns/{campaign}/pause": {"by": "ada", "why": "x"},
    "/campaigns/{campaign}/resume": {"by": "ada"},
    "/campaigns/{campaign}/cancel": {"by": "ada", "why": "x", "stay": True},
    "/campaigns/{campaign}/archive": {"by": "ada", "undo": True},
    "/campaigns/{campaign}/clone": {
        "by": "ada",
        "name": "again",
        "visibility": "group",
        "dry_run": False,
        "propose": False,
        "priority": 1,
        "deadline": "12h",
        "runs": 100,
        "lab_time_s": 3600.0,
        "consumables": {"foil": 10.0},
        "tags": ["x"],
        "until": "",
        "stop_after": 2,
    },
    "/campaigns/{campaign}/amend": {
        "by": "ada",
        "priority": 1,
        "deadline": "12h",
        "runs": 100,
        "lab_time_s": 3600.0,
        "consumables": {"foil": 10.0},
        "tags": ["x"],
        "until": "steps.seal.result.x > 1",
        "stop_after": 3,
    },
    "/approvals/{subject}/approve": {
        "by": "bo",
        "digest": "0123456789abcdef",
        "comment": "x",
        "priority": 1,
        "deadline": "12h",
        "runs": 2,
        "lab_time_s": 60.0,
        "consumables": {"foil": 10.0},
        "alike": False,
    },
    "/approvals/{subject}/refuse": {"by": "bo", "comment": "x"},
    "/words/erasures": {"because": "personal", "by": "ada", "records": [3], "user": ""},
    "/words/erasures/{erasure}/approve": {"by": "bo"},
    "/words/erasures/{erasure}/refuse": {"by": "bo"},
    "/policy": {"text": POLICY, "by": "ada", "name": "p.yaml"},
    "/shares": {"text": SHARES, "by": "ada", "name": "s.yaml"},
    "/bookings": {
        "target": "arm",
        "begins_at": 4_000_000_000_000_000_000,
        "ends_at": 4_000_003_600_000_000_000,
        "whom": "ada",
        "maintenance": False,
        "why": "x",
        "zone": "Europe/Zurich",
        "rule": "FREQ=WEEKLY",
        "last_at": 0,
        "force": True,
        "by": "ada",
    },
    "/bookings/{booking}/change": {
        "begins_at": 4_000_000_000_000_000_000,
        "ends_at": 4_000_003_600_000_000_000,
        "whom": "ada",
        "maintenance": None,
        "why": "x",
        "zone": "UTC",
        "rule": "",
        "last_at": 0,
        "force": False,
        "by": "ada",
    },
    "/bookings/{booking}/cancel": {"begins_at": 0, "why": "x", "by": "ada"},
    "/interventions/{intervention}": {"choice": "done", "by": "ada", "note": "a\nb", "result": {"a": 1}},
    "/control/pause": {"target": "arm", "by": "ada", "why": "x", "stay": False},
    "/control/resume": {"target": "arm", "by": "ada"},
    "/control/cancel": {"target": "arm", "by": "ada", "stay": True},
    "/estop": {"target": "sealer", "by": "ada"},
    "/modules/{module}/out-of-service": {"why": "x", "by": "ada", "until": 0},
    "/modules/{module}/in-service": {"by": "ada"},
    "/modules/{module}/trace": {"on": True, "by": "ada"},
    "/stations/place": {"station": "sealer.default", "labware": "plate96", "by": "ada"},
    "/stations/load": {"station": "wc.shelf", "labware": "plate96", "by": "ada", "count": 1, "lot": "L1"},
    "/stations/unload": {"station": "wc.shelf", "by": "ada", "labware": "", "count": 1},
    "/modules/{module}/replenish": {
        "resource": "foil",
        "by": "ada",
        "amount": 1.0,
        "unit": "",
        "lot": "L",
        "expires": "2031-01-01",
        "instead": False,
    },
    "/stations/observe": {"station": "sealer.default", "by": "ada", "what": "empty"},
    "/stations/declare": {
        "by": "ada",
        "stations": {"sealer.default": ["plate96"]},
        "workcell": "fuzz",
        "empty": True,
    },
    "/modules/{module}/locations": {
        "station": "sealer.default",
        "pose": [1.0] * 6,
        "by": "ada",
        "why": "x",
        "labware_type": "plate96",
    },
    "/modules/{module}/calibrations": {
        "by": "ada",
        "what": "volume",
        "certificate": "K-1",
        "report": "YQ==",
        "until": "2031-01-01",
        "why": "x",
    },
    "/workcells": {
        "text": CELL.format(name="fuzz"),
        "by": "ada",
        "name": "c.yaml",
        "dry_run": True,
        "labware": {"a.yaml": "YQ=="},
        "files": {"b.yaml": "YQ=="},
    },
    "/workcells/{workcell}/order": {
        "steps": [{"run": "R1", "step": 0, "start": 1}],
        "until": 2,
        "position": 1,
        "by": "ada",
    },
    "/workcells/{workcell}/access": {"by": "ada", "why": "x", "park": True},
    "/workcells/{workcell}/access/end": {
        "by": "ada",
        "note": "x",
        "changed": [{"station": "sealer.default", "what": "empty"}],
    },
    "/round": {"by": "ada", "stations": {"sealer.default": ["plate96"]}, "as_recorded": ["ot2.deck1"]},
    "/labware/{labware}/barcode": {"barcode": "B1", "by": "ada", "replace": True},
    "/labware/{labware}/owner": {"to": "user:bo", "by": "ada", "force": True, "note": "x"},
    "/runs/{run}/signatures": SIGNATURE,
    "/experiments/{experiment}/signatures": {
        "meaning": "reviewed",
        "password": "four words of mine",
        "why": "x",
    },
    "/campaigns/{campaign}/signatures": SIGNATURE,
    "/samples": {
        "text": "well,sample\nA1,s1\n",
        "by": "ada",
        "name": "s.csv",
        "labware": "P1",
        "station": "",
        "replace": True,
    },
}
"""A request that may be carried out, for every route that takes a body: what is sent is made from these."""

KNOWN = [
    *("fuzz", "sealer", "fuzz/sealer", "arm", "stacker", "sealer.default", "fuzz/sealer.default", "wc.shelf"),
    *(
        "wc.shelf.1",
        "wc.trash",
        "arm.hand",
        "R1",
        "R2",
        "R3",
        "E1",
        "E2",
        "C1",
        "C2",
        "I1",
        "I2",
        "P1",
        "P2",
        "lab",
        "*",
    ),
    *("cancel", "pause", "resume", "plate96", "lid96", "ada", "shared", "user:ada", "experiment:E1", "empty"),
    *("done", "not_done", "foil", "decision", "run", "action.requested", "f.yaml"),
]
TEXTS = [
    *("", " ", "x" * 300, "x" * 5_000, "x" * 70_000, "\x00", "a\nb", "a\x1b[2J", "\u202e", "\U0001f600" * 60),
    *(
        "labos",
        "fuzz/arm",
        "../../etc/passwd",
        "/etc/passwd",
        "%00",
        "%ff",
        "a: [",
        "'; DROP TABLE event; --",
    ),
    *("-1", "NaN", "1e999", "{}", "[]", "null", "\u2028", "\ufeff", "é" * 100, "run.*", "..", "~", "$(id)"),
    *("[" * 3_000, "- " * 2_000, "&a [*a]", "!!python/object:os.system {}", "{a: " * 200, "<<: *x"),
    "'; DROP TABLE event; --",
    *("well,sample\n" + "A1,x\n" * 2_000, "," * 5_000, '"' * 5_001, "plate,well,sample\nP9,A1,x\n" * 50),
]
VALUES: list[Any] = [
    *(None, True, False, 0, -1, 1, 2, 10**6, 2**31, 2**53, 2**63 - 1, 2**63, 2**64, -(2**63) - 1, 10**400),
    *(0.0, -0.5, 1e-320, 1e308, 3.5, [], {}, [[]], {"": {}}, [None] * 3_000, {"a": {"b": {"c": []}}}),
    *({str(n): n for n in range(500)}, ["x"] * 500, {"text": "a: 1"}, [{"station": "x", "what": "y"}] * 3),
]
RAW = [
    *(b"", b"null", b"[]", b"{", b"\x00", b"\xff\xfe", b'{"by": "\xff"}', b"[" * 50_000, b'{"a":' * 2_000),
    *(
        b"9" * 5_000,
        b'"x"',
        b'{"by": "\\ud800"}',
        b"\xef\xbb\xbf{}",
        b'{"by": 1e400}',
        b'{"by": "a", "by": "b"}',
    ),
]
QUERIES = (
    "after",
    "type",
    "stream",
    "correlation",
    "actor",
    "mentions",
    "last",
    "wait",
    "ended",
    "module",
    "waits",
)
SHORT = ["0", "0.01", "-1", "nan", "1e309", "x", ""]
"""Values of ``wait``: the campaign does not."""


class Request:
    def __init__(self, method: str, url: str, content: bytes | None, headers: dict[str, bytes]) -> None:
        self.method, self.url, self.content, self.headers = method, url, content, headers

    def __repr__(self) -> str:
        return f"{self.method} {self.url[:300]!r} {self.headers} {(self.content or b'')[:600]!r}"


class Fuzzer:
    """Makes requests to the routes of a lab, one like the other for one seed."""

    def __init__(self, seed: int) -> None:
        self.random = random.Random(seed)
        self.routes = [(operation.path, operation.method) for operation in OPERATIONS]

    def requests(self, count: int) -> Iterator[Request]:
        for number in range(count):
            yield self.request(*self.routes[number % len(self.routes)])

    def request(self, path: str, method: str) -> Request:
        choose = self.random
        url = PREFIX + self._path(path)
        if method == "GET" or choose.random() < 0.05:
            url += self._query()
        headers: dict[str, bytes] = {}
        if choose.random() < 0.1:
            headers["idempotency-key"] = choose.choice(["k1", "k2", "x" * 300, "é", ""]).encode()
        if choose.random() < 0.1:
            headers["labos-user"] = choose.choice(["ada", "labos", "a/b", "x" * 300, ""]).encode()
        if method == "GET":
            return Request(method, url, None, headers)
        headers["content-type"] = b"application/json" if choose.random() < 0.97 else b"text/plain"
        return Request(method, url, self._body(EXAMPLES[path]), headers)

    def _path(self, path: str) -> str:
        parts = []
        for part in path.split("/"):
            if part.startswith("{"):
                text = self._name()
                part = text if "%" in text else httpx.QueryParams({"": text})[""].replace("/", "%2F")
                part = "".join(
                    c if c.isascii() and c.isprintable() and c not in "?# " else "%FF" for c in part
                )
            parts.append(part)
        return "/".join(parts)[:3_000]

    def _query(self) -> str:
        choose = self.random
        asked: list[tuple[str, str]] = []
        for _ in range(choose.choice([0, 1, 1, 2, 3, 80])):
            name = choose.choice(QUERIES)
            asked.append((name, choose.choice(SHORT) if name == "wait" else self._name()[:400]))
        query = f"?{httpx.QueryParams(asked)}" if asked else ""
        return (
            query + choose.choice(["", "", "", "&actor=%ff", "&type=%00", f"&after={2**63}"]) if query else ""
        )

    def _name(self) -> str:
        choose = self.random
        if choose.random() < 0.7:
            return choose.choice(KNOWN)
        return str(choose.choice(TEXTS if choose.random() < 0.7 else VALUES))[:2_000]

    def _body(self, example: dict[str, Any]) -> bytes:
        choose = self.random
        if choose.random() < 0.05:
            return choose.choice(RAW)
        body = json.loads(json.dumps(example))
        for _ in range(choose.choice([0, 1, 1, 1, 2, 3])):
            self._change(body)
        return json.dumps(body).encode()

    def _change(self, body: Any) -> None:
        """One place of it is another now, at any depth."""
        choose = self.random
        keys: list[Any] = list(body) if isinstance(body, dict) else list(range(len(body)))
        if not keys:
            return
        key = choose.choice(keys)
        if isinstance(body[key], dict | list) and choose.random() < 0.5:
            self._change(body[key])
        elif choose.random() < 0.15 and isinstance(body, dict):
            del body[key]
        elif choose.random() < 0.1 and isinstance(body, dict):
            body[choose.choice(["extra", "", "x" * 300, "a\nb", "by"])] = self._value()
        else:
            body[key] = self._value()

    def _value(self) -> Any:
        choose = self.random
        kind = choose.random()
        if kind < 0.45:
            return choose.choice(KNOWN)
        if kind < 0.75:
            return choose.choice(TEXTS)
        value = copy.deepcopy(choose.choice(VALUES))
        for _ in range(choose.choice([0, 0, 0, 0, 40])):
            value = [value]
        return value


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Iterator[LabThread]:
    cell = parse_workcell(CELL.format(name="fuzz"), descriptions())
    settings = Settings.make(tmp_path_factory.mktemp("lab"), speed=5000.0, simulate=True)
    with LabThread(settings, [cell], nodes="processes") as running:
        yield running


def ask(raw: httpx.Client, request: Request) -> tuple[int, bytes]:
    with raw.stream(request.method, request.url, content=request.content, headers=request.headers) as answer:
        if "text/event-stream" in answer.headers.get("content-type", ""):
            return answer.status_code, b""
        return answer.status_code, answer.read()


def attack(lab: LabThread, seed: int, count: int) -> Counter[int]:
    """Send them all; how often each status was answered."""
    found: Counter[int] = Counter()
    headers = {"host": lab.url.removeprefix("http://")}
    with httpx.Client(base_url=lab.url, timeout=SLOWEST_S, headers=headers) as raw:
        for request in Fuzzer(seed).requests(count):
            began = time.monotonic()
            try:
                status, content = ask(raw, request)
            except httpx.HTTPError as error:
                raise AssertionError(f"seed {seed}, no answer ({error!r}) to {request!r}") from error
            took = time.monotonic() - began
            assert status < 500, (seed, request, status, content[:2_000])
            assert took < SLOWEST_S, (seed, request, took)
            if status >= 400:
                told = json.loads(content)
                assert told["detail"], (seed, request)
                assert told["code"], (seed, request)
                assert len(content) < 200_000, (seed, request, len(content))
            found[status] += 1
            assert not lab.runtime.kernel.failed.done(), (seed, request, lab.runtime.kernel.failed.result())
    return found


def expect_normal(lab: LabThread, name: str) -> None:
    """A run of another workcell goes to its end, and what was written can be read again."""
    with LabClient(lab.url) as client:
        assert client.health()["status"] == "ok"
        state = client.state()
        assert state["lab"]["id"]
        for booking in client.bookings():
            client.cancel_booking(booking["id"], "ada")
        for target in ("lab", *(m["name"] for m in state["modules"])):
            client.control("resume", target, "ada")
        client.apply_workcell(CELL.format(name=name), f"{name}.yaml", "ada")
        run = client.submit({"text": TAKE}, user="ada", workcell=name)
        assert client.wait(run, timeout_s=90).status == "completed", client.status(run)


def seed_of(number: int) -> int:
    return int(os.environ.get("FUZZ_SEED", number))


def test_every_route_is_attacked() -> None:
    routes = Fuzzer(0).routes
    assert len(routes) > 30
    assert {path for path, method in routes if method == "POST"} == EXAMPLES.keys()


@pytest.mark.timeout(300)
@pytest.mark.slow
def test_some_hundred_odd_requests(lab: LabThread) -> None:
    found = attack(lab, seed_of(1), 400)
    assert found[200] + found[201] > 20  # some are carried out
    assert found[400] > 50
    expect_normal(lab, "after1")


@pytest.mark.full
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("seed", range(10, 14))
def test_thousands_of_odd_requests(tmp_path: Path, seed: int) -> None:
    cell = parse_workcell(CELL.format(name="fuzz"), descriptions())
    settings = Settings.make(tmp_path / "lab", speed=5000.0, simulate=True)
    with LabThread(settings, [cell], nodes="processes") as lab:
        attack(lab, seed_of(seed), 5_000)
        expect_normal(lab, "afterwards")
    with LabThread(settings, nodes="none") as again, LabClient(again.url) as client:
        assert client.health()["status"] == "ok"

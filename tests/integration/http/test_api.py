"""The operations of the API as they are declared, as they are described, and as they are served."""

from __future__ import annotations

import socket
import typing
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import msgspec
import pytest
from openapi_spec_validator import OpenAPIV31SpecValidator

import labos.errors
from labos.bootstrap import LabThread, descriptions
from labos.client import LabClient
from labos.errors import LabosError
from labos.http.limits import check_fields
from labos.http.openapi import document
from labos.http.operation import Need, Operation
from labos.http.problems import MEDIA_TYPE, PROBLEMS, make_problem_of_error
from labos.http.routes import OPERATIONS, PREFIX
from labos.settings import Settings
from labos.spec import SpecErrors, find_spec, load_workcell

IDS = [operation.id for operation in OPERATIONS]
OLD = ("/state", "/events", "/runs", "/nodes", "/inventory", "/round")


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Iterator[LabThread]:
    cell = load_workcell(find_spec("workcells", "rpl"), descriptions())
    settings = Settings.make(tmp_path_factory.mktemp("lab"), speed=5000.0, simulate=True)
    with LabThread(settings, [cell], nodes="none") as running:
        yield running


@pytest.fixture
def raw(lab: LabThread) -> Iterator[httpx.Client]:
    with httpx.Client(base_url=lab.url, timeout=30) as found:
        yield found


# -- as they are declared --------------------------------------------------------------------------


def test_ids_and_paths_are_given_once() -> None:
    assert len(set(IDS)) == len(IDS)
    assert len({(operation.method, operation.path) for operation in OPERATIONS}) == len(OPERATIONS)


@pytest.mark.parametrize("operation", OPERATIONS, ids=IDS)
def test_an_operation_says_all_that_is_needed(operation: Operation) -> None:
    assert operation.summary
    assert operation.needs in (*typing.get_args(Need), "nobody")
    assert operation.shape.answer is not None
    assert set(operation.problems) <= PROBLEMS.keys()
    named = {name.strip("{}") for name in operation.path.split("/") if name.startswith("{")}
    path = operation.shape.path
    assert named == set(path.__struct_fields__ if path is not None else ())
    if operation.shape.body is not None:
        assert operation.example is not None, "an operation with a body has an example"


@pytest.mark.parametrize("operation", OPERATIONS, ids=IDS)
def test_an_example_is_a_request_that_is_taken(operation: Operation) -> None:
    if operation.example is not None:
        assert operation.shape.body is not None
        check_fields(msgspec.convert(operation.example, operation.shape.body))
    if operation.example_answer is not None:
        answer = msgspec.convert(operation.example_answer, operation.shape.answer)
        assert msgspec.to_builtins(answer).keys() >= operation.example_answer.keys()


def test_every_error_is_a_problem_that_is_known() -> None:
    kinds = [
        kind
        for kind in (*vars(labos.errors).values(), SpecErrors)
        if isinstance(kind, type) and issubclass(kind, LabosError)
    ]
    for kind in kinds:
        error = kind.__new__(kind)
        error.message, error.remedy = "It is so.", "Do this."
        for field in ("file", "line", "column", "field"):
            setattr(error, field, "" if field in ("file", "field") else 0)
        if kind is SpecErrors:
            error.findings = ()  # type: ignore[attr-defined]
        found = make_problem_of_error(error)
        assert found.status == PROBLEMS[found.code].status if found.code in PROBLEMS else found.status >= 400
        assert "It is so." in found.detail


# -- as they are described -------------------------------------------------------------------------


def test_the_description_is_valid(raw: httpx.Client) -> None:
    answer = raw.get(f"{PREFIX}/openapi.json")
    assert answer.headers["content-type"] == "application/json"
    found = answer.json()
    assert found["openapi"].startswith("3.1")
    OpenAPIV31SpecValidator(found).validate()
    served = {(op["operationId"]) for path in found["paths"].values() for op in path.values()}
    assert served == set(IDS)
    assert "\\A" not in answer.text, "patterns are written as ECMAScript has them"


def test_the_description_is_the_same_each_time() -> None:
    first, again = (msgspec.json.encode(document(OPERATIONS)) for _ in range(2))
    assert first == again


# -- as they are served ----------------------------------------------------------------------------


def is_problem(answer: httpx.Response, status: int, code: str) -> dict[str, Any]:
    assert answer.headers["content-type"] == MEDIA_TYPE
    told: dict[str, Any] = answer.json()
    assert (answer.status_code, told["status"], told["code"]) == (status, status, code), told
    assert told["type"] == f"urn:labos:problem:{code}"
    assert told["title"] == PROBLEMS[code].title
    assert told["detail"]
    return told


def test_old_paths_are_no_longer_offered(raw: httpx.Client) -> None:
    for path in OLD:
        is_problem(raw.get(path), 404, "not_found")
    assert raw.get("/health").json() == {"status": "ok"}


def test_what_the_router_refuses_is_a_problem_too(raw: httpx.Client) -> None:
    is_problem(raw.get(f"{PREFIX}/nowhere"), 404, "not_found")
    is_problem(raw.post(f"{PREFIX}/runs/R1/dance", json={}), 404, "not_found")
    answer = raw.request("DELETE", f"{PREFIX}/runs", json={})
    is_problem(answer, 405, "method_not_allowed")
    assert "GET" in answer.headers["allow"]
    large = raw.post(f"{PREFIX}/estop", json={"target": "x" * 600_000})
    is_problem(large, 413, "too_large")
    is_problem(raw.get(f"{PREFIX}/runs/{'x' * 5000}"), 414, "uri_too_long")
    is_problem(raw.post(f"{PREFIX}/runs", content=b"x"), 415, "unsupported_media_type")


def test_a_fault_of_the_server_is_a_problem_too(
    lab: LabThread, raw: httpx.Client, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("labos.http.stock.day_of", None)
    answer = raw.post(
        f"{PREFIX}/modules/sealer/replenish", json={"resource": "foil", "by": "ada"}, headers={}
    )
    told = is_problem(answer, 500, "internal")
    assert "TypeError" in told["detail"]


def test_a_parameter_that_is_not_known_is_refused(raw: httpx.Client) -> None:
    told = is_problem(raw.get(f"{PREFIX}/events", params={"mention": "R1"}), 400, "bad_input")
    assert "mention" in told["detail"]
    is_problem(raw.get(f"{PREFIX}/round", params={"x": "1"}), 400, "bad_input")
    is_problem(raw.get(f"{PREFIX}/events", params={"wait": "61"}), 400, "bad_input")
    is_problem(raw.get(f"{PREFIX}/state", params={"waits": "perhaps"}), 400, "bad_input")


def test_what_is_answered_is_what_is_described(lab: LabThread, raw: httpx.Client, tmp_path: Path) -> None:
    screen = tmp_path / "screen.yaml"
    screen.write_text(
        "labos: 1\ncampaign: c\nworkflow: pcr\nrows: {list: [{seal.time: 2}, {seal.time: 3}]}\n"
    )
    with LabClient(lab.url) as client:
        run = client.submit("pcr", user="ada")
        campaign = client.submit_campaign(screen, user="ada")["campaign"]
        experiment = client.start_experiment("app", "ada")
        waits = client.submit("pcr", user="ada", propose=True)
        day = 86_400_000_000_000
        booking = client.book("hidex", 20_000 * day, 20_001 * day, "ada", rule="FREQ=WEEKLY")["id"]
    for operation in OPERATIONS:
        if operation.id == "get_user":
            continue  # there is none in an open lab: see test_people
        if operation.method == "GET" and operation.media == ("application/json",):
            names = {
                "run": run,
                "campaign": campaign,
                "experiment": experiment,
                "booking": booking,
                "module": "pf400",
                "workcell": "rpl",
                "subject": waits,
            }
            path = operation.path.format(**names)
            answer = raw.get(PREFIX + path)
            assert answer.status_code == operation.status, (path, answer.text)
            found = msgspec.json.decode(answer.content, type=operation.shape.answer)
            assert set(answer.json()) == set(found.__struct_fields__), path


def test_runs_are_paged_by_position(raw: httpx.Client, lab: LabThread) -> None:
    with LabClient(lab.url) as client:
        names = [client.submit("pcr", user="ada") for _ in range(7)]
        ended = [client.submit("pcr", user="bo") for _ in range(5)]
        for run in ended:
            client.cancel(run, "bo")
    alive: list[str] = []
    found: dict[str, Any] = {"more": True, "position": 0}
    while found["more"]:
        asked = {"after": found["position"], "limit": 3}
        found = raw.get(f"{PREFIX}/runs", params=asked).json()
        assert len(found["runs"]) <= 3
        alive += [run["id"] for run in found["runs"]]
    assert alive[-7:] == names
    assert len(set(alive)) == len(alive)
    over: list[str] = []
    before = 0
    while len(over) < 5:
        asked = {"ended": 2, "before": before, "after": 2**63 - 1}
        page = raw.get(f"{PREFIX}/runs", params=asked).json()
        over = [run["id"] for run in page["runs"]] + over
        before = page["ended_position"]
    assert over[-5:] == ended


def test_what_is_no_http_is_a_problem_too(lab: LabThread) -> None:
    host, _, port = lab.url.removeprefix("http://").partition(":")
    for sent in (b"\x00\x01\r\n\r\n", b"GET /health HTTP/1.1\r\nhost: localhost\r\nx: " + b"x" * 70_000):
        with socket.create_connection((host, int(port)), timeout=20) as line:
            line.sendall(sent)
            head, _, body = line.recv(65_536).partition(b"\r\n\r\n")
            assert head.startswith(b"HTTP/1.1 400 ")
            assert MEDIA_TYPE.encode() in head
            assert msgspec.json.decode(body)["code"] == "bad_input"

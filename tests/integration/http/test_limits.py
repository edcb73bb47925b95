"""What a request may hold: every text has a limit and a form, numbers fit, tables are not too deep."""

from __future__ import annotations

import typing
from collections.abc import Iterator
from typing import Any

import httpx
import msgspec
import pytest

from labos.bootstrap import LabThread, descriptions
from labos.client import LabClient
from labos.client._lab import API
from labos.http import access, bodies, control, placing, service, stock
from labos.http.limits import check_person, name_in_emergency
from labos.settings import Settings
from labos.spec import find_spec, load_workcell

FLOW = {"text": "labos: 1\nname: f\nsteps:\n  - {name: seal, module: sealer, action: seal}\n"}
NUMBERS = (("GET", "/events?after="), ("GET", "/events?last="), ("GET", "/runs?ended="))


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Iterator[LabThread]:
    cell = load_workcell(find_spec("workcells", "rpl"), descriptions())
    settings = Settings.make(tmp_path_factory.mktemp("lab"), speed=5000.0, simulate=True)
    with LabThread(settings, [cell], nodes="none") as running:
        yield running


@pytest.fixture
def raw(lab: LabThread) -> Iterator[httpx.Client]:
    with httpx.Client(base_url=lab.url + API, timeout=30) as found:
        yield found
        assert found.get("/health").json()["status"] == "ok"


def check_refused(answer: httpx.Response, *words: str) -> None:
    assert 400 <= answer.status_code < 500, answer.text[:300]
    told = answer.json()
    for word in words:
        assert word in told["detail"], told
    assert told["remedy"] or told["details"]
    assert len(answer.content) < 4000


def test_every_text_and_list_of_every_body_has_a_limit() -> None:
    """Of a new field of a request somebody has to say how long it may be."""
    free = {"EmergencyStop.said_by"}  # cut, not refused: see name_in_emergency
    found = []
    for module in (access, bodies, control, placing, service, stock):
        for kind in vars(module).values():
            own = isinstance(kind, type) and kind.__module__.startswith("labos.http")
            if own and issubclass(kind, msgspec.Struct) and _is_a_body(kind):
                hints = typing.get_type_hints(kind, include_extras=True)
                found += [f"{kind.__name__}.{name}" for name, hint in hints.items() if _is_endless(hint)]
    assert {*found} - free == set()


def _is_a_body(kind: type[msgspec.Struct]) -> bool:
    return kind.__struct_config__.forbid_unknown_fields or kind is service.WorkflowText


def _is_endless(hint: Any) -> bool:
    if typing.get_origin(hint) is typing.Annotated:
        base, *rest = typing.get_args(hint)
        limited = any(isinstance(m, msgspec.Meta) and (m.max_length or m.le is not None) for m in rest)
        return any(map(_is_endless, typing.get_args(base))) if limited else _is_endless(base)
    if hint in (str, int, float, bytes):
        return hint is not bytes
    if hint == dict[str, Any]:
        return False  # check_fields limits them
    return typing.get_origin(hint) in (list, dict) or any(map(_is_endless, typing.get_args(hint)))


LONG = "x" * 70_000


@pytest.mark.parametrize(
    ("path", "body"),
    [
        ("/modules/sealer/out-of-service", {"why": LONG, "by": "ada"}),
        ("/modules/sealer/out-of-service", {"why": "x", "by": LONG}),
        ("/control/pause", {"target": "lab", "by": "ada", "why": LONG}),
        ("/workcells/rpl/access", {"by": "ada", "why": LONG}),
        ("/interventions/I1", {"choice": "done", "by": "ada", "note": LONG}),
        ("/labware/P1/owner", {"to": f"user:{LONG}", "by": "ada"}),
        ("/labware/P1/barcode", {"barcode": LONG, "by": "ada"}),
        ("/experiments", {"name": LONG, "user": "ada"}),
        ("/experiments/E1/end", {"why": LONG}),
        ("/stations/load", {"station": "sealer.default", "labware": "plate96", "by": "ada", "lot": LONG}),
        ("/runs", {"workflow": {**FLOW, "name": LONG}, "user": "ada"}),
        ("/runs", {"workflow": {**FLOW, "files": {"x" * 300: "YQ=="}}, "user": "ada"}),
        ("/workcells", {"text": "x" * 2_000_000, "by": "ada"}),
    ],
)
def test_long_texts_are_refused(raw: httpx.Client, path: str, body: dict[str, Any]) -> None:
    check_refused(raw.post(path, json=body), "at most")


@pytest.mark.parametrize(
    "name", ["labos", " LabOS ", "rpl/pf400", "a\nb", "a\x00b", "a\x1bb", "a\u2028b", " "]
)
def test_nobody_asks_in_the_name_of_labos_or_a_module(raw: httpx.Client, name: str) -> None:
    for path, body in (
        ("/runs", {"workflow": FLOW, "user": name}),
        ("/experiments", {"name": "e", "user": name}),
        ("/control/pause", {"target": "lab", "by": name}),
        ("/modules/sealer/out-of-service", {"why": "x", "by": name}),
        ("/modules/sealer/in-service", {"by": name}),
        ("/modules/sealer/trace", {"by": name}),
        ("/runs/R1/cancel", {"by": name}),
        ("/stations/load", {"station": "s", "labware": "plate96", "by": name}),
        ("/workcells", {"text": "labos: 1", "by": name}),
        ("/labware/P1/owner", {"to": f"user:{name}", "by": "ada"}),
    ):
        check_refused(raw.post(path, json=body))


def test_why_is_one_line(raw: httpx.Client) -> None:
    body = {"why": "broken\nrun.completed R1", "by": "ada"}
    check_refused(raw.post("/modules/sealer/out-of-service", json=body), "why", "line break")


def test_headers_have_limits(raw: httpx.Client) -> None:
    body = {"name": "e", "user": "ada"}
    check_refused(
        raw.post("/experiments", json=body, headers={"idempotency-key": "k" * 300}), "Idempotency-Key"
    )
    check_refused(raw.post("/experiments", json=body, headers={"idempotency-key": b"\xff\xfe"}), "UTF-8")
    started = raw.post("/experiments", json=body)
    path = f"/experiments/{started.json()['experiment']}/end"
    for name in ("labos", "rpl/pf400", "a" * 200):
        check_refused(raw.post(path, json={}, headers={"labos-user": name}), "LabOS-User")
    assert raw.post(path, json={}, headers={"labos-user": "Zoë".encode()}).status_code == 200


def test_an_emergency_stop_is_not_refused_for_a_name(raw: httpx.Client) -> None:
    for by in (LONG, "labos", "rpl/pf400", "a\nb\x00", ""):
        answer = raw.post("/estop", json={"target": "*", "by": by})
        assert answer.status_code == 200, answer.text
    assert name_in_emergency("rpl/pf400\n") == "rpl pf400 "
    assert check_person(name_in_emergency("labos"), "by") == "somebody"
    assert len(name_in_emergency(LONG)) == 100


@pytest.mark.parametrize("number", [2**63, 2**64, 10**30, "9" * 5000, "x", "1.5"])
def test_numbers_of_queries_fit(raw: httpx.Client, number: Any) -> None:
    for method, path in NUMBERS:
        check_refused(raw.request(method, f"{path}{number}"))
    for wait in ("nan", "inf", "1e309", "x"):
        check_refused(raw.get(f"/events?wait={wait}"))


def test_the_end_of_the_log_can_be_asked_for(raw: httpx.Client) -> None:
    answer = raw.get(f"/events?after={2**63 - 1}")
    assert (answer.status_code, answer.json()["events"]) == (200, [])


def test_queries_have_limits(raw: httpx.Client) -> None:
    check_refused(raw.get("/events?" + "&".join(f"type=t{n}" for n in range(1500))))
    check_refused(raw.get("/events?" + "&".join("type=t" for _ in range(60))), "60 parameters")
    check_refused(raw.get("/events", params={"mentions": "x" * 300}), "mentions")
    check_refused(raw.get("/events", params={"actor": "a\x00b"}), "actor")
    check_refused(raw.get("/events?actor=%ff"), "UTF-8")
    check_refused(raw.get("/runs/%ff%fe"), "UTF-8")
    check_refused(raw.get("/runs/R%00"), "run")
    check_refused(raw.get("/runs/" + "R" * 300), "run")


@pytest.mark.parametrize(
    "raw_body",
    [
        b'{"target": "\xff\xfe", "by": "ada"}',
        b"[" * 100_000,
        b'{"a":' * 5_000 + b"1" + b"}" * 5_000,
        b'{"target": "lab", "by": "ada", "why": ' + b"[" * 900 + b"]" * 900 + b"}",
        b'{"target": "\\ud800", "by": "ada"}',
        b'{"target": "lab", "by": "ada", "stay": 99999999999999999999999999}',
        b"null",
        b"",
        b"\x00",
    ],
)
def test_broken_json_is_refused(raw: httpx.Client, raw_body: bytes) -> None:
    head = {"content-type": "application/json"}
    check_refused(raw.post("/control/pause", content=raw_body, headers=head), "cannot be read")


@pytest.mark.parametrize(
    "facts",
    [
        {"x": 2**64},
        {"x": -(2**63) - 1},
        {"x": 10**100},
        {"a\nb": 1},
        {"x": "\x00"},
        {"x": "y" * 60_000},
        {"x": [[]] * 30_000},
        {"x": eval("[" * 60 + "]" * 60)},
    ],
)
def test_tables_have_limits(raw: httpx.Client, facts: dict[str, Any]) -> None:
    experiment = raw.post("/experiments", json={"name": "e", "user": "ada"}).json()["experiment"]
    check_refused(
        raw.post(f"/experiments/{experiment}/notes", json={"kind": "decision", "name": "n", "facts": facts})
    )
    check_refused(raw.post("/runs", json={"workflow": FLOW, "user": "ada", "payload": facts}))
    assert raw.post(f"/experiments/{experiment}/end", json={}).status_code == 200


def test_deep_and_long_files_are_refused(raw: httpx.Client) -> None:
    for text in ("[" * 5_000, "- " * 5_000 + "1", "a:\n" + "".join(" " * n + "b:\n" for n in range(1, 400))):
        check_refused(raw.post("/workcells", json={"text": text, "by": "ada"}))
        check_refused(raw.post("/runs", json={"workflow": {"text": text}, "user": "ada"}))


HUGE = "9" * 40
NESTED = "1"
for _ in range(20):
    NESTED = f"1 * (0 + {NESTED} < 2 and true or false)"


@pytest.mark.parametrize(
    "more",
    [
        f'until: "result.seal.x > {HUGE}"',
        f'until: "steps.seal.result.x > {HUGE}"',
        f'until: "steps.seal.result[{HUGE}] > 1"',
        f'until: "steps.seal.result.x > {NESTED}"',
        'until: "steps.seal.result.x > 1e999"',
        f"priority: {HUGE}",
        f"budget: {{runs: {HUGE}}}",
        f"budget: {{lab_hours: {HUGE}.5e300}}",
        f"budget: {{consumables: {{tips: {HUGE}}}}}",
        "budget: {lab_hours: .nan}",
        "budget: {lab_hours: .inf}",
        f"rows: {{list: [{{time: {HUGE}}}]}}",
        f"rows: {{grid: {{time: [{HUGE}]}}}}",
        "rows: {list: [{time: .nan}]}",
        f"deadline: {HUGE}",
    ],
)
def test_numbers_of_campaigns_fit(raw: httpx.Client, more: str) -> None:
    text = "labos: 1\ncampaign: c\nworkflow: f\n" + more
    text += "" if "rows:" in more else "\nrows: {list: [{}]}"
    for dry_run in (True, False):
        body = {"text": text, "user": "ada", "workflow": FLOW, "dry_run": dry_run}
        check_refused(raw.post("/campaigns", json=body))


@pytest.mark.parametrize("field", ["when", "expect"])
@pytest.mark.parametrize("what", [f"result.x > {HUGE}", f"result.x > {NESTED}"])
def test_numbers_of_conditions_fit(raw: httpx.Client, field: str, what: str) -> None:
    asked = what.replace("result", "steps.seal.result") if field == "when" else what
    text = FLOW["text"] + f"  - {{name: s, module: sealer, action: seal, {field}: '{asked}'}}\n"
    check_refused(raw.post("/runs", json={"workflow": {"text": text}, "user": "ada"}))


def test_a_run_is_not_put_into_somebody_elses_experiment(lab: LabThread, raw: httpx.Client) -> None:
    with LabClient(lab.url) as client:
        experiment = client.start_experiment("e", "ada")
        body = {"workflow": FLOW, "user": "eve", "experiment": experiment}
        check_refused(raw.post("/runs", json=body), "ada's")
        run = client.submit(FLOW, user="ada", experiment=experiment)
        client.cancel(run, "ada")
        client.end_experiment(experiment)


def test_an_application_that_fails_with_many_words_ends(lab: LabThread) -> None:
    from labos.client import Experiment

    with (
        LabClient(lab.url) as client,
        pytest.raises(ValueError, match="first"),
        Experiment(client, "e", "ada") as experiment,
    ):
        raise ValueError("first\nsecond " + LONG)
    with LabClient(lab.url) as client:
        assert experiment.id not in [item["id"] for item in client.state()["experiments"]]

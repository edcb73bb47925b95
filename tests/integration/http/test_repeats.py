"""An idempotency key stands for one request: it is carried out once, and its answer comes again."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest
from starlette.responses import Response

from labos.bootstrap import LabThread, descriptions
from labos.client import LabClient
from labos.client._lab import API
from labos.errors import CommitInDoubt, KeyReused, Refused
from labos.http.idempotency import IdempotentAnswers
from labos.settings import Settings
from labos.spec import find_spec, load_workcell
from tests.support.lab_process import until

FLOW = "labos: 1\nname: f\nsteps:\n  - {name: seal, module: sealer, action: seal}\n"
TIMED = FLOW.replace("action: seal}", "action: seal, args: {time: payload.time}}")
RUN = {"workflow": {"text": FLOW}, "user": "ada"}
BATCH = {"workflow": {"text": TIMED}, "payloads": [{"time": 1}, {"time": 2}, {"time": 1}], "user": "ada"}
CAMPAIGN = {
    "text": "labos: 1\ncampaign: c\nworkflow: f\nrows: {list: [{time: 1}, {time: 2}]}\n",
    "workflow": {"text": TIMED},
    "user": "ada",
}
LOAD = {"station": "hidex.default", "labware": "plate96", "by": "ada"}


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


def make_key_header(key: str) -> dict[str, str]:
    return {"idempotency-key": key}


def position(raw: httpx.Client) -> int:
    return int(raw.get("/health").json()["position"])


def stock(raw: httpx.Client, station: str) -> int:
    stations = raw.get("/state").json()["stations"]
    return next(int(found["stock"]) for found in stations if found["name"].endswith(station))


def test_the_same_request_is_carried_out_once(raw: httpx.Client) -> None:
    first = raw.post("/stations/load", json=LOAD, headers=make_key_header("load"))
    after = position(raw)
    again = [raw.post("/stations/load", json=LOAD, headers=make_key_header("load")) for _ in range(3)]
    assert first.status_code == 201
    assert {(found.status_code, found.content) for found in again} == {(201, first.content)}
    assert position(raw) == after
    assert raw.post("/stations/load", json=LOAD).status_code == 409  # the station is full by now


def test_requests_that_cross_are_one(raw: httpx.Client, lab: LabThread) -> None:
    body = {"station": "sciclops.tower1", "by": "ada", "count": 1}
    before = stock(raw, "sciclops.tower1")
    found: list[bytes] = []

    def send() -> None:
        with httpx.Client(base_url=lab.url + API, timeout=30) as own:
            found.append(own.post("/stations/unload", json=body, headers=make_key_header("crossing")).content)

    threads = [threading.Thread(target=send) for _ in range(6)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(found) == 6
    assert len(set(found)) == 1
    assert stock(raw, "sciclops.tower1") == before - 1


@pytest.mark.parametrize(
    ("path", "body"),
    [
        ("/control/pause", {"target": "lab", "by": "bo"}),
        ("/control/resume", {"target": "lab", "by": "ada"}),
        ("/runs", RUN),
        ("/runs/batch", BATCH),
    ],
)
def test_a_key_belongs_to_one_request(raw: httpx.Client, path: str, body: dict[str, Any]) -> None:
    raw.post("/control/pause", json={"target": "lab", "by": "ada"}, headers=make_key_header("mine"))
    answer = raw.post(path, json=body, headers=make_key_header("mine"))
    assert (answer.status_code, answer.json()["code"]) == (409, "key_reused")
    assert "mine" in answer.json()["detail"]
    raw.post("/control/resume", json={"target": "lab", "by": "ada"})


def test_who_asks_belongs_to_the_request(raw: httpx.Client) -> None:
    experiment = raw.post("/experiments", json={"name": "e", "user": "ada"}).json()["experiment"]
    path, body = f"/experiments/{experiment}/notes", {"kind": "decision", "name": "n"}
    ada = raw.post(path, json=body, headers=make_key_header("note") | {"labos-user": "ada"})
    bo = raw.post(path, json=body, headers=make_key_header("note") | {"labos-user": "bo"})
    assert (ada.status_code, bo.status_code) == (201, 409)


def test_a_refusal_is_not_kept(raw: httpx.Client) -> None:
    body = {"station": "sealer.default", "labware": "plate96", "by": "ada"}
    assert raw.post("/stations/place", json=body).status_code == 201
    assert raw.post("/stations/place", json=body, headers=make_key_header("later")).status_code == 409
    raw.post("/stations/unload", json={"station": "sealer.default", "by": "ada"})
    assert raw.post("/stations/place", json=body, headers=make_key_header("later")).status_code == 201


def test_a_check_takes_no_key(raw: httpx.Client) -> None:
    checked = raw.post("/campaigns", json=CAMPAIGN | {"dry_run": True}, headers=make_key_header("campaign"))
    assert (checked.status_code, checked.json()["campaign"]) == (200, "")
    first = raw.post("/campaigns", json=CAMPAIGN, headers=make_key_header("campaign"))
    again = raw.post("/campaigns", json=CAMPAIGN, headers=make_key_header("campaign"))
    assert (first.status_code, first.content) == (again.status_code, again.content)
    assert first.status_code == 201
    assert len(raw.get("/campaigns").json()["campaigns"]) == 1


def test_runs_experiments_and_campaigns_are_known_after_a_restart(tmp_path: Path) -> None:
    cell = load_workcell(find_spec("workcells", "rpl"), descriptions())
    settings = Settings.make(tmp_path / "lab", speed=5000.0, simulate=True)
    requests: tuple[tuple[str, dict[str, Any]], ...] = (
        ("/runs", RUN),
        ("/runs/batch", BATCH),
        ("/experiments", {"name": "e", "user": "ada"}),
        ("/campaigns", CAMPAIGN),
    )

    def send(url: str) -> list[httpx.Response]:
        with httpx.Client(base_url=url + API, timeout=30) as raw:
            return [
                raw.post(path, json=body, headers=make_key_header(f"key of {path}"))
                for path, body in requests
            ] + [
                raw.post(path, json={**body, "user": "bo"}, headers=make_key_header(f"key of {path}"))
                for path, body in requests
            ]

    with LabThread(settings, [cell], nodes="none") as lab:
        before = send(lab.url)
    with LabThread(settings, nodes="none") as lab:
        after = send(lab.url)
    assert [found.status_code for found in before] == [found.status_code for found in after]
    assert [found.status_code for found in after] == [201] * 4 + [409] * 4
    for first, again in zip(before[:4], after[:4], strict=True):
        assert first.json() == again.json()
    assert [found.json()["code"] for found in after[4:]] == ["key_reused"] * 4
    assert issubclass(KeyReused, Refused)


def test_runs_that_are_asked_for_together_are_carried_out_once(raw: httpx.Client) -> None:
    """Under keys of their own, or that of the request; what is wrong with one is said of it."""
    first = raw.post("/runs/batch", json=BATCH, headers=make_key_header("together"))
    again = raw.post("/runs/batch", json=BATCH, headers=make_key_header("together"))
    named = BATCH | {"keys": ["together-0", "together-1", "together-2"]}
    assert (first.status_code, first.json()) == (again.status_code, again.json()) == (201, again.json())
    assert raw.post("/runs/batch", json=named).json()["runs"] == first.json()["runs"]
    single = RUN | {"workflow": {"text": TIMED}, "payload": {"time": 2}}
    found = raw.post("/runs", json=single, headers=make_key_header("together-1"))
    assert found.json()["run"] == first.json()["runs"][1], "as if it had been submitted by itself"
    refused = (
        ({"keys": ["a", "b"]}, "3 payloads, but 2 keys"),
        ({"keys": ["a", "b", "a"]}, "payloads[2]: Its key 'a' is also the key of payloads[0]"),
        ({"keys": ["a", "b", "together-1"]}, "payloads[2]: The key 'together-1' belongs to"),
        ({"payloads": [{"time": 1}, {"time": "x"}], "first": 7}, "payloads[8]: "),
        ({"payloads": [{"time": 1}, {"time": 2**70}]}, "payloads[1]"),
        ({"payloads": []}, "payloads"),
        ({"payloads": [{}] * 51}, "payloads"),
    )
    before = position(raw)
    for change, why in refused:
        answer = raw.post("/runs/batch", json=BATCH | change)
        assert answer.status_code in (400, 409, 422), change
        assert why in answer.json()["detail"], answer.json()
    assert position(raw) == before


def test_the_client_raises_the_error_of_a_key_that_was_used(lab: LabThread) -> None:
    with LabClient(lab.url) as client:
        client.submit({"text": FLOW}, user="ada", request="of the client")
        with pytest.raises(KeyReused, match="of the client"):
            client.submit({"text": FLOW}, user="bo", request="of the client")


# -- what is kept ----------------------------------------------------------------------------------


def test_only_so_much_is_kept() -> None:
    async def body() -> None:
        kept = IdempotentAnswers(most=3, most_bytes=100)
        done: list[str] = []

        async def ask(key: str, size: int = 10) -> None:
            async def work() -> Response:
                done.append(key)
                return Response(b"x" * size)

            await kept.answer_once(key, "/x", "the same", work, logs_key=False)
            await asyncio.sleep(0)  # what is kept is counted after the answer

        for key in ("a", "b", "c", "c", "b", "a"):
            await ask(key)
        assert done == ["a", "b", "c"]
        await ask("d")
        await ask("a")
        assert done == ["a", "b", "c", "d", "a"]
        await ask("large", 99)
        await ask("d")
        assert done == ["a", "b", "c", "d", "a", "large", "d"]

    asyncio.run(body())


@pytest.mark.parametrize("logs_key", [True, False])
def test_what_may_have_been_done_is_not_done_again(logs_key: bool) -> None:
    """Unless the log itself knows of the key."""

    async def body() -> None:
        kept, tries = IdempotentAnswers(), []

        async def work() -> Response:
            tries.append(1)
            raise CommitInDoubt("It may be on disk.")

        for _ in range(2):
            try:
                answer = await kept.answer_once("k", "/x", "x", work, logs_key=logs_key)
                assert answer.status_code == 503
            except CommitInDoubt:
                assert logs_key
        assert len(tries) == (2 if logs_key else 1)

    asyncio.run(body())


def test_who_goes_away_does_not_end_the_request_for_others() -> None:
    async def body() -> None:
        kept, go = IdempotentAnswers(), asyncio.Event()

        async def work() -> Response:
            await go.wait()
            return Response(b"done")

        first = asyncio.ensure_future(kept.answer_once("k", "/x", "x", work, logs_key=False))
        second = asyncio.ensure_future(kept.answer_once("k", "/x", "x", work, logs_key=False))
        await asyncio.sleep(0)
        first.cancel()
        go.set()
        assert (await second).body == b"done"

    asyncio.run(body())


def test_another_request_waits_for_the_first_one_with_its_key() -> None:
    """What the log is to say of a key is not there yet while the first request is under way."""

    async def body() -> None:
        kept, go, done = IdempotentAnswers(), asyncio.Event(), []

        async def fail() -> Response:
            await go.wait()
            raise Refused("Not now.")

        async def work() -> Response:
            done.append(go.is_set())
            return Response(b"done")

        first = asyncio.ensure_future(kept.answer_once("k", "/x", "x", fail, logs_key=True))
        second = asyncio.ensure_future(kept.answer_once("k", "/x", "y", work, logs_key=True))
        await asyncio.sleep(0)
        go.set()
        with pytest.raises(Refused):
            await first
        assert (await second).body == b"done"
        assert done == [True]

    asyncio.run(body())


def test_what_is_so_already_is_said_and_its_reason_is_noted(raw: httpx.Client) -> None:
    def pause(**why: str) -> tuple[bool, bool]:
        told = raw.post("/control/pause", json={"target": "sealer", "by": "ada", **why}).json()
        return told["already"], told["noted"]

    assert pause(why="lunch") == (False, False)
    assert pause(why="still lunch") == (True, True)
    assert pause() == (True, False)
    raw.post("/control/resume", json={"target": "sealer", "by": "ada"})


AT = 4 * 10**18
HOUR = 3600 * 10**9
AFTERWARDS: tuple[tuple[str, dict[str, Any], int], ...] = (
    ("/bookings", {"target": "hidex", "begins_at": AT, "ends_at": AT + HOUR, "by": "ada", "why": "x"}, 201),
    ("/bookings/B1/change", {"begins_at": AT + HOUR, "by": "ada"}, 200),
    ("/bookings/B1/cancel", {"by": "ada"}, 200),
    ("/stations/load", LOAD, 201),
    ("/stations/unload", {"station": "hidex.default", "by": "ada"}, 200),
    ("/stations/place", {"station": "sealer.default", "labware": "plate96", "by": "ada"}, 201),
    ("/stations/unload", {"station": "sealer.default", "by": "bo"}, 200),
    ("/control/pause", {"target": "sealer", "by": "ada", "why": "lunch"}, 200),
    ("/control/resume", {"target": "sealer", "by": "ada"}, 200),
    ("/modules/sealer/out-of-service", {"why": "broken", "by": "ada"}, 200),
    ("/modules/sealer/in-service", {"by": "ada"}, 200),
    ("/experiments/E1/notes", {"kind": "decision", "name": "n", "facts": {"x": 1}}, 201),
    ("/experiments/E1/end", {}, 200),
    ("/shares", {"text": "labos: 1\nusers: {ada: {weight: 2}}\n", "by": "ada"}, 200),
    ("/policy", {"text": "labos: 1\nprograms: false\n", "by": "ada"}, 200),
)
"""Requests that are refused, or would do something else, once what they ask for was done."""


def ask_all(url: str) -> list[httpx.Response]:
    with httpx.Client(base_url=url + API, timeout=60, headers={"labos-user": "ada"}) as raw:
        return [
            raw.post(path, json=body, headers=make_key_header(f"key {number}"))
            for number, (path, body, _) in enumerate(AFTERWARDS)
        ]


def test_a_repetition_has_the_first_answer_after_a_restart_too(tmp_path: Path) -> None:
    cell = load_workcell(find_spec("workcells", "rpl"), descriptions())
    settings = Settings.make(tmp_path / "lab", speed=5000.0, simulate=True)
    with LabThread(settings, [cell], nodes="none") as lab, LabClient(lab.url) as client:
        assert client.start_experiment("e", "ada") == "E1"
        first = ask_all(lab.url)
        wanted = [status for _, _, status in AFTERWARDS]
        assert [found.status_code for found in first] == wanted, [found.text for found in first]
        assert [found.content for found in ask_all(lab.url)] == [found.content for found in first]
        position = client.health()["position"]
    with LabThread(settings, nodes="none") as lab, LabClient(lab.url) as client:
        again = ask_all(lab.url)
        for (path, _, _), one, other in zip(AFTERWARDS, first, again, strict=True):
            assert (one.status_code, one.content) == (other.status_code, other.content), path
        asked_for = [event["type"] for event in client.events(after=position)]
        assert not {kind for kind in asked_for if not kind.startswith(("kernel.", "node."))}, asked_for


def test_an_emergency_stop_has_its_first_answer_after_a_restart_too(tmp_path: Path) -> None:
    cell = load_workcell(find_spec("workcells", "rpl"), descriptions())
    settings = Settings.make(tmp_path / "lab", speed=5000.0, simulate=True)

    def stop(url: str, key: str = "stop", target: str = "sealer") -> httpx.Response:
        with httpx.Client(base_url=url + API, timeout=60) as raw:
            return raw.post("/estop", json={"target": target, "by": "ada"}, headers=make_key_header(key))

    def reports(client: LabClient) -> list[dict[str, Any]]:
        return list(client.events(type="lab.stop_reported"))

    with LabThread(settings, [cell], nodes="none") as lab:
        first = stop(lab.url)
        assert (first.status_code, first.json()["stopped"]) == (200, {})
        assert first.json()["silent"] == {"rpl/sealer": "no node answers for it"}
        assert stop(lab.url).content == first.content
        with LabClient(lab.url) as client:
            until(lambda: reports(client), "the log is told afterwards")
            (told,) = reports(client)
            assert (told["actor"], told["payload"]["target"]) == ("ada", "sealer")
    with LabThread(settings, nodes="none") as lab, LabClient(lab.url) as client:
        again = stop(lab.url)
        assert (again.status_code, again.content) == (200, first.content)
        assert len(reports(client)) == 1
        other = stop(lab.url, target="peeler")
        assert (other.status_code, other.json()["code"]) == (409, "key_reused")
        assert stop(lab.url, "another").status_code == 200
        until(lambda: len(reports(client)) == 2, "the log is told afterwards")


def test_another_request_with_a_key_is_refused_after_a_restart_too(tmp_path: Path) -> None:
    cell = load_workcell(find_spec("workcells", "rpl"), descriptions())
    settings = Settings.make(tmp_path / "lab", speed=5000.0, simulate=True)
    path, body, _ = AFTERWARDS[0]

    def send(url: str, **more: Any) -> httpx.Response:
        with httpx.Client(base_url=url + API, timeout=30) as raw:
            return raw.post(path, json=body | more, headers=make_key_header("mine"))

    with LabThread(settings, [cell], nodes="none") as lab:
        assert send(lab.url).status_code == 201
    with LabThread(settings, nodes="none") as lab:
        for more in (
            {"ends_at": AT + 2 * HOUR},
            {"by": "bo"},
            {"begins_at": AT + HOUR, "ends_at": AT + 2 * HOUR},
        ):
            answer = send(lab.url, **more)
            assert (answer.status_code, answer.json()["code"]) == (409, "key_reused"), answer.text
        assert send(lab.url).status_code == 201

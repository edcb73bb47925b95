"""The HTTP interface and the client, on a lab in this process without nodes."""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest

from labos.bootstrap import LabThread, descriptions
from labos.client import Experiment, LabClient, LabUnreachable, RunFailed
from labos.client._lab import API
from labos.errors import BadInput, NotFound, Refused
from labos.http import service
from labos.settings import Settings, find_kernel, free_port
from labos.spec import find_spec, load_workcell
from tests.support.lab_process import until

PROBLEM = {"type", "title", "status", "detail", "code", "remedy", "details"}


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Iterator[LabThread]:
    cell = load_workcell(find_spec("workcells", "rpl"), descriptions())
    settings = Settings.make(tmp_path_factory.mktemp("lab"), speed=5000.0, simulate=True)
    with LabThread(settings, [cell], nodes="none") as running:
        yield running


@pytest.fixture
def client(lab: LabThread) -> Iterator[LabClient]:
    with LabClient(lab.url) as found:
        yield found


@pytest.fixture
def raw(lab: LabThread) -> Iterator[httpx.Client]:
    with httpx.Client(base_url=lab.url + API) as found:
        yield found


def count(client: LabClient, kind: str) -> int:
    return sum(event["type"] == kind for event in client.events())


def test_one_key_is_one_run(client: LabClient) -> None:
    before = count(client, "run.submitted")
    runs = {client.submit("pcr", user="ada", request="the-key") for _ in range(3)}
    assert len(runs) == 1
    assert count(client, "run.submitted") == before + 1
    # Also when the requests cross.
    found: list[str] = []
    threads = [
        threading.Thread(target=lambda: found.append(client.submit("pcr", user="ada", request="crossing")))
        for _ in range(5)
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(found) == 5
    assert len(set(found)) == 1
    assert count(client, "run.submitted") == before + 2


def test_one_key_for_two_things_is_a_conflict(raw: httpx.Client) -> None:
    key = {"idempotency-key": "one"}
    body = {"name": "colours", "user": "ada"}
    first = raw.post("/experiments", json=body, headers=key)
    assert (first.status_code, raw.post("/experiments", json=body, headers=key).json()) == (201, first.json())
    other = raw.post("/experiments", json={**body, "name": "shapes"}, headers=key)
    assert other.status_code == 409
    assert first.json()["experiment"] in other.json()["detail"]
    raw.post(f"/experiments/{first.json()['experiment']}/end", json={})


def test_a_run_pins_what_it_was_made_of(client: LabClient) -> None:
    run = client.submit("pcr", user="ada")
    (submitted,) = client.events(stream=run, type="run.submitted")
    assert {"workflow", "workcell"} <= submitted["payload"]["pins"].keys()
    (plan,) = client.events(type="plan.recorded", mentions=submitted["payload"]["plan"])
    assert "protocols/pcr_prep.yaml" in plan["payload"]["files"]


def test_runs_are_paused_resumed_and_cancelled(client: LabClient) -> None:
    run = client.submit("pcr", user="ada")
    client.pause(run, "ada")
    assert client.status(run).status == "paused"
    client.resume(run, "ada")
    assert client.status(run).status == "queued"
    client.cancel(run, "ada", why="wrong plate")
    assert client.wait(run, timeout_s=5).status == "cancelled"
    assert client.status(run).why == "wrong plate"
    with pytest.raises(Refused, match="has not ended"):
        client.cancel(run, "ada")
    with pytest.raises(NotFound):
        client.pause("R999", "ada")


def test_a_wait_is_explained(client: LabClient) -> None:
    run = client.submit("pcr", user="ada")
    shown = next(r for r in client.state()["runs"] if r["id"] == run)
    assert shown["waits"][0]["why"].startswith("sciclops is GONE")
    assert (shown["steps"], shown["done"]) == (14, 0)


def test_errors_have_one_shape(raw: httpx.Client, client: LabClient) -> None:
    for method, path, body, status in (
        ("GET", "/runs/R999", None, 404),
        ("GET", "/nowhere", None, 404),
        ("GET", "/events?after=x", None, 400),
        ("POST", "/runs", {"user": "ada"}, 400),
        ("POST", "/runs", {"user": " ", "workflow": {"text": "x"}}, 400),
        ("POST", "/runs", {"user": "ada", "workflow": {"text": "a: [", "name": "w.yaml"}}, 422),
        ("POST", "/runs", {"user": "ada", "workcell": "no", "workflow": {"text": "a: 1"}}, 404),
        ("POST", "/interventions/I9", {"choice": "done", "by": "ada"}, 409),
        ("POST", "/modules/nobody/in-service", {}, 404),
        ("POST", "/modules/sealer/out-of-service", {"why": " ", "by": "ada"}, 400),
        ("POST", "/modules/sealer/out-of-service", {"why": "x", "by": "ada", "until": 7}, 409),
        ("POST", "/estop", {"target": "nobody"}, 404),
        ("POST", "/runs/R1/dance", {}, 404),
        ("POST", "/experiments/E99/notes", {"kind": "decision", "name": "x"}, 409),
        ("POST", "/stations/place", {"station": "wc.nowhere", "labware": "x", "by": "ada"}, 404),
    ):
        answer = raw.request(method, path, json=body) if body is not None else raw.request(method, path)
        assert answer.status_code == status, (path, answer.text)
        assert set(answer.json()) == PROBLEM, path
        assert answer.headers["content-type"] == "application/problem+json", path
        assert answer.json()["status"] == status, path
    details = raw.post("/runs", json={"user": "ada", "workflow": {"text": "a: [", "name": "w.yaml"}}).json()
    assert details["code"] in ("spec_error", "spec_errors")
    assert details["details"][0]["file"] == "w.yaml"
    assert details["details"][0]["line"] == 1


def test_a_refused_submission_leaves_no_event(client: LabClient) -> None:
    before = client.health()["position"]
    with pytest.raises(BadInput, match=r"pcr_demo_wf\.yaml:\d+:\d+"):
        client.submit(Path(__file__).parents[1] / "unit" / "spec" / "paper" / "pcr_demo_wf.yaml", user="ada")
    assert client.health()["position"] == before


def test_events_are_followed(raw: httpx.Client, client: LabClient) -> None:
    after = client.health()["position"]
    with raw.stream("GET", "/events/stream", params={"after": after, "type": "run"}) as stream:
        lines = stream.iter_lines()
        run = client.submit("pcr", user="ada")
        data = next(line for line in lines if line.startswith("data: "))
        event = json.loads(data.removeprefix("data: "))
        assert (event["type"], event["stream"]) == ("run.submitted", run)
    paged = list(client.events(after, type="run", stream=run))
    assert [event["position"] for event in paged] == [event["position"]]


def test_placed_labware_is_there_and_on_the_bench(client: LabClient, lab: LabThread) -> None:
    name = client.place("hidex.default", "plate96", "ada")
    (item,) = (i for i in client.state()["labware"] if i["id"] == name)
    assert item["station"] == "hidex.default"
    assert len(lab.runtime.world("rpl").at("hidex.default")) == 1
    with pytest.raises(Refused, match="holds"):
        client.place("hidex.default", "plate96", "ada")
    assert len(lab.runtime.world("rpl").at("hidex.default")) == 1


def test_a_module_is_taken_out_and_comes_back_by_itself(client: LabClient) -> None:
    after = client.health()["position"]

    def hidex() -> dict[str, Any]:
        return next(m for m in client.state(waits=False)["modules"] if m["name"] == "rpl/hidex")

    client.take_out("rpl/hidex", "smoke", "ada", time.time_ns() + 300_000_000)
    until(lambda: not hidex()["out_of_service"], "it is back")
    client.take_out("hidex", "the lamp is changed", "ada", time.time_ns() + 3_600_000_000_000)
    seen = hidex()
    assert (seen["out_of_service"], seen["problem"]) == (True, "the lamp is changed")
    client.put_back("hidex", "bo")
    told = [(e["type"], e["actor"]) for e in client.events(after, stream="rpl/hidex")]
    assert told == [
        ("module.taken_out", "ada"),
        ("module.put_back", "labos"),
        ("module.taken_out", "ada"),
        ("module.put_back", "bo"),
    ]


def test_a_stop_without_nodes_says_so(client: LabClient) -> None:
    after = client.health()["position"]
    report = client.emergency_stop("sealer", "ada")
    assert report == {"stopped": {}, "silent": {"rpl/sealer": "no node answers for it"}}
    assert len(client.emergency_stop("*", "ada")["silent"]) == 14
    reported = ["lab.stop_reported"] * 2
    until(lambda: [event["type"] for event in client.events(after)] == reported, "the log is told afterwards")


def test_one_action_is_a_run(client: LabClient) -> None:
    run = client.do("rpl/sealer", "seal", {"time": 3.0}, user="ada")
    assert client.status(run).workflow == "do sealer.seal"
    client.cancel(run, "ada")
    before = client.health()["position"]
    with pytest.raises(BadInput, match=r"do sealer.seal:\d+:\d+: .*'time'"):
        client.do("sealer", "seal", {"time": 1000.0}, user="ada")
    with pytest.raises(BadInput, match="no action 'home'"):
        client.do("sealer", "home", user="ada")
    assert client.health()["position"] == before


def test_an_experiment_is_a_block(client: LabClient) -> None:
    with Experiment(client, "colors", "bo", closing="cp_trashplate") as experiment:
        experiment.note("decision", "next", amounts=[1, 2])
        run = client.submit("cp_newplate", user="bo", experiment=experiment.id)
        client.cancel(run, "bo")
        assert client.wait(run, timeout_s=5).experiment == experiment.id
    assert [e["type"] for e in client.events(stream=experiment.id) if e["type"].startswith("exp")] == [
        "experiment.started",
        "experiment.noted",
        "experiment.ended",
    ]
    client.end_experiment(experiment.id)  # once more changes nothing
    with pytest.raises(Refused):
        client.note(experiment.id, "decision", "too late", {})


def test_a_run_that_does_not_complete_is_raised(client: LabClient) -> None:
    with Experiment(client, "colors", "bo") as experiment:
        canceller = threading.Thread(target=_cancel_next, args=(client, experiment.id))
        canceller.start()
        with pytest.raises(RunFailed, match="cancelled"):
            experiment.run("cp_newplate")
        canceller.join()


def _cancel_next(client: LabClient, experiment: str) -> None:
    def runs() -> list[str]:
        return [r["id"] for r in client.state(waits=False)["runs"] if r["experiment"] == experiment]

    client.cancel(until(runs, "the run is submitted")[0], "bo")


def test_a_silent_application_is_asked_about(client: LabClient, monkeypatch: pytest.MonkeyPatch) -> None:
    name = client.start_experiment("colors", "bo")
    monkeypatch.setattr(service, "SILENCE_S", 0.2)

    def list_asked() -> list[str]:
        questions = client.state(waits=False)["interventions"]
        return [q["id"] for q in questions if q["kind"] == "lost_experiment" and name in q["text"]]

    question = until(list_asked, "a person is asked")[0]
    client.resolve(question, "close", by="ada")
    assert "experiment.ended" in [e["type"] for e in client.events(stream=name)]


def test_nobody_there(tmp_path: Path) -> None:
    nowhere = f"http://127.0.0.1:{free_port()}"
    with LabClient(nowhere, patience_s=0.1) as client, pytest.raises(LabUnreachable, match="No lab answers"):
        client.health()
    with (
        LabClient(home=tmp_path, patience_s=0.1) as client,
        pytest.raises(LabUnreachable, match="No lab runs"),
    ):
        client.health()
    assert find_kernel(tmp_path) is None

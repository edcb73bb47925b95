"""What an intruder tries who is a user of the lab, or has a file that one opens: see docs/security.md."""

from __future__ import annotations

import json
import socket
import zipfile
from base64 import b64encode
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest

from labos.bootstrap import LabThread
from labos.cli.files import _fetch
from labos.core.binding import bind
from labos.core.decide.users import AddUser, GrantRole
from labos.core.waits import Wait
from labos.errors import LabosError
from labos.services.files import ResultFile
from labos.services.trust.proof import Trust, prove_bundle
from labos.store import FolderBlobs, move_old_segments, read_backup
from tests.integration.http.signed import client_of, execute, lab_with_users, token_of

FLOW = "labos: 1\nname: f\nsteps:\n  - {name: seal, module: sealer, action: seal}\n"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("attacks")


@pytest.fixture(scope="module")
def lab(folder: Path) -> Iterator[LabThread]:
    with lab_with_users(folder) as running:
        execute(running, AddUser("eve", "person"), "ada")
        execute(running, GrantRole("user:eve", "submitter"), "ada")
        yield running


@pytest.fixture(scope="module")
def bob(lab: LabThread, folder: Path) -> Iterator[httpx.Client]:
    with client_of(lab, token_of(folder, "bob")) as client:
        yield client


@pytest.fixture(scope="module")
def eve(lab: LabThread, folder: Path) -> Iterator[httpx.Client]:
    with client_of(lab, token_of(folder, "eve")) as client:
        yield client


def check_refused(answer: httpx.Response) -> dict[str, Any]:
    assert 400 <= answer.status_code < 500, answer.text
    told: dict[str, Any] = answer.json()
    return told


# -- files of the server ----------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["/etc/passwd", "../../secret.yaml", "~/secret.yaml", "file:///etc/passwd"])
def test_a_workflow_uses_no_file_of_the_server(eve: httpx.Client, folder: Path, name: str) -> None:
    (folder / "secret.yaml").write_text(FLOW.replace("name: seal", "name: hunter2"))
    text = f"labos: 1\nname: f\nsteps:\n  - {{name: x, use: '{name}'}}\n"
    told = check_refused(eve.post("/runs", json={"workflow": {"text": text, "name": str(folder / "f.yaml")}}))
    assert "root:" not in json.dumps(told)
    assert "hunter2" not in json.dumps(told)


@pytest.mark.parametrize("name", ["/etc/passwd", "../../secret.csv"])
def test_a_campaign_reads_no_table_of_the_server(eve: httpx.Client, name: str) -> None:
    text = f"labos: 1\ncampaign: c\nworkflow: f\nrows: {{table: '{name}'}}\n"
    told = check_refused(eve.post("/campaigns", json={"text": text, "workflow": {"text": FLOW}}))
    assert "root:" not in json.dumps(told)


@pytest.mark.parametrize(
    "digest", ["..", "..%2f..%2flabos.db", "%2e%2e%2flabos.db", "labos.key", "%00", "a" * 63, "A" * 64]
)
def test_a_file_is_found_by_its_digest_alone(eve: httpx.Client, digest: str) -> None:
    answer = eve.get(f"/files/{digest}")
    assert answer.status_code in (400, 404), answer.text
    assert b"SQLite" not in answer.content


# -- what is somebody else's ------------------------------------------------------------------------


def test_ids_of_others_open_nothing(lab: LabThread, bob: httpx.Client, eve: httpx.Client) -> None:
    run = bob.post("/runs", json={"workflow": {"text": FLOW}}).json()["run"]
    experiment = bob.post("/experiments", json={"name": "e"}).json()["experiment"]
    rows = "labos: 1\ncampaign: c\nworkflow: f\nrows: {list: [{}]}\n"
    campaign = bob.post("/campaigns", json={"text": rows, "workflow": {"text": FLOW}}).json()["campaign"]
    booked = {"target": "hidex", "begins_at": 0, "ends_at": 0}
    now = lab.runtime.kernel.clock.now_ns()
    booked |= {"begins_at": now + 3600 * 10**9, "ends_at": now + 7200 * 10**9}
    booking = bob.post("/bookings", json=booked).json()["id"]
    tries: tuple[tuple[str, dict[str, Any]], ...] = (
        (f"/runs/{run}/cancel", {}),
        (f"/runs/{run}/pause", {}),
        (f"/runs/{run}/resume", {}),
        ("/control/cancel", {"target": run}),
        ("/control/cancel", {"target": experiment}),
        (f"/experiments/{experiment}/notes", {"kind": "decision", "name": "mine"}),
        (f"/experiments/{experiment}/heartbeat", {}),
        (f"/experiments/{experiment}/end", {}),
        (f"/campaigns/{campaign}/amend", {"priority": 5}),
        (f"/campaigns/{campaign}/cancel", {}),
        (f"/bookings/{booking}/cancel", {}),
        (f"/bookings/{booking}/change", {"whom": "eve"}),
        ("/runs", {"workflow": {"text": FLOW}, "experiment": experiment}),
        ("/runs/batch", {"workflow": {"text": FLOW}, "experiment": experiment, "payloads": [{}]}),
    )
    before = lab.runtime.kernel.state.position
    for path, body in tries:
        check_refused(eve.post(path, json=body))
        check_refused(eve.post(path, json=body | {"by": "bob"} if "workflow" not in body else body))
    # Bob's own run goes on meanwhile; only the lab itself writes about it.
    written = bob.get("/events", params={"after": before}).json()["events"]
    assert {event["actor"] for event in written} <= {"labos"}, "what is refused leaves no event"
    for path in (f"/runs/{run}/cancel", f"/campaigns/{campaign}/cancel", f"/bookings/{booking}/cancel"):
        assert bob.post(path, json={}).status_code == 200


def test_a_plate_of_somebody_else_is_not_used_by_another_name(
    lab: LabThread, bob: httpx.Client, eve: httpx.Client, folder: Path
) -> None:
    """Not by a value of the payload, by a workflow that is used, nor by its id or barcode."""
    with client_of(lab, token_of(folder, "ada", scope="admin")) as ada:
        placed = ada.post("/stations/load", json={"station": "hidex.default", "labware": "plate96"})
        assert placed.is_success, placed.text
        plate = next(i["id"] for i in ada.get("/state").json()["labware"] if i["station"] == "hidex.default")
        assert ada.post(f"/labware/{plate}/barcode", json={"barcode": "of bob"}).is_success
        assert ada.post(f"/labware/{plate}/owner", json={"to": "user:bob"}).is_success
    for name in (plate, "of%20bob"):
        for path, body in (
            (f"/labware/{name}/owner", {"to": "user:eve"}),
            (f"/labware/{name}/owner", {"to": "user:eve", "force": True, "note": "mine"}),
            (f"/labware/{name}/barcode", {"barcode": "of eve"}),
            ("/samples", {"text": f"plate,well,sample\n{plate},A1,x\n"}),
        ):
            check_refused(eve.post(path, json=body))
    carry = "args: {source: payload.from, target: camera_module.plate_station}"
    inner = f"labos: 1\nname: inner\nsteps:\n  - {{name: take, module: pf400, action: transfer, {carry}}}\n"
    outer = "labos: 1\nname: outer\nsteps:\n  - {name: inside, use: inner.yaml}\n"
    encoded = b64encode(inner.encode()).decode()
    asked = {
        "workflow": {"text": outer, "name": "outer.yaml", "files": {"inner.yaml": encoded}},
        "payload": {"from": "hidex.default"},
    }
    told = eve.post("/runs", json=asked)
    assert told.status_code == 201, told.text
    run = told.json()["run"]
    state = lab.runtime.kernel.state
    plan = state.runs.plan_of(state.runs.queued[run])
    (taken,) = (step for step in plan.steps if step.key == "inside/take")
    found = bind(state, state.runs.queued[run], taken)
    assert isinstance(found, Wait)
    assert found.code == "not_yours"
    owners = {item.id: item.owner for item in state.bench.labware.values()}
    his = bob.post("/runs", json=asked).json()["run"]
    assert not isinstance(bind(state, state.runs.queued[his], taken), Wait), "bob's own run may take it"
    bob.post(f"/runs/{his}/cancel", json={})
    assert owners[plate] == "user:bob"
    assert {i["id"]: i["owner"] for i in bob.get("/state").json()["labware"]}[plate] == "user:bob"
    eve.post(f"/runs/{run}/cancel", json={})


def test_a_key_of_somebody_else_tells_nothing(bob: httpx.Client, eve: httpx.Client) -> None:
    headers = {"idempotency-key": "of bob"}
    body = {"workflow": {"text": FLOW}}
    mine = bob.post("/runs", json=body, headers=headers).json()["run"]
    told = eve.post("/runs", json=body, headers=headers)
    assert told.status_code == 409 or told.json()["run"] != mine
    bob.post(f"/runs/{mine}/cancel", json={})


# -- headers ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "host",
    [
        "127.0.0.1.evil.example",
        "localhost.evil.example",
        "localhost@evil.example",
        "evil.example#localhost",
        "127.0.0.1,evil.example",
        "0x7f000001",
        "2130706433",
        "[::1].evil.example:80@x",
    ],
)
def test_no_other_host_is_taken_for_the_labs(lab: LabThread, eve: httpx.Client, host: str) -> None:
    answer = eve.get("/state", headers={"host": host})
    if not host.startswith("["):
        assert check_refused(answer)["code"] in ("forbidden", "bad_input")
    origin = eve.post("/control/pause", json={"target": "lab"}, headers={"origin": f"http://{host}"})
    assert check_refused(origin)["code"] == "forbidden"


@pytest.mark.parametrize(
    "line",
    [
        b"idempotency-key: a\r\n b: c",
        b"idempotency-key: a\x00b",
        b"labos-user: ada\rset-cookie: x=y",
        b"labos-on-behalf-of: ada\nx: y",
        b"labos-position: 1\x0b",
    ],
)
def test_a_header_brings_no_other_one_along(lab: LabThread, line: bytes) -> None:
    host, _, port = lab.url.removeprefix("http://").partition(":")
    with socket.create_connection((host, int(port)), timeout=20) as raw:
        raw.sendall(b"GET /api/v1/state HTTP/1.1\r\nhost: localhost\r\n" + line + b"\r\n\r\n")
        answer = raw.recv(65536)
    assert answer.split(b" ")[1] in (b"400", b"401"), answer
    assert b"set-cookie" not in answer.lower()


def test_a_file_of_a_device_is_no_page_of_the_server(lab: LabThread, eve: httpx.Client) -> None:
    page = b"<script>alert(1)</script>"
    name = lab.runtime.blobs.put(page)
    answer = eve.get(f"/files/{name}")
    assert (answer.content, answer.headers["content-type"]) == (page, "application/octet-stream")
    assert answer.headers["x-content-type-options"] == "nosniff"


# -- names that lead out of a folder ----------------------------------------------------------------


@pytest.mark.parametrize(
    "name",
    [
        "../evil",
        "../../etc/evil",
        "/etc/evil",
        "..",
        ".",
        "a/..",
        "..\\..\\evil",
        "C:\\evil",
        "a\x00b",
        "a\nb",
        "",
    ],
)
@pytest.mark.parametrize("step", ["s", "../s"])
def test_a_file_that_is_fetched_stays_in_its_folder(tmp_path: Path, name: str, step: str) -> None:
    blobs = FolderBlobs(tmp_path / "blobs")
    inner = tmp_path / "out" / "inner"
    inner.mkdir(parents=True)
    found = [
        ResultFile(run="R1", step=step, file=name, sha256=blobs.put(data), bytes=len(data), time=0)
        for data in (b"one", b"two")
    ]
    for written in _fetch(blobs, found, str(inner), one=False):
        assert Path(written).resolve().parent == inner
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["inner"]
    assert sorted(path.read_bytes() for path in inner.iterdir()) == [b"one", b"two"]


def test_a_bundle_unpacks_nothing_beside_itself(tmp_path: Path) -> None:
    for name in ("../evil", "/tmp/evil-of-labos", "blobs/../../evil", "..\\evil"):
        bundle = tmp_path / "in" / "run.zip"
        bundle.parent.mkdir(exist_ok=True)
        with zipfile.ZipFile(bundle, "w") as archive:
            archive.writestr(name, b"evil")
        with pytest.raises(LabosError):
            prove_bundle(bundle, Trust(()))
        assert [path.name for path in tmp_path.iterdir()] == ["in"]
        assert [path.name for path in bundle.parent.iterdir()] == ["run.zip"]


@pytest.mark.parametrize(
    "name", ["../labos.db", "/etc/passwd", "..", "a/b.jsonl.gz", ".hidden", "a\x00b", ""]
)
def test_a_manifest_names_no_file_elsewhere(tmp_path: Path, name: str) -> None:
    """Else the segments of a backup that somebody has changed could move any file, or read it."""
    backup = tmp_path / "backup"
    backup.mkdir()
    (tmp_path / "labos.db").write_bytes(b"a database")
    segment: dict[str, Any] = dict.fromkeys(
        ("lab", "before", "hash", "state", "fold", "file", "sha256", "seal"), ""
    ) | {"first": 1, "last": 2, "recorded_at": 1, "file": name}
    manifest = {"format": 1, "lab": "x", "epoch": 1, "segments": [segment, segment | {"file": "b.jsonl.gz"}]}
    (backup / "backup.json").write_text(json.dumps(manifest))
    with pytest.raises(LabosError):
        read_backup(backup)
    with pytest.raises(LabosError):
        move_old_segments(backup, tmp_path / "archive", 10)
    assert (tmp_path / "labos.db").read_bytes() == b"a database"

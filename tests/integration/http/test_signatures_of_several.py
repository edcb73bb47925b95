"""Signatures under whole experiments and campaigns, and the bundles that carry them."""

from __future__ import annotations

import io
import json
import time
import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path

import msgspec
import pytest

from labos.bootstrap import LabThread
from labos.cli.app import main
from labos.client import LabClient
from labos.core.runs import RUN_ENDS
from labos.core.signatures import RecordsSigned
from labos.errors import Forbidden, NotFound, Refused
from labos.services.accounts.tries import Tries
from labos.services.signatures import check_signatures
from labos.settings import TOKEN, URL
from labos.store import open_store
from tests.integration.http.signed import PASSWORDS, lab_with_users, token_of
from tests.integration.trust.conftest import chain_anew
from tests.unit.services.logbook import save

SEAL = "labos: 1\nname: seal\nsteps:\n  - {name: seal it, module: sealer, action: seal}\n"
CAMPAIGN = "labos: 1\ncampaign: three\nworkflow: seal.yaml\nrows: {list: [{}, {}, {}]}\n"


class Signed:
    """A lab that has ended, with an experiment of two runs and a campaign of three, both signed, and a run
    that belongs to nothing. ``ask`` is the command line in its folder."""

    def __init__(self, folder: Path, ask: Callable[..., tuple[int, str]]) -> None:
        self.folder, self.home, self.ask = folder, folder / "lab", ask
        self.public = folder / "lab.pub"

    def bundle(self, name: str) -> Path:
        path = self.folder / f"{name}.zip"
        code, told = self.ask("bundle", name, "-o", str(path))
        assert code == 0, told
        return path

    def verify(self, path: Path) -> tuple[int, str]:
        return self.ask("verify", "--bundle", str(path), "--public-key", str(self.public))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("several")


@pytest.fixture(scope="module")
def lab(folder: Path) -> Iterator[LabThread]:
    with lab_with_users(folder) as running:
        yield running


@pytest.fixture
def bob(lab: LabThread, folder: Path) -> Iterator[LabClient]:
    lab.runtime.gate.accounts._tries = Tries()
    with LabClient(lab.url, token=token_of(folder, "bob", scope="admin")) as client:
        yield client


def run_in(bob: LabClient, experiment: str = "") -> str:
    return bob.submit({"text": SEAL, "name": "seal.yaml"}, user="bob", experiment=experiment)


def end_experiment(bob: LabClient, runs: int) -> str:
    experiment = bob.start_experiment("app", "bob")
    for _ in range(runs):
        bob.cancel(run_in(bob, experiment), "bob")
    bob.end_experiment(experiment)
    until_ended(bob, experiment, "experiment.ended")
    return experiment


def open_campaign(bob: LabClient) -> str:
    told = {"text": CAMPAIGN, "name": "c.yaml", "workflow": {"text": SEAL, "name": "seal.yaml"}}
    return str(bob.submit_campaign(told, user="bob")["campaign"])


def end_campaign(bob: LabClient) -> str:
    campaign = open_campaign(bob)
    bob.cancel_campaign(campaign, "bob")
    until_ended(bob, campaign, "campaign.completed")
    return campaign


def until_ended(bob: LabClient, name: str, kind: str) -> None:
    deadline = time.monotonic() + 60
    for event in bob.events(follow=True, wait_s=1.0):
        if (event["stream"], event["type"]) == (name, kind):
            return
        assert time.monotonic() < deadline


def test_an_experiment_is_signed_with_all_its_runs(bob: LabClient) -> None:
    experiment = end_experiment(bob, 2)
    found = bob.sign_experiment(experiment, "reviewed", PASSWORDS["bob"], why="all of it")
    assert (found["subject"], found["kind"], found["run"]) == (experiment, "experiment", "")
    assert (found["by"], found["meaning"], found["runs"], found["holds"]) == ("bob", "reviewed", 2, True)
    own = [e for e in bob.events() if experiment in (e["stream"], e["correlation"])]
    streams = {experiment} | {e["stream"] for e in own if e["type"] == "run.submitted"}
    assert len(streams) == 3
    assert found["records"] == sum(e["stream"] in streams for e in bob.events())
    assert bob.sign_experiment(experiment, "reviewed", PASSWORDS["bob"], why="all of it") == found
    assert bob.experiment_signatures(experiment) == [found]


def test_a_campaign_is_signed_with_all_its_runs(bob: LabClient) -> None:
    campaign = end_campaign(bob)
    found = bob.sign_campaign(campaign, "approved", PASSWORDS["bob"])
    submitted = [e for e in bob.events(type="run.submitted") if e["payload"].get("campaign") == campaign]
    assert (found["kind"], found["runs"], found["holds"]) == ("campaign", len(submitted), True)
    assert bob.campaign_signatures(campaign) == [found]
    assert bob.campaign_signatures(end_campaign(bob)) == []


def test_what_has_not_ended_or_is_something_else_is_not_signed(lab: LabThread, bob: LabClient) -> None:
    experiment, campaign = bob.start_experiment("app", "bob"), open_campaign(bob)
    run = run_in(bob, experiment)
    with pytest.raises(Refused, match=f"experiment {experiment} has not ended"):
        bob.sign_experiment(experiment, "approved", PASSWORDS["bob"])
    with pytest.raises(Refused, match=f"campaign {campaign} has not ended"):
        bob.sign_campaign(campaign, "approved", PASSWORDS["bob"])
    for sign in (bob.sign_experiment, bob.sign_campaign):
        lab.runtime.gate.accounts._tries = Tries()  # each signature is a try to show who one is
        with pytest.raises(NotFound):
            sign(run, "approved", PASSWORDS["bob"])
        with pytest.raises(NotFound):
            sign("E999", "approved", PASSWORDS["bob"])
    with pytest.raises(NotFound, match=f"no run '{experiment}'"):
        bob.sign_run(experiment, "approved", PASSWORDS["bob"])
    for ask in (bob.experiment_signatures, bob.campaign_signatures, bob.signatures):
        with pytest.raises(NotFound):
            ask("E999")
    bob.cancel(run, "bob")
    bob.end_experiment(experiment)
    until_ended(bob, experiment, "experiment.ended")
    with pytest.raises(Forbidden, match="Nothing was signed"):
        bob.sign_experiment(experiment, "approved", PASSWORDS["ada"])
    assert bob.experiment_signatures(experiment) == []
    bob.cancel_campaign(campaign, "bob")


def test_a_program_does_not_sign(lab: LabThread, folder: Path, bob: LabClient) -> None:
    experiment = end_experiment(bob, 0)
    with LabClient(lab.url, token=token_of(folder, "agent")) as agent, pytest.raises(Forbidden):
        agent.sign_experiment(experiment, "approved", PASSWORDS["bob"])


def test_the_command_knows_what_it_signs(
    lab: LabThread,
    folder: Path,
    bob: LabClient,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    experiment, campaign = end_experiment(bob, 1), end_campaign(bob)
    monkeypatch.setenv(TOKEN, token_of(folder, "bob"))
    monkeypatch.setenv(URL, lab.url)

    def ask(*words: str, given: str = "") -> str:
        monkeypatch.setattr("sys.stdin", io.StringIO(given))
        code = main(["sign", *words])
        told = capsys.readouterr()
        return f"{code} {told.out}{told.err}"

    assert ask(experiment) == f"0 {experiment} has no signatures.\n"
    said = ask(experiment, "--meaning", "reviewed", given=PASSWORDS["bob"] + "\n")
    assert f"bob signed {experiment} with 1 run: reviewed" in said
    assert f"bob signed {experiment} with 1 run: reviewed" in ask(experiment)
    said = ask(campaign, "--meaning", "approved", "--why", "fine", given=PASSWORDS["bob"] + "\n")
    assert "signed C" in said
    assert ": approved: fine" in said
    (found,) = json.loads(ask(campaign, "--json").partition(" ")[2])
    assert (found["subject"], found["kind"]) == (campaign, "campaign")
    assert "There is no run, experiment or campaign 'X1'" in ask("X1")


@pytest.fixture
def signed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Signed:
    monkeypatch.delenv(TOKEN, raising=False)
    with lab_with_users(tmp_path) as lab, LabClient(lab.url, token=token_of(tmp_path, "bob")) as bob:
        assert end_experiment(bob, 2) == "E1"
        assert end_campaign(bob) == "C1"
        bob.sign_experiment("E1", "authored", PASSWORDS["bob"])
        bob.sign_campaign("C1", "reviewed", PASSWORDS["bob"])
        bob.sign_run("R1", "reviewed", PASSWORDS["bob"])
        end_experiment(bob, 1)

    def ask(*words: str) -> tuple[int, str]:
        code = main([*words, "--home", str(tmp_path / "lab")])
        told = capsys.readouterr()
        return code, told.out + told.err

    found = Signed(tmp_path, ask)
    assert ask("key", "create", "--name", "chem.example.org/lab1")[0] == 0
    found.public.write_text(ask("key", "show")[1])
    assert ask("checkpoint")[0] == 0
    return found


def edit(path: Path, change: Callable[[dict[str, bytes]], None]) -> None:
    with zipfile.ZipFile(path) as archive:
        files = {name: archive.read(name) for name in archive.namelist()}
    change(files)
    with zipfile.ZipFile(path, "w") as archive:
        for name, data in files.items():
            archive.writestr(name, data)


def test_a_bundle_of_several_runs_proves_itself(signed: Signed) -> None:
    experiment = signed.bundle("E1")
    code, told = signed.verify(experiment)
    assert code == 0, told
    assert "The bundle proves the experiment E1 of the lab" in told
    assert "events, with those of its 2 runs" in told
    assert "Only a signature of it can show" in told
    assert "bob (authored, " in told
    assert "bob (reviewed of R1, " in told
    code, told = signed.verify(signed.bundle("C1"))
    assert (code, "The bundle proves the campaign C1" in told) == (0, True), told
    code, told = signed.verify(signed.bundle("E2"))
    assert (code, "signed by bob" in told) == (0, False), told
    code, told = signed.verify(signed.bundle("R1"))
    assert (code, "The bundle proves the run R1" in told) == (0, True), told


def test_a_run_taken_out_of_a_bundle_is_missed(signed: Signed) -> None:
    def without(stream: str) -> Callable[[dict[str, bytes]], None]:
        def change(files: dict[str, bytes]) -> None:
            about = json.loads(files["bundle.json"])
            about["runs"] = [run for run in about["runs"] if run != stream]
            files["bundle.json"] = json.dumps(about).encode()
            lines = files["events.jsonl"].splitlines(keepends=True)
            kept = [line for line in lines if json.loads(line)["envelope"]["stream"] != stream]
            assert len(kept) < len(lines)
            files["events.jsonl"] = b"".join(kept)

        return change

    path = signed.bundle("E1")
    edit(path, without("R2"))
    code, told = signed.verify(path)
    assert (code, "signed other records than these" in told) == (1, True), told
    path = signed.bundle("C1")
    with zipfile.ZipFile(path) as archive:
        runs = json.loads(archive.read("bundle.json"))["runs"]
    if runs:
        edit(path, without(runs[0]))
        code, told = signed.verify(path)
        assert (code, f"C1 had {len(runs)} runs, but {len(runs) - 1} are here" in told) == (1, True), told


def test_a_run_of_another_experiment_or_a_moved_signature_does_not_belong(signed: Signed) -> None:
    path = signed.bundle("E1")
    with zipfile.ZipFile(signed.bundle("E2")) as archive:
        foreign = archive.read("events.jsonl")
        others = json.loads(archive.read("bundle.json"))["runs"]

    def add(files: dict[str, bytes]) -> None:
        own = [line for line in foreign.splitlines(keepends=True) if others[0].encode() in line]
        lines = files["events.jsonl"].splitlines(keepends=True) + own
        lines.sort(key=lambda line: json.loads(line)["envelope"]["position"])
        files["events.jsonl"] = b"".join(lines)
        about = json.loads(files["bundle.json"])
        about["runs"] += others
        files["bundle.json"] = json.dumps(about).encode()

    edit(path, add)
    code, told = signed.verify(path)
    assert (code, f"The run {others[0]} does not belong to E1" in told) == (1, True), told

    with zipfile.ZipFile(signed.bundle("E1")) as archive:
        lines = archive.read("events.jsonl").splitlines(keepends=True)
    moved = [line for line in lines if b"records.signed" in line]
    path = signed.bundle("E2")

    def put(files: dict[str, bytes]) -> None:
        found = [*files["events.jsonl"].splitlines(keepends=True), *moved]
        found.sort(key=lambda line: json.loads(line)["envelope"]["position"])
        files["events.jsonl"] = b"".join(found)

    edit(path, put)
    code, told = signed.verify(path)
    assert (code, "records.signed does not belong to E2" in told) == (1, True), told


def test_a_bundle_that_calls_itself_something_else(signed: Signed) -> None:
    path = signed.bundle("E1")

    def change(files: dict[str, bytes]) -> None:
        about = {**json.loads(files["bundle.json"]), "kind": "campaign"}
        files["bundle.json"] = json.dumps(about).encode()

    edit(path, change)
    code, told = signed.verify(path)
    assert (code, "The submission of E1 is missing" in told) == (1, True), told


def test_a_log_written_anew_under_a_signature(signed: Signed) -> None:
    """Another actor of a run's end: the signature under the experiment is not under these records."""
    code, told = signed.ask("verify")
    assert (code, "3 signatures match their records" in told) == (0, True), told
    store = open_store(f"sqlite:///{signed.home / 'labos.db'}", create=False, read_only=True)
    records = list(store.read(0))
    store.close()
    at = next(n for n, r in enumerate(records) if r.head.type in RUN_ENDS and r.head.stream == "R2")
    changed = msgspec.structs.replace(records[at].head, actor="mallory")
    records[at] = msgspec.structs.replace(records[at], head=changed)
    (signed.folder / "anew").mkdir()
    save(chain_anew(records), signed.folder / "anew")
    store = open_store(f"sqlite:///{signed.folder / 'anew' / 'labos.db'}", create=False, read_only=True)
    part = check_signatures(store)
    store.close()
    first = next(r.head.position for r in records if r.head.type == RecordsSigned.TYPE)
    assert part.positions == (first,)
    assert "records of E1, but these records have changed" in part.faults[0]


def test_signatures_are_asked_for_in_sql(signed: Signed) -> None:
    code, told = signed.ask(
        "sql", "SELECT subject, kind, signed_by, meaning, runs FROM signatures ORDER BY position", "--json"
    )
    assert code == 0, told
    rows = [json.loads(line) for line in told.splitlines()]
    named = [tuple(row.values()) for row in rows]
    assert [row[:4] for row in named] == [
        ("E1", "experiment", "bob", "authored"),
        ("C1", "campaign", "bob", "reviewed"),
        ("R1", "run", "bob", "reviewed"),
    ]
    assert [row[4] for row in named][::2] == [2, 0]

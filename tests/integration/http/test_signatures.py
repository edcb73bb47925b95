"""Electronic signatures: who signs shows a password again, and what was signed cannot be exchanged."""

from __future__ import annotations

import io
import json
import zipfile
from collections.abc import Iterator
from pathlib import Path

import msgspec
import pytest

from labos.bootstrap import LabThread, descriptions
from labos.cli.app import main
from labos.client import LabClient
from labos.core.runs import RunSubmitted
from labos.core.signatures import RunSigned
from labos.errors import Forbidden, LabosError, NotFound, Refused
from labos.services.accounts.tries import Tries
from labos.services.signatures import check_signatures
from labos.settings import TOKEN, URL, Settings
from labos.spec import find_spec, load_workcell
from labos.store import open_store
from tests.integration.http.signed import PASSWORDS, lab_with_users, token_of
from tests.integration.trust.conftest import chain_anew
from tests.unit.services.logbook import save


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("signatures")


@pytest.fixture(scope="module")
def lab(folder: Path) -> Iterator[LabThread]:
    with lab_with_users(folder) as running:
        yield running


@pytest.fixture(autouse=True)
def fresh_tries(lab: LabThread) -> None:
    lab.runtime.gate.accounts._tries = Tries()


def client(lab: LabThread, folder: Path, user: str, monkeypatch: pytest.MonkeyPatch) -> LabClient:
    monkeypatch.delenv(TOKEN, raising=False)
    monkeypatch.setenv(TOKEN, token_of(folder, user))
    return LabClient(lab.url)


def end_run(bob: LabClient) -> str:
    run = bob.submit("pcr", user="bob")
    bob.cancel(run, "bob")
    return run


def test_a_signature_names_who_when_and_what_for(
    lab: LabThread, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with client(lab, folder, "bob", monkeypatch) as bob:
        run = end_run(bob)
        authored = bob.sign_run(run, "authored", PASSWORDS["bob"])
        assert (authored["by"], authored["meaning"], authored["holds"]) == ("bob", "authored", True)
        assert bob.sign_run(run, "authored", PASSWORDS["bob"]) == authored, "twice is once"
    with client(lab, folder, "ada", monkeypatch) as ada:
        reviewed = ada.sign_run(run, "reviewed", PASSWORDS["ada"], why="volumes checked")
        assert ada.signatures(run) == [authored, reviewed]
        assert reviewed["digest"] == authored["digest"], "signatures are no part of what is signed"


@pytest.mark.parametrize("password", ["", "wrong", PASSWORDS["ada"]])
def test_nobody_signs_without_their_own_password(
    lab: LabThread, folder: Path, password: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    with client(lab, folder, "bob", monkeypatch) as bob:
        run = end_run(bob)
        with pytest.raises(Forbidden, match="Nothing was signed"):
            bob.sign_run(run, "approved", password)
        assert bob.signatures(run) == []


def test_guessing_is_slowed_down(lab: LabThread, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with client(lab, folder, "bob", monkeypatch) as bob:
        run = end_run(bob)
        refusals = []
        for _ in range(10):
            with pytest.raises(LabosError) as refused:
                bob.sign_run(run, "approved", "a guess")
            refusals.append(str(refused.value))
        assert "Nothing was signed" in refusals[0]
        assert "too many tries" in refusals[-1]
        assert bob.signatures(run) == []


def test_what_cannot_be_signed(lab: LabThread, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with client(lab, folder, "bob", monkeypatch) as bob:
        run = bob.submit("pcr", user="bob")
        with pytest.raises(Refused, match="has not ended"):
            bob.sign_run(run, "approved", PASSWORDS["bob"])
        with pytest.raises(NotFound, match="no run 'R999'"):
            bob.sign_run("R999", "approved", PASSWORDS["bob"])
        with pytest.raises(NotFound):
            bob.signatures("R999")
        with pytest.raises(LabosError, match="meaning"):
            bob.sign_run(run, "fine", PASSWORDS["bob"])
        bob.cancel(run, "bob")
    with client(lab, folder, "agent", monkeypatch) as agent, pytest.raises(Forbidden):
        agent.sign_run(run, "approved", PASSWORDS["bob"])
    monkeypatch.delenv(TOKEN)
    with LabClient(home=folder / "lab") as owner, pytest.raises(LabosError) as refused:
        owner.sign_run(run, "approved", PASSWORDS["ada"])
    assert not isinstance(refused.value, Refused) or "sign" in str(refused.value)


def test_the_command_asks_for_the_password_and_shows_signatures(
    lab: LabThread, folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    with client(lab, folder, "bob", monkeypatch) as bob:
        run = end_run(bob)
    monkeypatch.setenv(URL, lab.url)

    def ask(*words: str, given: str = "") -> tuple[int, str]:
        monkeypatch.setattr("sys.stdin", io.StringIO(given))
        code = main(["sign", *words])
        told = capsys.readouterr()
        return code, told.out + told.err

    assert ask(run) == (0, f"{run} has no signatures.\n")
    code, told = ask(run, "--meaning", "reviewed", "--why", "fine", given=PASSWORDS["bob"] + "\n")
    assert (code, f"bob signed {run}: reviewed: fine" in told) == (0, True), told
    assert f"bob signed {run}: reviewed: fine" in ask(run)[1]
    assert [each["meaning"] for each in json.loads(ask(run, "--json")[1])] == ["reviewed"]
    code, told = ask(run, "--meaning", "reviewed", given="wrong\n")
    assert (code, "Nothing was signed" in told) == (1, True)
    assert "needs a signature" in ask(run, "--why", "a comment")[1]


def test_a_lab_without_users_does_not_know_who_signs(tmp_path: Path) -> None:
    cell = load_workcell(find_spec("workcells", "rpl"), descriptions())
    with (
        LabThread(Settings.make(tmp_path / "open", simulate=True), [cell], nodes="none") as lab,
        LabClient(lab.url) as anybody,
    ):
        run = anybody.submit("pcr", user="ada")
        anybody.cancel(run, "ada")
        with pytest.raises(Refused, match="no users"):
            anybody.sign_run(run, "approved", "anything at all")


def test_a_bundle_carries_signatures_and_the_log_is_checked_against_them(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    home = tmp_path / "lab"
    with lab_with_users(tmp_path) as lab, client(lab, tmp_path, "bob", monkeypatch) as bob:
        first, second = end_run(bob), end_run(bob)
        bob.sign_run(first, "authored", PASSWORDS["bob"])
    monkeypatch.delenv(TOKEN)

    def ask(*words: str) -> tuple[int, str]:
        code = main([*words, "--home", str(home)])
        told = capsys.readouterr()
        return code, told.out + told.err

    assert ask("key", "create", "--name", "chem.example.org/lab1")[0] == 0
    public = tmp_path / "lab.pub"
    public.write_text(ask("key", "show")[1])
    assert ask("checkpoint")[0] == 0
    bundles = {}
    for run in (first, second):
        bundles[run] = tmp_path / f"{run}.zip"
        assert ask("bundle", run, "-o", str(bundles[run]))[0] == 0
    code, told = ask("verify", "--bundle", str(bundles[first]), "--public-key", str(public))
    assert (code, f"{first} is signed by bob (authored, " in told) == (0, True), told
    code, told = ask("verify", "--bundle", str(bundles[second]), "--public-key", str(public))
    assert (code, "is signed by bob" in told) == (0, False)

    # The signature of one run put under the other.
    with zipfile.ZipFile(bundles[first]) as archive:
        moved = [line for line in archive.read("events.jsonl").splitlines() if b"run.signed" in line]
    with zipfile.ZipFile(bundles[second]) as archive:
        files = {name: archive.read(name) for name in archive.namelist()}
    files["events.jsonl"] += moved[0] + b"\n"
    with zipfile.ZipFile(bundles[second], "w") as archive:
        for name, data in files.items():
            archive.writestr(name, data)
    code, told = ask("verify", "--bundle", str(bundles[second]), "--public-key", str(public))
    assert (code, f"run.signed does not belong to {second}" in told) == (1, True), told

    # A log that somebody has written anew, with a chain that is right in itself.
    code, told = ask("verify")
    assert (code, "1 signatures match their records" in told) == (0, True), told
    store = open_store(f"sqlite:///{home / 'labos.db'}", create=False, read_only=True)
    records = list(store.read(0))
    store.close()
    at = next(
        n
        for n, record in enumerate(records)
        if record.head.type == RunSubmitted.TYPE and record.head.stream == first
    )
    changed = msgspec.structs.replace(records[at].head, actor="mallory")
    records[at] = msgspec.structs.replace(records[at], head=changed)
    (tmp_path / "anew").mkdir()
    save(chain_anew(records), tmp_path / "anew")
    store = open_store(f"sqlite:///{tmp_path / 'anew' / 'labos.db'}", create=False, read_only=True)
    part = check_signatures(store)
    store.close()
    assert part.positions == tuple(r.head.position for r in records if r.head.type == RunSigned.TYPE)
    assert "these records have changed" in part.faults[0]


def test_passwords_are_nowhere(lab: LabThread, folder: Path) -> None:
    """After all that: neither in the database, nor in a log of the processes."""
    for path in (folder / "lab").rglob("*"):
        if path.is_file():
            data = path.read_bytes()
            assert not any(password.encode() in data for password in PASSWORDS.values()), path

"""What people write stands beside the log: it is shown everywhere, can be erased, and the log stays whole."""

from __future__ import annotations

import json
import shutil
import time
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import httpx
import pytest
from click.testing import CliRunner

from labos.bootstrap import LabThread, descriptions
from labos.cli.app import group
from labos.client import LabClient
from labos.core.words import ERASED, list_references
from labos.errors import NotFound, Refused
from labos.runtime.ledger import load
from labos.settings import Settings, find_kernel, free_port
from labos.spec import parse_workcell
from labos.store import SqlEventStore, find_first_damage, open_store
from tests.support.api_process import ApiProcess

CELL = """
labos: 1
name: corner
modules:
  - name: press
    about:
      stations: {nest: {}}
      actions:
        squeeze: {effects: [{needs: {}}], duration: 2}
"""
FLOW = "labos: 1\nname: Squeeze\nsteps:\n  - {name: once, module: press, action: squeeze}\n"
SECRET = "Zoë Quux has a cold"


pytestmark = pytest.mark.slow


@contextmanager
def a_lab(tmp_path: Path) -> Iterator[LabClient]:
    """The lab in the folder `lab`, without nodes."""
    settings = Settings.make(tmp_path / "lab", speed=1000.0, simulate=True)
    cells = [parse_workcell(CELL, descriptions())]
    with LabThread(settings, cells, nodes="none") as lab, LabClient(lab.url) as client:
        yield client


def database(tmp_path: Path) -> SqlEventStore:
    return open_store(f"sqlite:///{tmp_path / 'lab' / 'labos.db'}", create=False, read_only=True)


def bytes_of(folder: Path) -> bytes:
    return b"".join(file.read_bytes() for file in folder.rglob("*") if file.is_file())


def events(client: LabClient, kind: str, **more: Any) -> list[dict[str, Any]]:
    return list(client.events(type=[kind], **more))


def test_words_are_shown_and_stand_in_no_event(tmp_path: Path) -> None:
    with a_lab(tmp_path) as client:
        client.control("pause", "lab", "bo", why=SECRET)
        (paused,) = events(client, "starts.paused")
        assert paused["payload"]["why"] == SECRET
        (stored,) = events(client, "starts.paused", stored=True)
        assert list_references(json.dumps(stored["payload"]).encode()) == [stored["payload"]["why"]]
        client.take_out("press", SECRET, "bo")
        assert SECRET in json.dumps(client.state(), ensure_ascii=False)
        store = database(tmp_path)
        assert not any(SECRET.encode() in record.payload for record in store.read())
        store.close()


def test_what_is_erased_is_gone_from_the_files_and_the_log_is_whole(tmp_path: Path) -> None:
    home = tmp_path / "lab"
    with a_lab(tmp_path) as client:
        client.control("pause", "lab", "bo", why=SECRET)
        client.take_out("press", f"{SECRET} and so", "bo")
        store = database(tmp_path)
        before, _ = load(store, snapshots=False)
        assert SECRET.encode() in bytes_of(home)
        (paused,) = events(client, "starts.paused")
        done = client.erase_words("personal", "ada", records=[paused["position"]])
        assert (done["erased"], done["records"], done["left"]) == (1, [paused["position"]], "")
        assert f"{SECRET} and so".encode() in bytes_of(home)
        done = client.erase_words("request", "ada", user="bo")
        assert (done["erased"], done["left"]) == (1, "")
        assert SECRET.encode() not in bytes_of(home)
        assert events(client, "starts.paused")[0]["payload"]["why"] == ERASED
        assert ERASED in json.dumps(client.state())
        gone = events(client, "words.erased")
        assert [(e["payload"]["because"], e["payload"]["by"]) for e in gone] == [
            ("personal", "ada"),
            ("request", "ada"),
        ]
        assert find_first_damage(store) is None
        again, _ = load(store, snapshots=False, end=None)
        assert again.position > before.position
        store.close()
    assert SECRET.encode() not in bytes_of(home)


def say(*words: str) -> str:
    """What a command of ``labos`` prints. It must succeed."""
    told = CliRunner().invoke(group, list(words), catch_exceptions=False)
    assert told.exit_code == 0, told.output
    return told.output


def test_bundles_checkpoints_and_verify_hold_before_and_after_an_erasure(tmp_path: Path) -> None:
    home = str(tmp_path / "lab")
    public, bundle, later = tmp_path / "lab.pub", tmp_path / "R1.zip", tmp_path / "later.zip"
    bare = tmp_path / "bare.zip"
    with a_lab(tmp_path) as client:
        run = client.submit({"name": "flow.yaml", "text": FLOW}, user="ada")
        client.cancel(run, "bo", why=SECRET)
        public.write_text(say("key", "create", "--name", "example.org/lab", "--home", home))
        say("checkpoint", "--home", home)
        assert SECRET in say("log", "--home", home)
        stored = say("log", "--json", "--home", home)
        assert SECRET not in stored
        assert "words:" in stored
        position = next(
            int(line.split()[0]) for line in say("log", "--home", home).splitlines() if SECRET in line
        )
        state = say("replay", home, "--at", str(position), "--hash")
        say("bundle", run, "-o", str(bundle), "--home", home)
        say("bundle", run, "-o", str(bare), "--without-words", "--home", home)
        told = say("erase", str(position), "--because", "personal", "--user", "ada", "--home", home)
        assert "1 text was erased" in told
        assert SECRET not in say("log", "--home", home)
        assert say("replay", home, "--at", str(position), "--hash") == state
        say("bundle", run, "-o", str(later), "--home", home)
        verified = say("verify", "--home", home)
        assert "0 are unchanged, 1 were erased" in verified
    key = ("--public-key", str(public))
    assert SECRET.encode() in unpack(bundle)
    assert "1 of 1 texts of people are there" in say("verify", "--bundle", str(bundle), *key)
    for each in (later, bare):
        assert SECRET.encode() not in unpack(each)
        assert "1 were erased or left out" in say("verify", "--bundle", str(each), *key)


def unpack(path: Path) -> bytes:
    with zipfile.ZipFile(path) as archive:
        return b"".join(archive.read(name) for name in archive.namelist())


def test_a_bundle_with_other_words_is_refused(tmp_path: Path) -> None:
    home, bundle = str(tmp_path / "lab"), tmp_path / "R1.zip"
    with a_lab(tmp_path) as client:
        run = client.submit({"name": "flow.yaml", "text": FLOW}, user="ada")
        client.cancel(run, "bo", why=SECRET)
        public = tmp_path / "lab.pub"
        public.write_text(say("key", "create", "--name", "example.org/lab", "--home", home))
        say("checkpoint", "--home", home)
        say("bundle", run, "-o", str(bundle), "--home", home)
    changed = tmp_path / "changed.zip"
    with zipfile.ZipFile(bundle) as archive, zipfile.ZipFile(changed, "w") as other:
        for name in archive.namelist():
            other.writestr(name, archive.read(name).replace(b"has a cold", b"is all well"))
    told = CliRunner().invoke(group, ["verify", "--bundle", str(changed), "--public-key", str(public)])
    assert told.exit_code == 1
    assert "was changed after it was written" in told.output


def test_an_older_backup_does_not_bring_back_what_was_erased_since(tmp_path: Path) -> None:
    home, safe, newer = tmp_path / "lab", str(tmp_path / "safe"), str(tmp_path / "newer")
    with a_lab(tmp_path) as client:
        client.control("pause", "lab", "bo", why=SECRET)
        client.take_out("press", "it smells", "bo")
        say("backup", safe, "--home", str(home))
        assert SECRET.encode() in bytes_of(tmp_path / "safe")
        assert "intact" in say("verify", "--backup", safe)
        (paused,) = events(client, "starts.paused")
        client.erase_words("personal", "ada", records=[paused["position"]])
        shutil.copytree(safe, newer)
        say("backup", newer, "--home", str(home))
        assert SECRET.encode() not in bytes_of(tmp_path / "newer")
        assert "intact" in say("verify", "--backup", newer)
    for file in home.glob("labos.db*"):
        file.unlink()
    say("restore", safe, "--home", str(home))  # the list stands in the lab's folder
    assert SECRET.encode() not in bytes_of(home)
    told = say("log", "--home", str(home))
    assert ERASED in told
    assert "it smells" in told
    assert "1 were erased" not in say("verify", "--home", str(home))
    assert "1 in a newer copy of this log" in say("verify", "--home", str(home))
    elsewhere = tmp_path / "elsewhere"
    say("restore", safe, "--home", str(elsewhere), "--erased", str(home / "labos.erased"))
    assert SECRET.encode() not in bytes_of(elsewhere)
    last = tmp_path / "last"
    say("restore", newer, "--home", str(last))
    assert "1 are unchanged, 1 were erased" in say("verify", "--home", str(last))


def test_an_older_copy_of_the_database_loses_them_when_the_lab_starts(tmp_path: Path) -> None:
    home = tmp_path / "lab"
    with a_lab(tmp_path) as client:
        client.control("pause", "lab", "bo", why=SECRET)
    shutil.copy(home / "labos.db", tmp_path / "copy.db")
    with a_lab(tmp_path) as client:
        client.erase_words("personal", "ada", user="bo")
    shutil.copy(tmp_path / "copy.db", home / "labos.db")
    assert SECRET.encode() in bytes_of(home)
    with a_lab(tmp_path) as client:
        assert events(client, "starts.paused")[0]["payload"]["why"] == ERASED
    assert SECRET.encode() not in bytes_of(home)


def test_the_tables_for_sql_lose_them_too(tmp_path: Path) -> None:
    home = tmp_path / "lab"
    ask = ("sql", "SELECT why FROM runs", "--home", str(home))
    with a_lab(tmp_path) as client:
        run = client.submit({"name": "flow.yaml", "text": FLOW}, user="ada")
        client.cancel(run, "bo", why=SECRET)
        assert SECRET in say(*ask)
        assert SECRET.encode() in bytes_of(home)
        say("erase", "--for", "bo", "--because", "request", "--user", "ada", "--home", str(home))
        assert SECRET.encode() not in bytes_of(home)
        assert ERASED in say(*ask)


def test_a_second_person_agrees_where_the_policy_asks_for_one(tmp_path: Path) -> None:
    home = str(tmp_path / "lab")
    with a_lab(tmp_path) as client:
        client.apply_policy("labos: 1\nerasure: true\n", "policy.yaml", "ada")
        client.control("pause", "lab", "bo", why=SECRET)
        (paused,) = events(client, "starts.paused")
        at = str(paused["position"])
        told = say("erase", at, "--because", "secret", "--user", "ada", "--home", home)
        assert "X1 waits for a second person" in told
        assert "X1" in say("erase", "--home", home)
        assert events(client, "starts.paused")[0]["payload"]["why"] == SECRET
        with pytest.raises(Refused, match="a second person"):
            client.approve_erasure("X1", "ada")
        done = client.approve_erasure("X1", "olga")
        assert (done["erased"], done["erasure"]) == (1, "")
        (gone,) = events(client, "words.erased")
        assert (gone["payload"]["by"], gone["payload"]["approved_by"]) == ("ada", "olga")
        assert client.erasures() == []
        client.control("resume", "lab", "bo")
        client.control("pause", "lab", "bo", why="again")
        say("erase", "--for", "bo", "--because", "mistake", "--user", "ada", "--home", home)
        say("erase", "--refuse", "X2", "--user", "ada", "--home", home)
        with pytest.raises(NotFound):
            client.approve_erasure("X2", "olga")
        assert events(client, "starts.paused")[1]["payload"]["why"] == "again"


@pytest.mark.parametrize(
    ("asked", "said"),
    [
        ({"records": [9999]}, "no position 9999"),
        ({"records": [1]}, "There are no erasable words at these positions"),
        ({"user": "nobody"}, "There are no erasable words at these positions"),
        ({}, "by 1 to 1000 positions, or by a user"),
    ],
)
def test_what_cannot_be_erased_is_said(tmp_path: Path, asked: dict[str, Any], said: str) -> None:
    with a_lab(tmp_path) as client:
        with pytest.raises((Refused, NotFound), match=said):
            client.erase_words("personal", "ada", **asked)
        with pytest.raises(Refused, match="is not a valid reason"):
            client.erase_words("because", "ada", user="bo")


def test_words_are_put_into_problems_calendars_and_longer_sentences(tmp_path: Path) -> None:
    with a_lab(tmp_path) as client:
        begins = time.time_ns() + 3600 * 10**9
        booked = client.book("press", begins, begins + 10**12, "ada", whom="ada", why=SECRET)
        assert booked["why"] == SECRET
        changed = client.change_booking(booked["id"], "ada", begins_at=begins + 10**9)
        assert changed["why"] == SECRET
        kernel = find_kernel(tmp_path / "lab")
        assert kernel is not None
        calendar = httpx.get(f"{kernel.url}/api/v1/calendar.ics").content
        assert SECRET.encode() in calendar.replace(b"\r\n ", b"")
        client.enter("corner", "olga", why="to check it")
        with pytest.raises(Refused, match="to check it"):
            client.enter("corner", "bo")
        experiment = client.start_experiment("colours", "ada")
        client.control("cancel", experiment, "bo", why="it is late")
        (cancelled,) = events(client, "experiment.cancelled")
        assert cancelled["payload"]["why"] == "cancelled by bo: it is late"
        client.erase_words("mistake", "ada", records=[cancelled["position"]])
        (cancelled,) = events(client, "experiment.cancelled")
        assert cancelled["payload"]["why"] == f"cancelled by bo: {ERASED}"


def test_an_api_process_shows_words_and_no_more_after_they_were_erased(tmp_path: Path) -> None:
    home = tmp_path / "lab"
    with a_lab(tmp_path) as client:
        api = ApiProcess(tmp_path, "one", free_port(), "--home", str(home)).start()
        try:
            with LabClient(api.url) as other:
                client.control("pause", "lab", "bo", why=SECRET)
                (paused,) = events(other, "starts.paused")
                assert paused["payload"]["why"] == SECRET
                other.take_out("press", f"{SECRET} and so", "bo")  # words that come by this way
                assert SECRET in json.dumps(other.state(), ensure_ascii=False)
                (stored,) = events(other, "starts.paused", stored=True)
                assert list_references(json.dumps(stored["payload"]).encode())
                done = other.erase_words("request", "ada", user="bo")
                assert (done["erased"], done["left"]) == (2, "")
                for each in (client, other):
                    assert events(each, "starts.paused")[0]["payload"]["why"] == ERASED
                    assert "Quux" not in json.dumps(each.state(), ensure_ascii=False)
                    assert ERASED in json.dumps(each.state())
                assert SECRET.encode() not in bytes_of(home)
        finally:
            api.kill()
    assert "Quux" not in api.log.read_text()

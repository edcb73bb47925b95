"""``labos replay`` on every kind of log."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from click.testing import CliRunner

from labos.cli.app import group
from labos.core.state import hash_state
from labos.errors import BadInput
from labos.runtime.ledger import load
from labos.store import FolderBlobs, backup, open_store, write_segment
from labos.testing.faults import QUIET
from labos.testing.lab import SimulatedLab
from tests.simulation.mixes import pcr, stand
from tests.unit.services.logbook import two_users


@pytest.fixture(scope="module")
def home(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("replay") / "lab"
    two_users().save(folder)
    return folder


def replay(*argv: str) -> str:
    result = CliRunner().invoke(group, ["replay", *argv], catch_exceptions=False)
    assert result.exit_code == 0, result.output
    return result.output


def test_every_kind_of_log_comes_to_the_same_state(home: Path, tmp_path: Path) -> None:
    store = open_store(f"sqlite:///{home / 'labos.db'}", read_only=True)
    wanted = f"{store.head().position} {hash_state(load(store)[0])}\n"
    write_segment(tmp_path / "log.jsonl", store.read())
    write_segment(tmp_path / "log.jsonl.gz", store.read())
    backup(store, FolderBlobs(home / "blobs"), tmp_path / "safe")
    store.close()
    printed = CliRunner().invoke(group, ["log", "--json", "--home", str(home)])
    (tmp_path / "printed").write_text(printed.stdout)
    kinds = [home, home / "labos.db", f"sqlite:///{home / 'labos.db'}", tmp_path / "safe"]
    for log in [*kinds, *(tmp_path / name for name in ("log.jsonl", "log.jsonl.gz", "printed"))]:
        assert replay(str(log), "--hash") == wanted


def test_each_event_says_what_it_changed(home: Path) -> None:
    lines = [json.loads(line) for line in replay(str(home), "--json").splitlines()]
    assert [line["position"] for line in lines] == list(range(1, len(lines) + 1))
    some = [json.loads(line) for line in replay(str(home), "--from", "5", "--to", "9", "--json").splitlines()]
    assert some == lines[4:9]
    # The changes, one after the other, amount to the state.
    moved = next(line for line in lines if line["type"] == "labware.moved")
    paths = {change["path"] for change in moved["changes"]}
    assert any(path.startswith("bench.labware.") and path.endswith(".station") for path in paths)
    told = replay(str(home), "--from", str(moved["position"]), "--to", str(moved["position"]))
    assert "~ bench.labware." in told
    at = json.loads(replay(str(home), "--at", str(moved["position"])))
    assert at["position"] == moved["position"]
    assert moved["event"]["labware"] in at["bench"]["labware"]


def test_a_simulated_log_is_stepped_through_too(tmp_path: Path) -> None:
    lab = SimulatedLab(stand(), 3, QUIET)
    try:
        lab.run([pcr("a", "ada")])
        lab.save(tmp_path / "seed3.jsonl.gz")
        wanted = f"{len(lab.store.records)} {lab.fingerprint()}\n"
    finally:
        lab.close()
    assert replay(str(tmp_path / "seed3.jsonl.gz"), "--hash") == wanted


@pytest.mark.parametrize("what", ["nowhere", "", "--at"])
def test_what_is_no_log_or_no_position_is_said(home: Path, tmp_path: Path, what: str) -> None:
    argv = [str(home), "--at", "100000"] if what == "--at" else [str(tmp_path / what)]
    with pytest.raises(BadInput):
        CliRunner().invoke(group, ["replay", *argv], catch_exceptions=False)

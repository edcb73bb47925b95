"""A log that is older than what its nodes know: discovered, and nothing is repeated unasked."""

from __future__ import annotations

import json
import shutil
import sqlite3
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

from labos.cli.app import group
from labos.client import LabClient
from labos.core.ids import ModuleName, local
from labos.core.state import LabState
from labos.errors import LabosError, Refused
from labos.node.world import World
from labos.runtime.ledger import fold
from labos.store import open_store
from labos.testing.person import look
from tests.support.cells import PCR
from tests.support.lab_process import Up, statuses, until


@pytest.fixture
def lab(tmp_path: Path) -> Iterator[Up]:
    up = Up(tmp_path / "lab", "--simulate", "--speed", "1000", "--quiet")
    yield up
    up.clean_up()


def run_command(*argv: str, code: int = 0) -> str:
    """What a command says. In this process: the lab runs on meanwhile, and should not be done first."""
    result = CliRunner().invoke(group, argv)
    told = result.output
    if isinstance(result.exception, LabosError):
        told += str(result.exception)
    assert result.exit_code == code, told
    return told


def count_succeeded(lab: Up, database: str) -> int:
    store = open_store(database, create=False, read_only=True)
    try:
        return sum(record.head.type == "action.succeeded" for record in store.read())
    finally:
        store.close()


def half_done(lab: Up, database: str, copy: Any) -> None:
    """A PCR runs to its end; in the middle of it ``copy`` is called."""
    lab.start_with(*PCR)
    with lab.client() as client:
        run = client.submit("pcr", user="ada")
        until(lambda: count_succeeded(lab, database) >= 3, "three steps are done")
        copy()
        assert statuses(client, [run]) == ["completed"]
    assert lab.interrupt() == 0, lab.read_log()


def only_after_a_round(lab: Up, database: str, restored: int, ahead: set[str]) -> None:
    """The lab asks for a round of the bench, and until then nothing is requested of any node."""
    lab.start()
    with lab.client() as client:

        def list_tellers() -> set[str]:
            return {evidence["by"] for evidence in client.round()["evidence"]}

        wanted = {local(ModuleName(name)) for name in ahead}
        until(lambda: list_tellers() >= wanted, f"all of {ahead} have told")
        until(lambda: all(n["status"] != "GONE" for n in _nodes(lab)), "all nodes are back")
        bench = lab.bench()
        # What was under way in the old log ends by its journal or unknown; a person says how it ended.
        until(lambda: not _answer_open(lab, client), "what was under way is known")
        until(lambda: all(n["status"] == "IDLE" for n in _nodes(lab)), "nothing moves")
        store = open_store(database, create=False, read_only=True)
        try:
            records = list(store.read())
        finally:
            store.close()
        assert [r for r in records[restored:] if r.head.type == "action.requested"] == []
        (asked,) = [q for q in client.state()["interventions"] if q["kind"] == "log_shorter"]
        with pytest.raises(Refused, match="Nobody has reported what stands at"):
            client.resolve(asked["id"], "checked", by="ada")
        assert "is answered" in run_command(
            "bench", "round", "--as-simulated", "--user", "ada", "--home", str(lab.home)
        )
        assert lab.bench() == bench
        for name in ahead:
            assert statuses(client, [client.do(local(ModuleName(name)), "reset", user="ada")]) == [
                "completed"
            ]
    assert lab.interrupt() == 0, lab.read_log()
    assert lab.motions("crash") == []


def test_a_restored_older_backup_is_discovered_and_nothing_is_repeated(lab: Up, tmp_path: Path) -> None:
    database, safe = f"sqlite:///{lab.home / 'labos.db'}", str(tmp_path / "safe")
    half_done(lab, database, lambda: run_command("backup", safe, "--home", str(lab.home)))
    assert "contain nothing that the log lacks" in run_command(
        "verify", "--journals", "--home", str(lab.home)
    )
    assert "not overwritten" in run_command("restore", safe, "--home", str(lab.home), code=1)
    for file in lab.home.glob("labos.db*"):
        file.rename(tmp_path / file.name)
    restored = json.loads(run_command("restore", safe, "--home", str(lab.home), "--json"))
    ahead = json.loads(run_command("verify", "--journals", "--json", "--home", str(lab.home), code=1))
    assert "know more than the log" in ahead["fault"]
    modules = {name.replace(".", "/", 1) for name, more in ahead["journals"].items() if more}
    assert len(modules) >= 3
    only_after_a_round(lab, database, restored["position"], modules)
    assert "is intact" in run_command("verify", "--home", str(lab.home))


@pytest.mark.full
@pytest.mark.parametrize("lives", [1, 2])
def test_a_database_put_back_by_hand(lab: Up, tmp_path: Path, lives: int) -> None:
    """As when the write-ahead log was cut off, or somebody copied the file. ``lives``: how many kernels have
    lived since. After one, the copy's next kernel is of the same epoch, and the nodes know by the positions
    that they were told of; after more they obey a later kernel, and are not used before somebody says that
    the database was restored. The kernel itself goes on: the database calls it the lab's."""
    database = f"sqlite:///{lab.home / 'labos.db'}"
    copy = tmp_path / "copy.db"

    def keep() -> None:
        with (
            closing(sqlite3.connect(lab.home / "labos.db")) as source,
            closing(sqlite3.connect(copy)) as target,
        ):
            source.backup(target)

    half_done(lab, database, keep)
    for _ in range(lives):
        lab.start()
        until(lambda: all(n["status"] == "IDLE" for n in _nodes(lab)), "all nodes are back")
        with lab.client() as client:
            assert statuses(client, [client.submit("pcr", user="ada")]) == ["completed"]
        assert lab.interrupt() == 0
    for file in lab.home.glob("labos.db*"):
        file.unlink()
    shutil.copy(copy, lab.home / "labos.db")
    ahead = json.loads(run_command("verify", "--journals", "--json", "--home", str(lab.home), code=1))
    assert "know more than the log" in ahead["fault"]
    modules = {name.replace(".", "/", 1) for name, more in ahead["journals"].items() if more}
    position = len(lab.records())
    if lives > 1:
        lab.start()
        with lab.client() as client:

            def list_refused() -> set[str]:
                asked = client.state()["interventions"]
                return {q["module"] for q in asked if "labos db restored" in q["text"]}

            until(lambda: list_refused() >= {local(ModuleName(name)) for name in modules}, "they are refused")
            assert all(n["status"] == "GONE" for n in _nodes(lab) if local(n["name"]) in list_refused())
            assert client.health()["status"] == "ok"
        assert lab.interrupt() == 0, lab.read_log()
        assert not [r for r in lab.records()[position:] if r.head.type == "action.requested"]
        run_command("db", "restored", "--home", str(lab.home))
    ahead = json.loads(run_command("verify", "--journals", "--json", "--home", str(lab.home), code=1))
    modules = {name.replace(".", "/", 1) for name, more in ahead["journals"].items() if more}
    only_after_a_round(lab, database, position, modules)


def test_one_file_is_the_whole_log_of_a_lab_that_was_closed(lab: Up, tmp_path: Path) -> None:
    """Somebody reads on while it closes; and where that file is missing, nothing begins anew unasked."""
    file = lab.home / "labos.db"
    lab.start_with(*PCR)
    reader = open_store(f"sqlite:///{file}", create=False, read_only=True)
    try:
        with lab.client() as client:
            assert statuses(client, [client.submit("pcr", user="ada")]) == ["completed"]
        assert reader.head().position > 0
        assert lab.interrupt() == 0, lab.read_log()
    finally:
        reader.close()
    alone = tmp_path / "alone"
    alone.mkdir()
    shutil.copy(file, alone)
    kept = open_store(f"sqlite:///{alone / 'labos.db'}", create=False, read_only=True)
    try:
        assert list(kept.read()) == lab.records()
    finally:
        kept.close()
    for part in lab.home.glob("labos.db*"):
        part.unlink()
    lab.launch()
    process = lab.process
    assert process is not None
    assert process.wait(60) == 1
    assert "holds journals of the lab" in lab.read_log()
    assert "labos restore" in lab.read_log()
    told = run_command("verify", "--journals", "--home", str(lab.home), code=1)
    assert "and this log has no event of it" in told
    for part in lab.home.glob("labos.db*"):
        part.unlink()
    shutil.copy(alone / "labos.db", file)
    lab.start()
    assert lab.interrupt() == 0, lab.read_log()
    assert "contain nothing that the log lacks" in run_command(
        "verify", "--journals", "--home", str(lab.home)
    )


def _answer_open(lab: Up, client: LabClient) -> set[str]:
    """Answer what became of open actions, by a look at the bench; returns those still open."""
    state = LabState()
    fold(state, lab.records())
    world = World(str(lab.home / "world" / "rpl.db"))
    try:
        for question in state.interventions.open.values():
            if question.kind != "log_shorter":
                client.resolve(question.id, look(world, state, question), by="ada")
    finally:
        world.close()
    return {str(action) for action in state.actions.open}


def _nodes(lab: Up) -> list[dict[str, Any]]:
    with lab.client() as client:
        nodes: list[dict[str, Any]] = client.state()["modules"]
        return nodes

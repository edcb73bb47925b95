"""``labos sql``, ``labos audit``, ``labos provenance`` and ``labos diff`` on a lab at rest."""

from __future__ import annotations

import csv
import io
import json
import os
import sys
from pathlib import Path

import pytest

from labos.audit import database
from labos.audit.tables import VIEWS
from labos.cli.app import main
from tests.support.audited import audit_lab, before_the_pool
from tests.support.processes import run_process


@pytest.fixture
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    home = tmp_path / "lab"
    audit_lab().save(home)
    monkeypatch.setenv("LABOS_HOME", str(home))
    monkeypatch.delenv("LABOS_DATABASE_URL", raising=False)
    return home


def ask(capsys: pytest.CaptureFixture[str], *words: str, code: int = 0) -> str:
    assert main(list(words)) == code
    return capsys.readouterr().out


RUNS = "SELECT run, user_id, status, steps FROM runs ORDER BY run"


def test_an_answer_comes_in_every_form(
    home: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    import pyarrow.parquet

    wanted = [
        ("R1", "ada", "completed", "2"),
        ("R2", "ada", "completed", "7"),
        ("R3", "bo", "completed", "14"),
    ]
    found = list(csv.reader(io.StringIO(ask(capsys, "sql", RUNS, "--csv"))))
    assert found[0] == ["run", "user_id", "status", "steps"]
    steps = [row.pop() for row in found[1:]]
    assert [tuple(row) for row in found[1:]] == [row[:3] for row in wanted]
    told = [json.loads(line) for line in ask(capsys, "sql", RUNS, "--json").splitlines()]
    assert [row["run"] for row in told] == ["R1", "R2", "R3"]
    assert list(told[0]) == ["run", "user_id", "status", "steps"]
    file = tmp_path / "runs.parquet"
    assert "3 rows" in ask(capsys, "sql", "SELECT * FROM labos.runs", "--parquet", str(file))
    table = pyarrow.parquet.read_table(file)  # type: ignore[no-untyped-call]
    assert [str(n) for n in table.column("steps").to_pylist()] == steps
    assert table.column("submitted_at_s").type == "double"
    assert "R3" in ask(capsys, "sql", RUNS)


def test_the_tables_are_asked_as_they_are(home: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["sql", RUNS, "--as-is"]) == 1
    assert "labos audit project" in capsys.readouterr().err
    ask(capsys, "audit", "project")
    (home / "labos.db").rename(home / "elsewhere.db")
    assert "R3" in ask(capsys, "sql", RUNS, "--as-is")


def test_the_views_are_listed_with_what_they_say(home: Path, capsys: pytest.CaptureFixture[str]) -> None:
    said = ask(capsys, "sql", "--views")
    for table in VIEWS:
        assert f"\n{table.view} " in said
        assert table.about in said


def test_a_refusal_says_what_to_do(home: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for query in ("DELETE FROM runs", "SELECT nothing FROM nowhere", "SELECT FROM WHERE"):
        assert main(["sql", query]) == 1
        said = capsys.readouterr()
        assert said.err.startswith("labos: ")
        assert "SELECT" in said.err or "labos sql --views" in said.err
    assert main(["sql", RUNS, "--csv", "--json"]) == 2


def test_the_log_is_never_opened_for_writing(home: Path, capsys: pytest.CaptureFixture[str]) -> None:
    before = (home / "labos.db").read_bytes()
    ask(capsys, "sql", RUNS)
    assert (home / "labos.db").read_bytes() == before
    assert (home / "labos-audit.db").stat().st_mode & 0o077 == 0


def test_tables_are_made_anew_and_their_state_is_told(
    home: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    end = audit_lab().position
    assert json.loads(ask(capsys, "audit", "status", "--json"))["behind"] == end
    assert f"is at event {end}" in ask(capsys, "audit", "project")
    facts = json.loads(ask(capsys, "audit", "status", "--json"))
    assert (facts["position"], facts["behind"], facts["log"]) == (end, 0, end)
    assert f"is at event {end}" in ask(capsys, "audit", "rebuild")
    (home / "labos-audit.db").unlink()
    assert "R3" in ask(capsys, "sql", RUNS)
    assert main(["audit", "reader", "grafana"]) == 1
    assert database.find_audit_file(home / "labos.db") == home / "labos-audit.db"


def test_provenance_comes_in_every_form(home: Path, capsys: pytest.CaptureFixture[str]) -> None:
    graph = json.loads(ask(capsys, "provenance", "P1/B7", "--json"))
    assert graph["whole"] is True
    assert {part["origin"]["name"] for part in graph["contents"]} == {"water", "A-17", "B-03", "C-99"}
    assert graph["subject"] == {"kind": "well", "name": "P1/B7"}
    assert "digraph" in ask(capsys, "provenance", "R2#3", "--dot")
    assert json.loads(ask(capsys, "provenance", "R2#3", "--prov"))["entity"]
    early = json.loads(ask(capsys, "provenance", "P1/B7", "--json", "--at", str(before_the_pool())))
    assert [part["origin"]["name"] for part in early["contents"]] == ["water"]
    assert main(["provenance", "P99"]) == 1
    assert "Name labware" in capsys.readouterr().err


def test_a_difference_has_an_earlier_and_a_later_moment(
    home: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    facts = json.loads(ask(capsys, "diff", "--since", "104", "--json"))
    assert {change["about"] for change in facts["changes"]} >= {"labware", "run", "resource"}
    assert main(["diff", "--since", "120", "--until", "110"]) == 1
    assert "later" in capsys.readouterr().err


@pytest.mark.slow
@pytest.mark.skipif(os.name != "posix", reason="needs a terminal")
def test_a_person_asks_at_a_prompt_and_changes_nothing(home: Path) -> None:
    """At a real terminal: a question of two lines, one that would change something, Ctrl-D."""
    leader, follower = os.openpty()
    argv = [sys.executable, "-m", "labos", "sql", "--home", str(home)]
    with run_process(argv, stdin=follower, stdout=follower, stderr=follower) as asking:
        os.close(follower)
        said = b""

        def wait_for(text: bytes) -> None:
            nonlocal said
            while text not in said:
                said += os.read(leader, 4096)
            said = said.partition(text)[2]

        wait_for(b"Ctrl-D ends.")
        os.write(leader, b"SELECT count(*) AS how_many\nFROM runs;\n")
        wait_for(b"how_many\r\n")
        os.write(leader, b"DELETE FROM runs;\n")
        wait_for(b"cannot modify runs")
        wait_for(b"labos> ")
        os.write(leader, b"\x04")
        assert asking.wait(60) == 0
    os.close(leader)

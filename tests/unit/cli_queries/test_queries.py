"""The commands that ask the log, on real SQLite files with real logs."""

from __future__ import annotations

import json
import os
import queue
import shutil
import sqlite3
import subprocess
import sys
import threading
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

from labos.cli._out import show_table
from labos.cli.app import main
from labos.cli.demo import show_summary
from labos.core.ids import InterventionId, LabwareId, ModuleName, RunId
from labos.core.interventions import (
    InterventionOverdue,
    InterventionRequested,
    InterventionResolved,
)
from labos.core.modules import ModuleTakenOut, NodeLeft
from labos.core.repeated import RequestRepeated
from labos.core.runs import RunFailed, RunPaused
from labos.core.state import encode_picture, fold_fingerprint, from_picture
from labos.core.topics import Choice, PlannedWork
from labos.services.interventions import describe_answer
from labos.services.summary import summarise
from labos.services.times import iso_time
from labos.settings import KernelInfo, announce
from labos.store import FolderBlobs, open_store
from tests.unit.cli_queries.conftest import Ask, command_of
from tests.unit.services.logbook import START_NS, Logbook, save, two_users


def raw(home: Path, *statements: str) -> None:
    """Change the file behind LabOS' back."""
    with closing(sqlite3.connect(home / "labos.db")) as connection:
        triggers = connection.execute("SELECT name FROM sqlite_master WHERE type = 'trigger'").fetchall()
        for (name,) in triggers:
            connection.execute(f'DROP TRIGGER "{name}"')
        for statement in statements:
            connection.execute(statement)
        connection.commit()


# -- log ------------------------------------------------------------------------------------------


def test_log_tells_each_event_in_a_sentence(ask: Ask) -> None:
    lines = ask("log").stdout.splitlines()
    assert len(lines) == two_users().position
    assert lines[0].split() == [
        *("1", "2025-06-15", "15:06:40.000+00:00", "lab.created"),
        *["the", "lab", "'paper'", "was", "created,", "simulated", "at", "10", "×", "real", "time"],
    ]
    assert "R1 #4 'Seal plate/Seal': sealer.seal requested (attempt 1)" in "\n".join(lines)


def test_log_as_json_is_what_was_stored(ask: Ask) -> None:
    lines = ask("log", "--json", "--run", "R1").stdout.splitlines()
    assert len(lines) > 60
    records = {record.head.position: record for record in two_users().records}
    for line in lines:
        found = json.loads(line)
        record = records[found["envelope"]["position"]]
        assert found["hash"] == record.hash.hex()
        assert found["payload"] == json.loads(record.payload)
        assert record.envelope.decode() in line


def test_log_filters_narrow_each_other(ask: Ask) -> None:
    args = ("--run", "R1", "--type", "labware", "--module", "sealer", "--since", "2025-06-15T15:08:00Z")
    lines = ask("log", *args).stdout.splitlines()
    assert len(lines) == 3
    assert "P1 moved from ot2_pcr_alpha.deck1_cooler to sealer.default" in lines[0]
    assert len(ask("log", *args, "--last", "1").stdout.splitlines()) == 1
    nobody = ask("log", "--user", "nobody-at-all")
    assert nobody.stdout == ""
    nothing = "labos: This log has no events by 'nobody-at-all' or for 'nobody-at-all'."
    assert nobody.stderr.splitlines()[1:] == [nothing]
    ada = ask("log", "--user", "ada", "--type", "lab.created")
    assert (ada.stdout, "Nothing" in ada.stderr) == ("", False), "ada is known"


@pytest.mark.parametrize(
    ("args", "says"),
    [
        (("--module", "pf4000"), "There is no module 'pf4000' in this log. Did you mean 'pf400'?"),
        (("--module", "rpl/pf4000"), "There is no module 'rpl/pf4000' in this log. Did you mean 'pf400'?"),
        (
            ("--module", "sealer.default"),
            "'sealer.default' is a station. Its module has its events: labos log --module sealer",
        ),
        (("--module", "sealer.nowhere"), "There is no module 'sealer.nowhere' in this log."),
        (("--labware", "P99"), "There is no labware 'P99' in this log. List it: labos labware"),
        (("--run", "R99"), "There is no run 'R99' in this log. List them: labos runs --all"),
    ],
)
def test_what_the_log_does_not_know_is_refused(ask: Ask, args: tuple[str, ...], says: str) -> None:
    assert says in ask("log", *args, code=1).stdout


@pytest.mark.parametrize("args", [("--module", "wc"), ("--module", "rpl/sealer"), ("--labware", "P2")])
def test_what_the_log_knows_is_shown(ask: Ask, args: tuple[str, ...]) -> None:
    assert ask("log", *args).stdout


def test_log_follows_as_events_are_added(home: Path) -> None:
    """A process follows while another appends; a deadline, no sleeping."""
    book = two_users()
    environment = {**os.environ, "LABOS_HOME": str(home), "PYTHONUNBUFFERED": "1"}
    with subprocess.Popen(
        [sys.executable, "-m", "labos", "log", "-f", "--last", "1", "--type", "module", "--type", "run"],
        stdout=subprocess.PIPE,
        text=True,
        env=environment,
        bufsize=1,
    ) as process:
        lines: queue.Queue[str] = queue.Queue()
        assert process.stdout is not None
        stream = process.stdout

        def read() -> None:
            for line in stream:
                lines.put(line)

        reader = threading.Thread(target=read)
        reader.start()
        try:
            assert "R2: started" in lines.get(timeout=30)
            append(
                home, ModuleTakenOut(ModuleName("rpl/hidex"), "smoke"), NodeLeft(ModuleName("rpl/ur5"), "off")
            )
            assert "hidex: taken out of service: smoke" in lines.get(timeout=30)
            append(home, RunPaused(book.state.runs.active["R2"].id))  # type: ignore[index]
            assert "R2: paused" in lines.get(timeout=30), "the node that left is not asked for"
        finally:
            process.terminate()
            process.wait(30)
            reader.join(30)


def append(home: Path, *events: Any) -> None:
    """Add events to a log at rest, as a kernel would."""
    from labos.runtime.ledger import Ledger, load
    from tests.unit.services.logbook import Clock, Ids

    store = open_store(f"sqlite:///{home / 'labos.db'}", create=False)
    try:
        state, _ = load(store)
        head = store.claim(store.head().lab, "test", 30.0)
        clock, ids = Clock(), Ids()
        clock.now, ids.count = state.recorded_at, 10_000_000 + head.position
        ledger = Ledger(state, head, clock, ids)
        store.append(head, [ledger.write(event, "ada").record for event in events])
        store.release(head.epoch)
    finally:
        store.close()


# -- stations, labware, runs ----------------------------------------------------------------------


def test_stations_tell_unknown_from_empty(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from labos.core.decide.lab import ApplyWorkcell, DeclareStation
    from labos.core.ids import StationName
    from tests.simulation import mixes

    book = Logbook()
    book.do(ApplyWorkcell(mixes.CELL.workcell))
    book.do(DeclareStation(StationName("rpl/sealer.default"), ()))
    book.save(tmp_path / "new")
    monkeypatch.setenv("LABOS_HOME", str(tmp_path / "new"))
    result = CliRunner().invoke(command_of("stations"), ["sealer", "hidex.default", "--json"])
    told = {s["station"]: s["state"] for s in json.loads(result.stdout)["stations"]}
    assert told["rpl/sealer.default"] == "empty"
    assert told["rpl/hidex.default"] == "unknown"


def test_stations_at_any_past_moment(ask: Ask) -> None:
    moment = next(r.head for r in two_users().records if r.head.type == "labware.moved")
    table = ask("stations", "--at", str(moment.position), "--occupied").stdout
    assert "ot2_pcr_alpha.deck1_cooler  deck" in table
    assert "P1 (pcr96)" in table
    assert "19 × pcr96" in table
    before = ask("stations", "--at", str(moment.position - 1), "--occupied").stdout
    assert "sciclops.exchange" in before
    by_time = ask("stations", "--at", "2025-06-15T15:08:50Z", "--json").stdout
    assert json.loads(by_time)["time"] == "2025-06-15T15:08:50.000000000Z"
    now = json.loads(ask("stations", "wc.output", "--json").stdout)["stations"][0]["labware"]
    assert now[0]["id"] == "P1"
    assert now[0]["owner"] == "user:ada"
    assert now[0]["since"] == iso_time(START_NS + 250 * 10**9)
    assert "This lab has no station or module" in ask("stations", "fridge", code=2).output
    assert "there was no log yet" in ask("stations", "--at", "2001-01-01", code=1).stdout
    assert "no position 99999" in ask("stations", "--at", "99999", code=1).stdout


def test_the_labware_of_a_lab(ask: Ask) -> None:
    table = ask("labware").stdout.splitlines()
    assert [line.split()[:3] for line in table[1:]] == [
        ["P1", "pcr96", "wc.output.1"],
        ["P2", "pcr96", "sealer.default"],
    ]
    story = ask("labware", "P1").stdout
    assert story.startswith("P1 (pcr96): wc.output.1; of ada\nVariables: a1 = 0, sealed = false")
    assert "pf400.transfer, R1 #1 'Move to OT-2' (ada)" in story
    past = json.loads(ask("labware", "P1", "--at", "2025-06-15T15:08:45Z", "--json").stdout)
    assert past["stays"][-1]["places"] == ["rpl/sciclops.exchange"]
    assert past["stays"][-1]["until"] == ""
    assert "no labware 'P99'" in ask("labware", "P99", code=1).stdout


def test_runs_and_one_run(ask: Ask) -> None:
    table = ask("runs").stdout.splitlines()
    assert table[1].split()[:5] == ["R1", "pcr", "ada", "completed", "14/14"]
    assert "50 s so far" in table[2]
    one = ask("runs", "R1").stdout
    assert "R1: pcr on rpl for ada: completed" in one
    assert [line.split()[0] for line in one.splitlines()[-14:]] == [str(n) for n in range(14)]
    assert json.loads(ask("runs", "--json").stdout)[1]["status"] == "active"
    assert "no run 'R9'" in ask("runs", "R9", code=1).stdout


def test_explain_names_what_a_run_waits_for(ask: Ask, home: Path) -> None:
    told = ask("explain", "R2").stdout
    assert "R2 (pcr, bo) is active." in told
    assert "no kernel runs this lab now" in told
    assert "So far 5 of 14 steps are done; the last was #4 'Seal plate/Seal', done" in told
    append(home, ModuleTakenOut(ModuleName("rpl/pf400"), "smoke"))
    told = ask("explain", "R2").stdout
    assert "#5 'Move to Biometra' waits: pf400 is out of service (smoke)." in told
    assert "It continues after a person or a device has acted." in told
    assert "It ended at" in ask("explain", "R1").stdout
    assert json.loads(ask("explain", "R2", "--json").stdout)["kernel"] is False


def test_explain_says_what_is_asked_because_of_a_run_that_has_failed(ask: Ask, home: Path) -> None:
    choices = (Choice("look", "it is looked at"), Choice("gone", "it is gone"))
    failed = RunFailed(RunId("R2"), "jam", "software")
    asked = InterventionRequested(InterventionId("I1"), "failed_run", "R2", "Where is P2?", choices, run="R2")
    append(home, asked, failed)
    told = ask("explain", "R2").stdout
    assert "It failed: jam (software error)" in told
    assert "a person has to answer I1: Where is P2? labos resolve I1 look; labos resolve I1 gone" in told
    assert "labos resolve I1 look" in json.loads(ask("explain", "R2", "--json").stdout)["now"][-1]


def test_runs_say_why_they_wait(ask: Ask, home: Path) -> None:
    append(home, ModuleTakenOut(ModuleName("rpl/pf400"), "smoke"))
    why = "pf400 is out of service (smoke)"
    assert f"waits: {why}" in ask("runs").stdout
    assert f"Waits: {why} (labos explain R2)" in ask("runs", "R2").stdout
    assert [run["waits"] for run in json.loads(ask("runs", "--json").stdout)] == [[], [why]]


def test_experiments(ask: Ask, home: Path) -> None:
    from labos.core.experiments import ExperimentStarted
    from labos.core.ids import ExperimentId

    assert len(ask("experiments").stdout.splitlines()) == 1
    append(home, ExperimentStarted(ExperimentId("E1"), "colours", "bo"))
    assert ask("experiments").stdout.splitlines()[1].split()[:4] == ["E1", "colours", "bo", "open"]
    assert "colours" in ask("log", "--experiment", "E1").stdout


QUESTIONS = (
    InterventionRequested(
        InterventionId("I1"),
        "unknown_action",
        "a7",
        "Where is P2?",
        (Choice("done", "it stands at the sealer"), Choice("gone", "the run ends")),
        run="R2",
        module="rpl/pf400",
        labware=(LabwareId("P2"),),
    ),
    InterventionRequested(
        InterventionId("I2"),
        PlannedWork.KIND,
        "a8",
        "Put foil in.",
        (Choice("done", "the run goes on"), Choice("not_done", "the run ends")),
        module="rpl/operator",
        due_at=START_NS,
    ),
    InterventionOverdue(InterventionId("I2"), RunId(""), START_NS),
)


def test_what_the_lab_asks(ask: Ask, home: Path) -> None:
    assert ask("interventions").stdout == "No question is open.\n"
    append(home, *QUESTIONS)
    told = ask("interventions").stdout.splitlines()
    at = "2025-06-15 15:12:30"
    assert told[0] == "I1  Where is P2?"
    assert told[1].startswith(f"      since {at}")
    assert told[1].endswith("(0 s); about R2 (pcr), pf400, P2")
    assert told[2:4] == [
        "      labos resolve I1 done   it stands at the sealer",
        "      labos resolve I1 gone   the run ends",
    ]
    assert told[5].endswith("(0 s), due 2025-06-15 15:06:40.000+00:00 (late); about operator")
    assert told[6].split()[:3] == ["labos", "confirm", "I2"]
    assert told[7].split()[:4] == ["labos", "confirm", "I2", "--not-done"]
    first, second = json.loads(ask("interventions", "--json").stdout)
    assert (first["open"], first["run"], first["workflow"], first["labware"]) == (True, "R2", "pcr", ["P2"])
    assert first["answers"][1] == {
        "name": "gone",
        "consequence": "the run ends",
        "command": "labos resolve I1 gone",
    }
    assert (second["kind"], second["overdue"]) == ("planned_work", True)


def test_the_inbox_says_that_the_lab_asks_for_help_too(ask: Ask, home: Path) -> None:
    append(home, QUESTIONS[0])
    assert ask("inbox").stdout.splitlines() == [
        "No planned work waits now.",
        "Other open questions: I1. See: labos interventions",
    ]
    append(home, *QUESTIONS[1:])
    assert ask("inbox").stdout.splitlines()[-1].endswith("I1. See: labos interventions")


def test_who_answers_late_is_told_who_did_before(home: Path) -> None:
    append(home, *QUESTIONS, InterventionResolved(InterventionId("I1"), "gone", "olga", "it fell down"))
    store = open_store(f"sqlite:///{home / 'labos.db'}", create=False, read_only=True)
    try:
        assert describe_answer(store, "I1").startswith("olga answered I1 at 2025-06-15")
        assert describe_answer(store, "I1").endswith(": gone (it fell down).")
        assert describe_answer(store, "I2") == describe_answer(store, "I9") == ""
    finally:
        store.close()


def test_what_was_asked_for_again_stands_in_the_log_of_its_run(ask: Ask, home: Path) -> None:
    append(home, RequestRepeated("R2", "cancel", "second thoughts"), RequestRepeated("*", "pause", "lunch"))
    assert "R2: cancel was requested again: second thoughts" in ask("log", "--run", "R2").stdout
    assert "the lab: pause was requested again: lunch" in ask("log").stdout


def test_what_the_lab_asked_and_who_answered(ask: Ask, home: Path) -> None:
    append(home, *QUESTIONS)
    append(
        home,
        InterventionResolved(InterventionId("I1"), "gone", "olga", "it fell down"),
        InterventionResolved(InterventionId("I2"), "withdrawn", "labos", "the run was cancelled"),
    )
    assert ask("interventions").stdout.splitlines() == [
        "No question is open.",
        "2 more are answered: labos interventions --all",
    ]
    assert json.loads(ask("interventions", "--json").stdout) == []
    head, first, second, *_ = ask("interventions", "--all").stdout.splitlines()
    assert head.split() == ["id", "asked", "answered", "by", "choice", "about", "question"]
    assert "olga gone (it fell down)" in " ".join(first.split())
    assert "R2 (pcr), pf400, P2" in first
    assert "auto-resolved (the run was cancelled)" in second
    answered = json.loads(ask("interventions", "--all", "--json").stdout)[0]
    assert (answered["open"], answered["choice"], answered["by"]) == (False, "gone", "olga")
    assert answered["resolved_at"] >= answered["requested_at"] > ""


def test_twh_as_table_and_json(ask: Ask) -> None:
    table = ask("twh").stdout
    assert table.splitlines()[1].split()[:6] == ["lab", "3", "min", "10", "s", "and"]
    found = json.loads(ask("twh", "--run", "R1", "--json").stdout)
    assert found["pace"] == 10
    assert found["scopes"][0]["longest_s"] == 140
    assert found["scopes"][0]["longest"]["commands"] == 14
    assert "No experiment 'E7'" in ask("twh", "--experiment", "E7", code=1).stdout


def test_twh_tells_where_the_time_went(ask: Ask) -> None:
    told = ask("twh", "--losses").stdout.splitlines()
    assert told[1].split("  ")[0] == "lab"
    assert "Losses of the lab" in told
    assert "A person is needed next" in told
    (run,) = json.loads(ask("twh", "--losses", "--run", "R2", "--json").stdout)["scopes"]
    why = run["why"]
    assert why["span_s"] == why["at_work_s"] + why["lost_s"]
    assert sum(loss["lost_s"] for loss in why["losses"]) == why["lost_s"]


def test_the_summary_is_shown(capsys: pytest.CaptureFixture[str]) -> None:
    show_summary(summarise(two_users().records, two_users().clock.now))
    told = capsys.readouterr().out
    assert "Longest time without human intervention: 4 min 00 s (40 min 00 s of lab time)" in told
    assert "R1   pcr" in told
    show_table(("a", "b"), [("[x]", "y" * 300)])
    assert "[x]  " + "y" * 300 in capsys.readouterr().out


# -- verify ---------------------------------------------------------------------------------------


def test_a_whole_log_is_said_to_be_whole(ask: Ask) -> None:
    told = ask("verify").stdout
    head = two_users().records[-1]
    assert f"The log is intact: {head.head.position} records" in told
    assert f"head position {head.head.position}, head hash {head.hash.hex()}" in told
    assert "does not show that the end was cut off" in told


@pytest.mark.parametrize(
    ("statement", "position", "reason"),
    [
        ("UPDATE event SET payload = x'7b7d' WHERE position = 50", 50, "payload is not the one"),
        ("UPDATE event SET actor = 'eve' WHERE position = 60", 60, "columns contradict the envelope"),
        ("UPDATE event SET hash = zeroblob(32) WHERE position = 70", 70, "hash does not follow"),
        ("DELETE FROM event WHERE position = 80", 80, "record is missing"),
    ],
)
def test_tampering_is_named_by_its_position(
    ask: Ask, home: Path, statement: str, position: int, reason: str
) -> None:
    raw(home, statement)
    told = ask("verify", code=1).stdout
    assert f"The log is damaged. Position {position}: " in told
    assert reason in told
    found = json.loads(ask("verify", "--json", code=1).stdout)
    assert (found["whole"], found["position"]) == (False, position)


def test_what_stands_beside_the_log_is_checked_too(ask: Ask, home: Path) -> None:
    book = two_users()
    shutil.rmtree(home)
    book.save(home, with_snapshot=True)
    (home / "world").mkdir()
    with closing(sqlite3.connect(home / "world" / "rpl.db")) as bench:
        bench.execute("CREATE TABLE motion (seq INTEGER PRIMARY KEY, facts TEXT)")
        bench.execute("INSERT INTO motion VALUES (1, '{}'), (2, '{\"a\": 1}')")
        bench.commit()
    told = ask("verify").stdout
    assert f"The snapshot of position {book.position} is sealed and agrees with the log." in told
    assert f"By the note in the lab's folder, the log has at least {book.position} positions." in told
    assert "Simulated benches: 1, 2 motions." in told
    found = json.loads(ask("verify", "--json").stdout)
    checked = {part["name"]: part["checked"] for part in found["parts"]}
    assert checked == {
        "log": book.position,
        "end": 1,
        "snapshot": 1,
        "blobs": checked["blobs"],
        "signatures": 0,
        "words": 0,
        "benches": 1,
        "database": 1,
    }
    assert checked["blobs"] >= 1


def test_a_forged_snapshot_is_named(ask: Ask, home: Path) -> None:
    book = two_users()
    shutil.rmtree(home)
    book.save(home, with_snapshot=True)
    raw(home, "UPDATE snapshot SET data = zeroblob(100)")
    told = ask("verify", code=1).stdout
    assert f"The snapshot of position {book.position} is not used: its seal was made with another key" in told
    raw(home, "UPDATE snapshot SET digest = ''")
    assert "is not used: it has no seal" in ask("verify").stdout
    raw(home, "DELETE FROM snapshot")
    assert "There is no snapshot." in ask("verify").stdout


def test_a_sealed_snapshot_that_the_log_does_not_fold_to_is_named(ask: Ask, home: Path) -> None:
    book = two_users()
    other = from_picture(encode_picture(book.state))
    other.lab.name = "another"
    store = open_store(f"sqlite:///{home / 'labos.db'}", home=home)
    store.save_snapshot(book.position, book.records[-1].hash, fold_fingerprint(), encode_picture(other))
    store.close()
    assert "differs from the state by the log" in ask("verify", code=1).stdout


def test_blobs_are_checked_against_the_log(ask: Ask, home: Path) -> None:
    files = sorted(path for path in (home / "blobs").rglob("*") if path.is_file())
    named = next(
        path for path in files if path.name.encode() in b"".join(r.payload for r in two_users().records)
    )
    data = named.read_bytes()
    named.write_bytes(bytes([data[0] ^ 1]) + data[1:])
    assert f"The blob {named.name} that position " in ask("verify", code=1).stdout
    named.unlink()
    told = ask("verify", "--json", code=1).stdout
    found = json.loads(told)
    position = found["position"]
    assert named.name.encode() in two_users().records[position - 1].payload
    assert f"names the blob {named.name}, which is missing" in told
    named.write_bytes(data)
    FolderBlobs(home / "blobs").put(b"nobody knows me")
    assert "others are there" in ask("verify").stdout


def test_journals_are_checked(ask: Ask, home: Path) -> None:
    journal = home / "journals" / "rpl.pf400.journal"
    journal.parent.mkdir()
    journal.write_bytes(b"this is none\nat all\n")
    told = ask("verify", "--journals", code=1).stdout
    assert f"The journal {journal} is damaged" in told
    assert "were not checked (--journals)" in ask("verify").stdout


def test_a_checkpoint_shows_a_tail_that_was_cut(ask: Ask, home: Path, tmp_path: Path) -> None:
    file = tmp_path / "checkpoint.json"
    assert "checkpoint was written" in ask("verify", "--checkpoint", str(file)).stdout
    kept = json.loads(file.read_bytes())
    end = two_users().records[-1]
    assert kept["position"] == end.head.position
    assert kept["hash"] == end.hash.hex()
    assert set(kept) == {"lab", "position", "hash", "time"}
    assert "It agrees with the checkpoint" in ask("verify", "--checkpoint", str(file)).stdout
    cut = two_users().records[-11]
    raw(
        home,
        f"DELETE FROM event WHERE position > {cut.head.position}",
        f"UPDATE head SET position = {cut.head.position}, hash = x'{cut.hash.hex()}', "
        f"recorded_at = {cut.head.recorded_at}",
    )
    once = cut.head.position + 10
    assert f"but it once ended at {once}: its end is lost" in ask("verify", code=1).stdout
    (home / "labos.head").unlink()
    assert "The log is intact" in ask("verify").stdout, "a chain alone does not show it"
    told = ask("verify", "--checkpoint", str(file), code=1).stdout
    assert f"The log ends at position {cut.head.position}" in told.replace("the log ends", "The log ends")
    assert "its tail was cut off" in told
    assert json.loads(file.read_bytes()) == kept


def test_a_checkpoint_shows_a_log_that_was_rewritten(ask: Ask, home: Path, tmp_path: Path) -> None:
    file = tmp_path / "checkpoint.json"
    ask("verify", "--checkpoint", str(file))
    other = Logbook()
    other.furnish()
    other.submit("pcr", "eve")
    other.at(1)
    other.carry_through("R1", seconds=1)
    other.submit("pcr", "eve")
    other.carry_through("R2", seconds=1)
    assert other.position > two_users().position
    shutil.rmtree(home)
    save(other.records, home)
    assert "has another hash" in ask("verify", "--checkpoint", str(file), code=1).stdout
    file.write_text("[]")
    assert "is not a checkpoint" in ask("verify", "--checkpoint", str(file), code=1).stdout


def test_a_checkpoint_is_renewed_on_request(ask: Ask, home: Path, tmp_path: Path) -> None:
    file = tmp_path / "checkpoint.json"
    ask("verify", "--checkpoint", str(file))
    append(home, ModuleTakenOut(ModuleName("rpl/hidex"), "smoke"))
    ask("verify", "--checkpoint", str(file))
    assert json.loads(file.read_bytes())["position"] == two_users().position
    ask("verify", "--checkpoint", str(file), "--export")
    assert json.loads(file.read_bytes())["position"] == two_users().position + 1
    assert "--export needs" in ask("verify", "--export", code=2).output


# -- db -------------------------------------------------------------------------------------------


def test_the_state_of_the_database(ask: Ask, home: Path) -> None:
    told = ask("db", "status").stdout
    assert f"Head: position {two_users().position}, epoch 1" in told
    assert "Kernel: none" in told
    facts = json.loads(ask("db", "status", "--json").stdout)
    assert facts["state"] == "current"
    assert facts["bytes"] > 100_000
    assert ask("db", "url").stdout.strip() == f"sqlite:///{home / 'labos.db'}"
    assert "already at revision" in ask("db", "upgrade").stdout


def test_a_database_that_is_not_there_or_not_ready(ask: Ask, tmp_path: Path) -> None:
    missing = f"sqlite:///{tmp_path / 'none.db'}"
    assert "does not exist yet" in ask("db", "status", "--database", missing, code=1).stdout
    assert not (tmp_path / "none.db").exists()
    assert "There is no SQLite database" in ask("log", "--database", missing, code=1).stdout
    assert "was upgraded from no revision to revision" in ask("db", "upgrade", "--database", missing).stdout
    assert ask("log", "--database", missing).stdout == ""
    told = ask("verify", "--database", missing, code=1).stdout
    assert "The log is intact: 0 records" in told
    assert "The log is empty, but the log of this lab's folder once ended at" in told
    for name in ("runs", "labware", "stations", "experiments", "twh"):
        ask(name, "--database", missing)


def test_a_password_is_not_shown(ask: Ask, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("LABOS_DATABASE_URL", "postgresql://ada:secret@host/lab")
    told = ask("db", "url").stdout
    assert told.strip() == "postgresql://ada:***@host/lab"


def test_a_living_kernel_is_seen_and_its_database_not_upgraded(ask: Ask, home: Path) -> None:
    store = open_store(f"sqlite:///{home / 'labos.db'}")
    head = store.claim(store.head().lab, "pid 1", 60.0)
    try:
        assert "Kernel: pid 1" in ask("db", "status").stdout
        assert "no kernel runs" not in ask("explain", "R2").stdout
        assert len(ask("log").stdout.splitlines()) == two_users().position
        raw(home, "UPDATE labos_version SET version_num = ''")
        assert "A kernel (pid 1) is running" in ask("db", "upgrade", code=1).stdout
    finally:
        store.release(head.epoch)
        store.close()


def test_the_kernels_database_is_found_through_its_home(ask: Ask, tmp_path: Path) -> None:
    elsewhere = tmp_path / "elsewhere"
    url = two_users().save(elsewhere)
    home = tmp_path / "home"
    announce(home, KernelInfo(0, "http://127.0.0.1:1", "", "lab-1", url))
    assert ask("db", "url", "--home", str(home)).stdout.strip() == url
    assert len(ask("log", "--last", "5", "--home", str(home)).stdout.splitlines()) == 5
    other = f"sqlite:///{tmp_path / 'other.db'}"
    assert ask("db", "url", "--home", str(home), "--database", other).stdout.strip() == other


def test_reading_changes_nothing(ask: Ask, home: Path) -> None:
    before = (home / "labos.db").read_bytes()
    for name in ("log", "stations", "labware", "runs", "verify", "twh", "experiments", "interventions"):
        ask(name)
    ask("db", "status")
    assert (home / "labos.db").read_bytes() == before


# -- manners --------------------------------------------------------------------------------------

NAMES = (
    *("log", "stations", "labware", "runs", "explain", "verify", "db", "twh", "validate", "experiments"),
    "interventions",
)


@pytest.mark.parametrize("name", NAMES)
def test_help_teaches_by_examples(name: str) -> None:
    told = CliRunner().invoke(command_of(name), ["--help"]).stdout
    assert f"\n  labos {name}" in told


def test_errors_are_one_line_and_codes_are_kept(home: Path, capfd: pytest.CaptureFixture[str]) -> None:
    assert main(["runs", "--home", str(home)]) == 0
    assert main(["runs", "R9", "--home", str(home)]) == 1
    assert main(["runs", "--no-such-option"]) == 2
    assert main(["log", "--since", "yesterday", "--home", str(home)]) == 1
    raw(home, "UPDATE event SET payload = '{}' WHERE position = 50")
    assert main(["verify", "--home", str(home)]) == 1
    said = capfd.readouterr().err
    assert "labos: There is no run 'R9' in this log. List them: labos runs --all\n" in said
    assert "Traceback" not in said


def test_a_damaged_log_is_named_not_a_traceback(ask: Ask, home: Path) -> None:
    raw(home, "UPDATE event SET payload = '{}' WHERE position = 50")
    for name in ("log", "stations", "twh"):
        assert "position 50" in ask(name, code=1).stdout

"""``labos export``: crates and events that foreign software reads and finds in order."""

from __future__ import annotations

import hashlib
import json
import signal
import subprocess
import sys
import zipfile
from pathlib import Path
from typing import Any

import pytest

from labos.audit._crate_parts import METADATA, Crate, safe_name
from labos.audit.crate import make_crate
from labos.audit.database import open_audit
from labos.audit.query import open_asker
from labos.cli.app import main
from labos.core.decide.experiments import EndExperiment, NoteExperiment, StartExperiment
from labos.core.decide.lab import StartKernel
from labos.core.ids import ExperimentId, LabId
from labos.core.labware import SamplesRegistered
from labos.store import FolderBlobs, open_store
from tests.foreign.make import ROOT
from tests.integration.audit.logs import GrowingLog, project
from tests.support.audited import MEASURED, PLATE, audit_lab, finish_with
from tests.support.foreign import python_of
from tests.support.processes import run_process
from tests.unit.services.logbook import Logbook, save

SOURCE = b"# the workflow as somebody wrote it\n"
PICTURE = b"\x89PNG not really"
FILE = {
    "file": "../shots/final image.png",
    "sha256": hashlib.sha256(PICTURE).hexdigest(),
    "bytes": len(PICTURE),
}
WFRUN = "https://w3id.org/ro/wfrun"


@pytest.fixture(scope="module")
def kept(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """R2 returned a picture, R3 and R4 are of the experiment E1 and of one workflow, R5 failed, R6 has begun.
    Before R6, a newer LabOS took over."""
    book = Logbook()
    book.furnish()
    pins = {"workflow": hashlib.sha256(SOURCE).hexdigest()}
    finish_with(book, book.submit("cp_newplate", "ada"), {})
    finish_with(
        book, book.submit("cp_mixcolor", "ada", pins=pins), {"Take picture": {**MEASURED, "picture": FILE}}
    )
    book.do(StartExperiment("app", "ada"))
    for _ in range(2):
        finish_with(book, book.submit("pcr", "ada", pins=pins, experiment=ExperimentId("E1")), {})
    book.finish(
        book.start(book.submit("pcr", "bo"), 0), succeeded=False, effects="none", error="it is jammed"
    )
    book.do(StartKernel(2, "0.2.0"), "labos")
    book.start(book.submit("pcr", "bo"), 0)
    home = tmp_path_factory.mktemp("kept") / "lab"
    book.save(home)
    for content in (SOURCE, PICTURE):
        FolderBlobs(home / "blobs").put(content)
    return home


@pytest.fixture(autouse=True)
def elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    for name in ("LABOS_HOME", "LABOS_DATABASE_URL", "LABOS_URL"):
        monkeypatch.delenv(name, raising=False)


def export(home: Path, *words: str, code: int = 0) -> None:
    assert main(["export", *words, "--home", str(home)]) == code


def graph_of(crate: Path) -> dict[str, dict[str, Any]]:
    data = (crate / METADATA).read_bytes() if crate.is_dir() else zipfile.ZipFile(crate).read(METADATA)
    return {entity["@id"]: entity for entity in json.loads(data)["@graph"]}


def ids(value: Any) -> list[str]:
    return [each["@id"] for each in (value if isinstance(value, list) else [value])] if value else []


# -- crates ------------------------------------------------------------------------------------


def validate(*crates: str, profile: str = "provenance-run-crate") -> list[dict[str, Any]]:
    """What foreign software says of crates."""
    wanted = [f"{name}={profile}" for name in crates]
    command = [python_of("exports"), ROOT / "tests" / "foreign" / "crate_check.py", "cache", *wanted]
    run = subprocess.run(command, capture_output=True, check=True)
    answers: list[dict[str, Any]] = json.loads(run.stdout)
    return answers


def test_foreign_software_finds_a_crate_in_order(kept: Path) -> None:
    export(kept, "crate", "R2", "--to", "R2", "--license", "https://spdx.org/licenses/CC-BY-4.0")
    (told,) = validate("R2")
    assert told["wrong"] == []
    assert told["name"] == "Run R2: cp_mixcolor"
    assert told["main"] == "workflows/cp_mixcolor.yaml"
    assert len(told["actions"]) == 1 + 5
    written = {str(path.relative_to("R2")) for path in Path("R2").rglob("*") if path.is_file()}
    assert told["parts"] == sorted(written - {METADATA})


@pytest.mark.slow
def test_an_experiment_is_in_order_too_and_a_spoilt_crate_is_not(kept: Path) -> None:
    export(kept, "crate", "E1", "--to", "E1.zip")
    for run in ("R5", "R6"):
        export(kept, "crate", run, "--to", run)
    export(kept, "crate", "R2", "--to", "bad")
    metadata = Path("bad", METADATA)
    told = json.loads(metadata.read_text())
    next(each for each in told["@graph"] if each["@type"] == "ControlAction").pop("instrument")
    metadata.write_text(json.dumps(told))
    experiment, failed, running, bad = validate("E1.zip", "R5", "R6", "bad")
    assert experiment["wrong"] == failed["wrong"] == running["wrong"] == []
    assert {"#run-R3", "#run-R4"} < {*experiment["actions"]}
    assert len(bad["wrong"]) == 1
    assert "ControlAction" in bad["wrong"][0]


REPORT = b"The third one was the greenest.\n"


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An experiment of three workflows, one of which only waits, that computed and published."""
    book = Logbook()
    book.furnish()
    within = ExperimentId("E1")
    book.do(StartExperiment("Color_Picker", "ada"))
    finish_with(book, book.submit("cp_newplate", "ada", experiment=within), {})
    finish_with(book, book.submit("cp_mixcolor", "ada", experiment=within), {"Take picture": MEASURED})
    computed = {"code": "c" * 64, "where": "pool", "host": "desk", "result": [1, 2]}
    report = {"file": "report.txt", "sha256": hashlib.sha256(REPORT).hexdigest(), "bytes": len(REPORT)}
    told = {"title": "The greenest", "keywords": ["green"], "creators": ["ada", "bo"], "files": [report]}
    for kind, name, facts in (
        ("decision", "another one", {"better": True}),
        ("compute", "app.best", computed),
        ("local_compute", "app.worst", {"error": "ValueError: no colours"}),
        ("publication", "the report", told),
        ("publication", "a page", {"page": 7}),
    ):
        book.do(NoteExperiment(within, kind, name, facts))
    book.submit("pcr", "ada", experiment=within)
    home = tmp_path_factory.mktemp("finished") / "lab"
    book.save(home)
    FolderBlobs(home / "blobs").put(REPORT)
    return home


@pytest.mark.slow
def test_an_experiment_of_several_workflows_is_in_order_with_its_program_and_without(finished: Path) -> None:
    Path("app.py").write_text("print('mixing')\n")
    export(finished, "crate", "E1", "--to", "bare")
    export(finished, "crate", "E1", "--to", "whole.zip", "--program", "app.py")
    bare, whole = validate("bare", "whole.zip")
    assert bare["wrong"] == whole["wrong"] == []
    assert (bare["main"], whole["main"]) == ("experiments/E1/course.json", "application/app.py")
    assert {"#experiment-E1", "#run-R1", "#run-R2", "#run-R3"} < {*whole["actions"]}


def test_the_crate_of_an_experiment_holds_what_its_application_did(finished: Path) -> None:
    export(finished, "crate", "E1", "--to", "E1")
    graph = graph_of(Path("E1"))
    assert f"{WFRUN}/provenance/0.5" in ids(graph["./"]["conformsTo"])
    told = json.loads(Path("E1/experiments/E1/course.json").read_text())["course"]
    assert [step.get("run", step.get("name")) for step in told] == [
        *("R1", "R2", "another one", "app.best", "app.worst", "the report", "a page", "R3")
    ]
    application = graph["experiments/E1/course.json"]
    assert [graph[step]["name"] for step in ids(application["step"])] == ["Run R1", "Run R2", "Run R3"]
    published = next(each for each in graph.values() if each.get("name") == "The greenest")
    assert ids(published["creator"]) == ["#user-ada", "#user-bo"]
    (report,) = ids(published["hasPart"])
    assert Path("E1", report).read_bytes() == REPORT
    computed = next(each for each in graph.values() if str(each.get("name")).startswith("app.best at"))
    (result,) = ids(computed["result"])
    assert json.loads(Path("E1", result).read_text()) == [1, 2]
    (tool,) = (graph[each] for each in ids(computed["instrument"]))
    assert "c" * 64 in tool["description"]
    failed = next(each for each in graph.values() if str(each.get("name")).startswith("app.worst at"))
    assert failed["error"] == "ValueError: no colours"
    events = Path("E1/experiments/E1/events.jsonl").read_text().splitlines()
    assert json.loads(events[0])["type"] == "labos.experiment.started"


@pytest.mark.slow
def test_an_experiment_without_runs_is_in_order_with_its_program_and_without(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One that only computed and published, and one that did nothing at all. Without a run that was carried
    out each is a Process Run Crate."""
    monkeypatch.chdir(tmp_path)
    book = Logbook()
    book.furnish()
    computed = {"code": "c" * 64, "where": "pool", "host": "desk", "result": [1, 2]}
    for number, notes in enumerate(
        ([("compute", "app.best", computed), ("publication", "a page", {})], []), 1
    ):
        book.do(StartExperiment("analysis", "ada"))
        for kind, name, facts in notes:
            book.do(NoteExperiment(ExperimentId(f"E{number}"), kind, name, facts))
        book.do(EndExperiment(ExperimentId(f"E{number}")))
    book.save(tmp_path / "lab")
    Path("app.py").write_text("print('thinking')\n")
    names = []
    for experiment in ("E1", "E2"):
        export(tmp_path / "lab", "crate", experiment, "--to", experiment)
        export(tmp_path / "lab", "crate", experiment, "--to", f"{experiment}.zip", "--program", "app.py")
        names += [experiment, f"{experiment}.zip"]
    for name, told in zip(names, validate(*names, profile="process-run-crate"), strict=True):
        assert told["wrong"] == [], name
        assert f"#experiment-{name[:2]}" in told["actions"]


def test_only_an_experiment_has_a_program(kept: Path, capsys: pytest.CaptureFixture[str]) -> None:
    Path("app.py").touch()
    export(kept, "crate", "R2", "--to", "R2", "--program", "app.py", code=1)
    assert "R2 is a run" in capsys.readouterr().err


def test_each_file_is_the_one_that_is_told(kept: Path) -> None:
    export(kept, "crate", "R2", "--to", "R2")
    graph = graph_of(Path("R2"))
    files = [each for each in graph.values() if "File" in each["@type"]]
    for each in files:
        data = Path("R2", each["@id"]).read_bytes()
        assert hashlib.sha256(data).hexdigest() == each["sha256"], each["@id"]
        assert int(each.get("contentSize", len(data))) == len(data)
    assert Path("R2/workflows/cp_mixcolor.yaml").read_bytes() == SOURCE
    assert Path("R2/files/final_image.png").read_bytes() == PICTURE
    (plan,) = Path("R2/plans").iterdir()
    assert hashlib.sha256(plan.read_bytes()).hexdigest().startswith(plan.stem), "its SHA-256 is its name"
    assert json.loads(Path("R2/runs/R2/payload.json").read_text())["destination_wells"] == ["A1", "A2"]
    assert "absorbance,0.52" in Path("R2/results.csv").read_text()


def test_a_crate_tells_who_did_what_with_what(tmp_path: Path) -> None:
    audit_lab().save(tmp_path / "lab")
    export(tmp_path / "lab", "crate", "R2", "--to", "R2.zip")
    graph = graph_of(Path("R2.zip"))
    mix = next(each for each in graph.values() if each.get("name") == "R2 #1: Mix all colors")
    assert ids(mix["agent"]) == ["#user-ada"]
    assert (mix["startTime"], mix["endTime"]) == (
        "2025-06-15T15:07:41.000+00:00",
        "2025-06-15T15:07:42.000+00:00",
    )
    assert mix["actionStatus"] == "http://schema.org/CompletedActionStatus"
    (driver,) = (graph[each] for each in ids(mix["instrument"]))
    assert (driver["@type"], driver["softwareVersion"]) == ("SoftwareApplication", "1")
    assert graph[driver["about"]["@id"]]["name"] == "rpl/ot2_cp_gamma"
    used = ids(mix["object"])
    assert {"#labware-P1", "#lot-A-17", "#lot-B-03", "#lot-C-99", "files/combined_protocol.yaml"} < {*used}
    arguments = {graph[each]["name"]: graph[each]["value"] for each in used if each.startswith("#argument")}
    assert arguments["color_A_volumes"] == "[10.0,20.0]"
    assert arguments["use_existing_resources"] is False


@pytest.mark.postgres
def test_a_crate_is_the_same_on_both_databases(kept: Path, postgres_url: str) -> None:
    lite_url = f"sqlite:///{kept / 'labos.db'}"
    log = open_store(lite_url, create=False, read_only=True, home=kept)
    found = []
    for url in (lite_url, postgres_url):
        tables = open_audit(url)
        project(GrowingLog(list(log.read())), tables)
        tables.close()
        with open_asker(url) as asker:
            crates = [make_crate(asker, log, name, 0) for name in ("R1", "R2", "E1", "R5", "R6")]
            found.append([list(crate.read_contents(FolderBlobs(kept / "blobs"))) for crate in crates])
    log.close()
    assert found[0] == found[1]


def test_only_of_what_something_was_carried_out_is_a_provenance_run_crate(kept: Path) -> None:
    export(kept, "crate", "E1", "--to", "E1")
    assert f"{WFRUN}/provenance/0.5" in ids(graph_of(Path("E1"))["./"]["conformsTo"])
    export(kept, "crate", "R6", "--to", "R6")
    graph = graph_of(Path("R6"))
    running = graph["#run-R6"]
    (by,) = (graph[each] for each in ids(graph["#execution-R6"]["instrument"]))
    assert by["softwareVersion"] == "0.2.0", (
        "of the LabOS that carries it out, not of the one that exports it"
    )
    assert running["actionStatus"] == "http://schema.org/ActiveActionStatus"
    assert "endTime" not in running
    book = Logbook()
    book.furnish()
    book.do(StartExperiment("app", "ada"))
    for workflow in ("cp_newplate", "pcr"):
        book.submit(workflow, "ada", experiment=ExperimentId("E1"))
    save(book.records, Path("other"))
    export(Path("other"), "crate", "E1", "--to", "other-E1")
    root = graph_of(Path("other-E1"))["./"]
    assert ids(root["conformsTo"]) == [f"{WFRUN}/process/0.5"]
    assert "mainEntity" not in root, "nothing of it was carried out yet"


def test_a_crate_tells_what_failed(kept: Path) -> None:
    export(kept, "crate", "R5", "--to", "R5")
    graph = graph_of(Path("R5"))
    run, action = (graph[each] for each in ids(graph["./"]["mentions"]))
    assert {run["actionStatus"], action["actionStatus"]} == {"http://schema.org/FailedActionStatus"}
    assert action["error"] == "it is jammed"
    assert run["error"]


def test_a_crate_with_its_bundle_proves_itself(kept: Path, capsys: pytest.CaptureFixture[str]) -> None:
    export(kept, "crate", "R2", "--to", "early.zip", "--bundle", code=1)
    assert "no signed checkpoint" in capsys.readouterr().err
    assert not Path("early.zip").exists()
    assert main(["key", "create", "--home", str(kept)]) == 0
    Path("lab.pub").write_text(capsys.readouterr().out)
    assert main(["checkpoint", "--home", str(kept)]) == 0
    export(kept, "crate", "R2", "--to", "R2", "--bundle")
    assert main(["verify", "--bundle", "R2/bundles/R2.zip", "--public-key", "lab.pub"]) == 0
    assert "bundles/R2.zip" in ids(graph_of(Path("R2"))["./"]["hasPart"])
    export(kept, "crate", "R6", "--to", "R6", "--bundle", code=1)
    assert "has not ended" in capsys.readouterr().err


def test_what_cannot_be_exported_is_said(kept: Path, capsys: pytest.CaptureFixture[str]) -> None:
    export(kept, "crate", "R99", "--to", "R99", code=1)
    assert "There is neither a run nor an experiment 'R99' in this log." in capsys.readouterr().err
    Path("full").mkdir()
    Path("full/there").touch()
    export(kept, "crate", "R2", "--to", "full", code=1)
    assert "full already exists" in capsys.readouterr().err
    blob = next((kept / "blobs").rglob(FILE["sha256"]))
    away = blob.rename(blob.with_suffix(".away"))
    export(kept, "crate", "R2", "--to", "gone.zip", code=1)
    assert "There is no blob" in capsys.readouterr().err
    away.rename(blob)
    assert not list(Path().glob("*gone*")), "whole or absent"


def test_files_of_one_name_are_kept_apart() -> None:
    crate = Crate()
    first = crate.put("files/a.txt", b"one")
    second = crate.put("files/a.txt", b"two")
    assert first == "files/a.txt" != second
    assert crate.put("files/b.txt", b"one") == first, "the same content is there once"
    assert [safe_name(name) for name in ("../../x y.png", "C:\\data\\é.csv", "..", "a/")] == [
        "x_y.png",
        "_.csv",
        "file",
        "file",
    ]


# -- events ------------------------------------------------------------------------------------


def lines(capsys: pytest.CaptureFixture[str], home: Path, *words: str) -> list[dict[str, Any]]:
    export(home, "events", *words)
    return [json.loads(line) for line in capsys.readouterr().out.splitlines()]


def test_events_are_cloudevents(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    book = audit_lab()
    home = tmp_path / "lab"
    book.save(home)
    export(home, "events")
    written = capsys.readouterr().out
    command = [python_of("exports"), ROOT / "tests" / "foreign" / "events_check.py"]
    read = subprocess.run(command, input=written.encode(), capture_output=True, check=True)
    told = [json.loads(line) for line in read.stdout.splitlines()]
    assert len(told) == len(book.records)
    for each, record in zip(told, book.records, strict=True):
        head = record.head
        assert (each["id"], each["type"]) == (head.id, f"labos.{head.type}")
        assert (each["position"], each["hash"]) == (str(head.position), record.hash.hex())
        assert each["source"] == "https://labos.invalid/log/lab-1"
        assert each["data"] == json.loads(record.payload)


def test_an_export_goes_on_where_it_ended(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    book = audit_lab()
    home = tmp_path / "lab"
    book.save(home)
    everything = lines(capsys, home)
    assert lines(capsys, home, "--since", "0") == everything
    half = everything[:100]
    assert half + lines(capsys, home, "--since", half[-1]["position"]) == everything
    assert lines(capsys, home, "--since", str(len(everything))) == []
    runs = lines(capsys, home, "--family", "run", "--family", "labware.samples_registered")
    assert runs == [
        each
        for each in everything
        if each["type"].startswith(("labos.run.", "labos.labware.samples_registered"))
    ]
    export(home, "events", "--family", "rnu", code=1)
    assert "no events of type 'rnu'" in capsys.readouterr().err
    export(home, "events", "--since", "100000", code=1)
    assert "no position 100000" in capsys.readouterr().err


@pytest.mark.slow
def test_an_export_follows_the_log(tmp_path: Path) -> None:
    book = audit_lab()
    home = tmp_path / "lab"
    url = book.save(home)
    known = len(book.records)
    command = [
        sys.executable,
        "-m",
        "labos",
        "export",
        "events",
        "-f",
        "--since",
        str(known - 1),
        "--home",
        home,
    ]
    with run_process(
        command,
        stdout=subprocess.PIPE,
        # A shell that runs the tests in the background has Ctrl-C ignored.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
    ) as process:
        assert process.stdout is not None
        assert json.loads(process.stdout.readline())["position"] == str(known)
        book.write([SamplesRegistered(PLATE, "", "5" * 64, 1, ())], "ada")
        store = open_store(url, home=home)
        head = store.claim(LabId("lab-1"), "test", 30.0)
        store.append(head, book.records[known:])
        store.close()
        assert json.loads(process.stdout.readline())["type"] == "labos.labware.samples_registered"
        process.send_signal(signal.SIGINT)
        assert process.wait(20) == 0


def test_a_file_of_events_goes_on_where_it_ends(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    book = audit_lab()
    home, file = tmp_path / "lab", tmp_path / "events.jsonl"
    book.save(home)
    everything = lines(capsys, home)
    export(home, "events", "--to", str(file))
    whole = file.read_bytes()
    assert [json.loads(line) for line in whole.splitlines()] == everything
    # Wherever a crash cuts it: within a line, at its end, before the first.
    for size in (0, 1, len(whole) // 2, len(whole) - 1, whole.index(b"\n") + 1):
        file.write_bytes(whole[:size])
        export(home, "events", "--to", str(file))
        assert file.read_bytes() == whole
    export(home, "events", "--to", str(file))
    assert file.read_bytes() == whole, "nothing comes twice"


def test_a_file_of_something_else_is_left_alone(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    book = audit_lab()
    home = tmp_path / "lab"
    book.save(home)
    last = lines(capsys, home)[-1]
    other = tmp_path / "other"
    cases = {
        "diary": "something other than events",
        '{"a": 1}': "something other than events",
        "diary\nof bo\n": "something other than events",
        json.dumps({**last, "position": "99999999"}) + "\n": "another log",
        json.dumps({**last, "source": "urn:other", "position": "1"}) + "\n": "another lab",
    }
    for text, words in cases.items():
        other.write_text(text)
        export(home, "events", "--to", str(other), code=1)
        assert words in capsys.readouterr().err
        assert other.read_text() == text
    export(home, "events", "--to", str(other), "--family", "run", code=1)
    assert "Leave --since and --family out" in capsys.readouterr().err

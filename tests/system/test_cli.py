"""What the commands answer, on a lab in this process without nodes."""

from __future__ import annotations

import re
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import click
import msgspec
import pytest

from labos.bootstrap import LabThread, descriptions
from labos.cli._exit import CODES, DONE, FAILED, IN_ONE_LINE, INTERRUPTED, MISUSED
from labos.cli.app import main
from labos.client import LabClient
from labos.settings import Settings
from labos.spec import find_spec, load_workcell
from tests.docs.generate import commands
from tests.support.lab_process import until
from tests.support.processes import run_process


class Said(msgspec.Struct):
    """What a command answered."""

    code: int
    out: str
    err: str

    @property
    def facts(self) -> Any:
        """What it answered in JSON: one document and nothing else."""
        return msgspec.json.decode(self.out)


Labos = Callable[..., Said]


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Iterator[LabThread]:
    cell = load_workcell(find_spec("workcells", "rpl"), descriptions())
    settings = Settings.make(tmp_path_factory.mktemp("lab"), speed=5000.0, simulate=True)
    with LabThread(settings, [cell], nodes="none") as running:
        yield running


@pytest.fixture
def home(lab: LabThread, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("LABOS_HOME", str(lab.settings.home))
    monkeypatch.setenv("LABOS_USER", "ada")
    monkeypatch.delenv("LABOS_DATABASE_URL", raising=False)
    return lab.settings.home


@pytest.fixture
def labos(home: Path, capsys: pytest.CaptureFixture[str]) -> Labos:
    """Runs ``labos`` with these words in the lab's home."""

    def labos_(*words: str) -> Said:
        capsys.readouterr()
        code = main(list(words))
        return Said(code, *capsys.readouterr())

    return labos_


@pytest.fixture
def client(lab: LabThread) -> Iterator[LabClient]:
    with LabClient(lab.url) as found:
        yield found


def test_the_reason_of_a_cancellation_is_shown_with_the_run(labos: Labos, client: LabClient) -> None:
    run = client.submit("pcr", user="ada")
    assert labos("cancel", run, "--why", "wrong plate", "--wait").out == f"{run} is cancelled.\n"
    assert "Why: wrong plate" in labos("runs", run).out
    assert "It was cancelled: wrong plate" in labos("explain", run).out
    assert client.status(run).why == "wrong plate"


# -- JSON --------------------------------------------------------------------------------------------

WITHOUT_JSON = {
    *(
        "labos demo",
        "labos up",
        "labos api",
        "labos bus",
        "labos export events",
        "labos node start",
        "labos notifications watch",
        "labos planner",
        "labos witness",
    ),
    "labos mcp",  # an agent speaks to it, in a protocol of its own
    "labos schema",  # it is JSON itself
    *("labos db writer", "labos audit reader"),  # once in the life of a database, by a person
}


def test_every_command_tells_a_program_what_it_did() -> None:
    assert {
        path
        for path, command, _ in commands()
        if "--json" not in options_of(command) and not is_only_a_group(command)
    } == WITHOUT_JSON


def options_of(command: click.Command) -> set[str]:
    return {name for param in command.params for name in param.opts if isinstance(param, click.Option)}


def is_only_a_group(command: click.Command) -> bool:
    return isinstance(command, click.Group) and not command.invoke_without_command


def test_what_was_done_is_told_in_json(labos: Labos, client: LabClient, tmp_path: Path) -> None:
    run = client.submit("pcr", user="ada")
    paused = labos("pause", run, "--why", "its seal looks torn", "--json").facts
    assert paused == {"kind": "run", "paused": True, "target": run}
    assert "its seal looks torn" in labos("runs", run).out
    assert labos("resume", run, "--json").facts == {"kind": "run", "paused": False, "target": run}
    cancelled = labos("cancel", run, "--why", "wrong plate", "--json").facts
    assert cancelled["runs"] == [{"id": run, "status": "cancelled", "why": "wrong plate"}]
    away = labos("out-of-service", "sealer", "--why", "its foil is torn", "--json").facts
    assert away == {"back_at": "", "in_service": False, "module": "sealer"}
    assert labos("in-service", "sealer", "--json").facts == {"in_service": True, "module": "sealer"}
    pose = ("--pose", "190.1,10.2,50.5,260.0,640.7,-480.2")
    assert labos("teach", "pf400", "sealer.default", *pose, "--json").facts["version"] == 1
    assert labos("bench", "declare", "--empty", "--json").code == 0
    placed = labos("place", "camera_module.plate_station", "plate96", "--json").facts
    assert placed["station"] == "camera_module.plate_station"
    plate = placed["labware"]
    assert labos("barcode", plate, "LB1", "--json").facts == {"barcode": "LB1", "labware": plate}
    assert labos("give", plate, "--to", "shared", "--json").facts == {"labware": plate, "owner": "shared"}
    sheet = tmp_path / "sheet.csv"
    sheet.write_text("well,sample\nA1,water\n")
    assert labos("samples", "load", str(sheet), "--plate", plate, "--json").facts == {plate: 1}
    assert labos("resolve", "--json").facts == client.state(waits=False)["interventions"]


FAILURES: dict[str, tuple[tuple[str, ...], str, str]] = {
    "a name that is not there": (
        ("runs", "R999", "--json"),
        "not_found",
        "There is no run 'R999' in this log.",
    ),
    "what the lab refuses": (("submit", "nothing.yaml", "--json"), "not_found", "nothing.yaml"),
    "what the lab does not know": (("cancel", "nobody", "--json"), "not_found", "'nobody'"),
    "an answer to no question": (("resolve", "I99", "done", "--json"), "refused", "I99"),
    "a time that is none": (("stations", "--at", "yesterday-ish", "--json"), "bad_input", "yesterday-ish"),
    "a file that is a folder": (("samples", "load", ".", "--json", "--plate", "P1"), "misused", ""),
}


@pytest.mark.parametrize("what", FAILURES)
def test_an_error_is_told_in_json_too(labos: Labos, what: str) -> None:
    words, code, message = FAILURES[what]
    said = labos(*words)
    if code == "misused":
        assert (said.code, said.facts["code"]) == (2, "misused")
        return
    assert said.code == 1
    error = said.facts
    assert error.keys() == {"code", "error", "remedy", "details"}
    assert (error["code"], message in error["error"]) == (code, True), error
    assert said.err == f"labos: {error['error']} {error['remedy']}".rstrip() + "\n"
    plain = labos(*(word for word in words if word != "--json"))
    assert (plain.code, plain.out, plain.err) == (1, "", said.err)


def test_what_is_wrong_with_a_file_is_told_with_its_place(labos: Labos, tmp_path: Path) -> None:
    file = tmp_path / "wf.yaml"
    file.write_text("steps: [")
    said = labos("submit", str(file), "--json")
    assert said.code == 1
    assert said.facts["code"] == "bad_input"
    assert labos("plan", str(file), "--workcell", "rpl", "--json").facts["details"][0]["line"] == 1


def test_what_the_system_refuses_is_told_in_json(labos: Labos, tmp_path: Path) -> None:
    file = tmp_path / "file"
    file.write_text("")
    said = labos("backup", str(file / "backup"), "--json")
    assert (said.code, said.facts["code"]) == (1, "system_failed")


# -- exit codes --------------------------------------------------------------------------------------


def test_help_names_every_exit_code(labos: Labos) -> None:
    told = " ".join(labos("--help").out.split())
    assert IN_ONE_LINE in told
    assert [int(code) for code in re.findall(r"\b\d+\b", IN_ONE_LINE)] == list(CODES)


def test_every_command_tells_of_itself_and_refuses_what_it_does_not_know(labos: Labos) -> None:
    for path, command, _ in commands():
        words = path.split()[1:]
        assert labos(*words, "--help").code == DONE, path
        assert labos(*words, "--no-such-option").code == MISUSED, path
        required = [p for p in command.params if isinstance(p, click.Argument) and p.required]
        if required:
            assert labos(*words).code == MISUSED, f"{path} without {required[0].name}"


WANT_A_LAB = (
    *(
        "submit pcr",
        "cancel R1",
        "pause R1",
        "resume R1",
        "resolve I1 done",
        "resolve",
        "inbox",
        "confirm I1",
    ),
    *("nodes", "locations pf400", "teach pf400 sealer.default --pose 1", "do sealer seal", "reset sealer"),
    *("calibrate hidex",),
    *("home sciclops", "out-of-service sealer --why x", "in-service sealer", "place wc.output plate96"),
    *(
        "barcode P1 X",
        "load sciclops.tower1 --type plate96",
        "unload sciclops.tower1 P1",
        "observe wc.output empty",
    ),
    *(
        "give P1 --to shared",
        "replenish sealer foil --lot L1",
        "access rpl",
        "bench declare --empty",
        "bench round",
    ),
    *(
        "run pcr",
        "runs",
        "runs R1",
        "explain R1",
        "experiments",
        "results R1",
        "files",
        "stations",
        "labware",
    ),
    *(
        "inventory",
        "interventions",
        "samples show P1",
        "log",
        "twh",
        "handover-report",
        "verify",
        "db status",
    ),
    *("backup to", "replay no.jsonl", "bench show", "workcell apply no.yaml", "notifications test ada"),
    *("notifications watch", "node reset-epoch rpl/pf400 --epoch 1 --why x", "node accept-unit rpl/pf400"),
    *("validate no.yaml --workcell rpl", "plan no.yaml --workcell rpl", "import no.yaml", "restore nowhere"),
    *("driver torture nobody", "driver describe nobody", "actions nobody", "samples load no.csv"),
)
"""Commands that cannot do what they are asked where there is no lab and no such file."""


@pytest.mark.parametrize("words", WANT_A_LAB)
def test_what_cannot_be_done_ends_with_1(
    labos: Labos, words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("LABOS_HOME", str(tmp_path / "lab"))
    monkeypatch.chdir(tmp_path)
    said = labos(*words.split())
    assert (said.code, "Traceback" in said.err) == (FAILED, False), said
    assert not (tmp_path / "lab" / "labos.db").exists()


def test_what_is_asked_about_and_is_as_it_should_be_ends_with_0(labos: Labos) -> None:
    for words in (
        *("runs", "experiments", "files", "nodes", "locations pf400", "stations", "labware", "inventory"),
        *("interventions", "inbox", "resolve", "log --last 1", "twh", "handover-report", "notifications"),
        *(
            "db status",
            "db url",
            "verify",
            "actions",
            "schema workflow",
            "plan pcr --workcell rpl -p seal.time=3",
        ),
        *("validate pcr --workcell rpl -p seal.time=3", "driver describe pf400"),
    ):
        said = labos(*words.split())
        assert said.code == DONE, (words, said)


def test_what_is_asked_about_and_is_wrong_ends_with_1(labos: Labos, home: Path, tmp_path: Path) -> None:
    bad = tmp_path / "bad.yaml"
    bad.write_text("labos: 1\nname: bad\nsteps: []\n")
    assert labos("validate", str(bad), "--workcell", "rpl").code == FAILED, "a workflow with errors"
    assert labos("import", str(bad), "-o", str(tmp_path / "out")).code == FAILED, "a file of no other system"
    run = labos("submit", "pcr", "--json").facts["run"]
    assert labos("cancel", run).code == DONE, "that was asked for"
    assert labos("cancel", run).code == FAILED, "it has ended"
    copy = tmp_path / "copy"
    assert labos("backup", str(copy)).code == DONE
    assert labos("verify", "--backup", str(copy)).code == DONE
    segment = next(copy.rglob("*.jsonl*"))
    segment.write_bytes(segment.read_bytes()[:-7])
    assert labos("verify", "--backup", str(copy)).code == FAILED, "a damaged backup"


@pytest.mark.parametrize(
    ("words", "first", "code"),
    [
        pytest.param(("submit", "pcr", "--wait"), "", INTERRUPTED, id="before the end"),
        pytest.param(("log", "--last", "1", "-f"), "\n", DONE, id="it goes on until then"),
    ],
)
def test_ctrl_c(home: Path, client: LabClient, words: tuple[str, ...], first: str, code: int) -> None:
    runs = len(client.state(waits=False)["runs"])
    with run_process([sys.executable, "-m", "labos", *words], stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        if first:
            assert process.stdout.readline().endswith(first)
        else:
            until(lambda: len(client.state(waits=False)["runs"]) > runs, "it waits for its run")
        process.send_signal(signal.SIGINT)
        process.communicate(timeout=30)
    assert process.returncode == code
    for run in client.state(waits=False)["runs"]:
        client.cancel(run["id"])

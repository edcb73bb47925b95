"""What the shell offers at Tab, on a lab at rest and on one that runs."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from click.shell_completion import ShellComplete

from labos.bootstrap import LabThread, descriptions
from labos.cli.app import group
from labos.client import LabClient
from labos.settings import Settings
from labos.spec import find_spec, load_workcell
from tests.docs.markdown import REFERENCE
from tests.unit.services.logbook import two_users

LABOS = Path(sys.executable).with_name("labos")


def list_offered(line: str) -> list[str]:
    """What is offered for the last word of a line."""
    *words, begun = line.split(" ")[1:]
    return [item.value for item in ShellComplete(group, {}, "labos", "_X").get_completions(words, begun)]


@pytest.fixture
def home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A lab at rest: two users' day."""
    two_users().save(tmp_path / "lab")
    monkeypatch.setenv("LABOS_HOME", str(tmp_path / "lab"))
    monkeypatch.delenv("LABOS_DATABASE_URL", raising=False)
    return tmp_path / "lab"


@pytest.mark.parametrize(
    ("line", "wanted"),
    [
        ("labos runs ", ["R2", "R1"]),
        ("labos explain R1", ["R1"]),
        ("labos results ", ["R2", "R1"]),
        ("labos files ", ["R2", "R1"]),
        ("labos log --run ", ["R2", "R1"]),
        ("labos cancel r", ["rpl"]),
        ("labos pause la", ["lab"]),
        ("labos pause sea", ["sealer"]),
        ("labos out-of-service biom", ["biometra", "biometra_192"]),
        ("labos do peel", ["peeler"]),
        ("labos stations sealer", ["sealer", "sealer.default"]),
        ("labos teach pf400 sealer.", ["sealer.default"]),
        ("labos labware P", ["P1", "P2"]),
        ("labos samples show P1", ["P1"]),
        ("labos submit pc", ["pcr", "pc"]),
        ("labos plan cp_n", ["cp_newplate", "cp_n"]),
        ("labos up rp", ["rpl", "rpl_growth", "rpl_picker", "rp"]),
        ("labos driver describe pf", ["pf400"]),
        ("labos access ", ["rpl"]),
        ("labos can", ["cancel"]),
    ],
)
@pytest.mark.usefixtures("home")
def test_names_are_offered_where_one_is_taken(line: str, wanted: list[str]) -> None:
    assert list_offered(line) == wanted


def test_the_home_on_the_line_counts(home: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("LABOS_HOME")
    assert list_offered(f"labos runs --home {home} R") == ["R2", "R1"]
    assert list_offered(f"labos do --home {home} seal") == ["sealer"]


def test_where_there_is_no_lab_nothing_is_offered_and_nothing_begun(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("LABOS_HOME", str(tmp_path / "none"))
    assert [list_offered(f"labos {words} ") for words in ("runs", "do", "stations", "access")] == [[]] * 4
    assert not (tmp_path / "none").exists()


def test_a_lab_that_runs_is_asked(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    cell = load_workcell(find_spec("workcells", "rpl"), descriptions())
    settings = Settings.make(tmp_path / "lab", speed=5000.0, simulate=True)
    monkeypatch.setenv("LABOS_HOME", str(settings.home))
    with LabThread(settings, [cell], nodes="none") as lab, LabClient(lab.url) as client:
        run = client.submit("pcr", user="ada")
        assert list_offered("labos cancel R") == [run]
        assert list_offered("labos reset seal") == ["sealer"]
        assert list_offered("labos observe sealer.") == ["sealer.default"]


def lines() -> dict[str, str]:
    """The line that the reference gives for each shell."""
    page = (REFERENCE / "cli.md").read_text()
    return dict(re.findall(r"^(bash|zsh|fish) +~/\S+ +(.*)$", page, re.MULTILINE))


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_the_line_in_the_reference_switches_it_on(home: Path, shell: str) -> None:
    assert f"_LABOS_COMPLETE={shell}_source labos" in lines()[shell]
    environment = {**os.environ, "_LABOS_COMPLETE": f"{shell}_source"}
    script = subprocess.run([LABOS], env=environment, capture_output=True, text=True, check=True).stdout
    assert "_LABOS_COMPLETE" in script
    if shell == "bash" and shutil.which("bash"):
        typed = "COMP_WORDS=(labos runs R); COMP_CWORD=2; _labos_completion labos; echo ${COMPREPLY[@]}"
        done = subprocess.run(
            ["bash", "-c", f"{lines()[shell]}\n{typed}"],
            env={**os.environ, "PATH": f"{LABOS.parent}{os.pathsep}{os.environ['PATH']}"},
            capture_output=True,
            text=True,
        )
        assert done.stdout == "R2 R1\n", done.stderr

"""The page about programs that are killed: its program is killed where the page says, and goes on."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

from labos.client import LabClient
from tests.docs.markdown import DOCS, blocks
from tests.support.lab_process import labos
from tests.support.reading import open_reading_lab

PAGE = DOCS / "resume.md"
ROUND = re.compile(r"(E\d+) (OD\d+) (R\d+)")


def shape(text: str) -> list[tuple[str, str]]:
    """Experiment and run of each line: which assay a model chooses is open."""
    return [(e, r) for e, _, r in ROUND.findall(text)]


@pytest.mark.slow
def test_the_page_does_what_it_says(tmp_path: Path) -> None:
    found = list(blocks(PAGE.read_text()))
    (program,) = (block.text for block in found if block.title == "assays.py")
    (tmp_path / "assays.py").write_text(program)
    printed = [block.text for block in found if block.language == "text"]
    argv = [sys.executable, "assays.py"]
    with open_reading_lab(tmp_path) as running, LabClient(running.url) as lab:
        lab.place("hidex.default", "plate96", "ada")
        lab.give("P1", "shared", "ada")
        process = subprocess.Popen(argv, cwd=tmp_path, stdout=subprocess.PIPE, text=True)
        try:
            assert process.stdout is not None
            first = process.stdout.readline()
        finally:
            process.kill()
            process.wait()
            process.stdout.close()
        assert shape(first) == shape(printed[0])
        listed = labos("experiments", "--home", str(tmp_path / "lab")).stdout
        said, shown = listed.splitlines(), printed[1].splitlines()
        assert said[0].split() == shown[0].split()
        assert said[1].split()[:4] == shown[1].split()[:4]
        again = subprocess.run(
            [*argv, "--resume", "E1"], cwd=tmp_path, capture_output=True, text=True, timeout=100, check=False
        )
        assert again.returncode == 0, again.stderr
        assert again.stdout.startswith(first)
        assert shape(again.stdout) == shape(printed[2])
        assays = [assay for _, assay, _ in ROUND.findall(again.stdout)]
        assert sorted(assays) == ["OD450", "OD590", "OD600"]
        assert len(list(lab.events(type="run.submitted"))) == 3
        (resumed,) = lab.events(type="experiment.resumed")
        assert resumed["stream"] == "E1"

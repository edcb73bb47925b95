"""Files that arguments name: beside the workflow, or in the lab's folder around it, and nowhere else."""

from __future__ import annotations

from pathlib import Path

import pytest

from labos.spec.files import FileFinder, find_lab_folder

CELL = "name: corner\nmodules:\n  - {name: arm, model: pf400}\n"
FLOW = "name: x\nmodules: [arm]\nflowdef:\n  - {name: s, module: arm, action: home}\n"


@pytest.fixture
def lab(tmp_path: Path) -> Path:
    lab = tmp_path / "lab"
    (lab / "workflows").mkdir(parents=True)
    (lab / "protocols").mkdir()
    (lab / "protocols/mix.py").write_text("mix")
    (lab / "cell.yaml").write_text(CELL)
    (lab / "workflows/flow.yaml").write_text(FLOW)
    (tmp_path / "secret.txt").write_text("secret")
    return lab


def test_a_protocol_beside_the_workflows_folder_is_found(lab: Path) -> None:
    finder = FileFinder({}, [lab / "workflows"])
    assert finder.find("../protocols/mix.py").content == b"mix"
    assert find_lab_folder(lab / "workflows") == lab


@pytest.mark.parametrize("name", ["../../secret.txt", "../protocols/../../secret.txt", "/etc/hostname"])
def test_what_lies_outside_the_lab_is_not_read(lab: Path, name: str) -> None:
    found = FileFinder({}, [lab / "workflows"]).find(name)
    assert (found.content, found.problem) == (None, "lies outside the workflow's folder")


def test_a_link_does_not_lead_out(lab: Path) -> None:
    (lab / "protocols/link.txt").symlink_to(lab.parent / "secret.txt")
    assert FileFinder({}, [lab / "workflows"]).find("../protocols/link.txt").content is None


@pytest.mark.parametrize("text", [FLOW, "a: 1\n", "services: {}\n", "steps: []\nmodules: []\n", "\0\n"])
def test_a_folder_without_a_workcell_is_no_lab(lab: Path, text: str) -> None:
    (lab / "cell.yaml").write_text(text)
    assert find_lab_folder(lab / "workflows") == lab / "workflows"
    assert FileFinder({}, [lab / "workflows"]).find("../protocols/mix.py").content is None

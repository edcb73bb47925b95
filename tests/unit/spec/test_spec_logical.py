"""Files that are named without their endings, and the folder up to which a workflow's paths may lead."""

from __future__ import annotations

from pathlib import Path

import pytest

from labos.client import workflow_text
from labos.spec.files import FileFinder, find_lab_folder, find_logical

CELL = "labos: 1\nname: cell\nmodules: [{name: sealer, model: A4S_sealer}]\n"


def write(folder: Path, **files: str) -> None:
    for name, text in files.items():
        path = folder / name.replace("__", "/").replace("_dot_", ".")
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)


@pytest.mark.parametrize(
    ("name", "means"),
    [
        ("protocols/mix", "protocols/mix.py"),
        ("protocols/mix.py", "protocols/mix.py"),
        ("protocols/two", "protocols/two"),
        ("protocols/none", "protocols/none"),
        ("mix", "mix"),
        ("../protocols/mix", "../protocols/mix"),
        ("protocols/m*", "protocols/m*"),
        ("protocols/" + "x" * 300, "protocols/" + "x" * 300),
        ("", ""),
    ],
)
def test_a_logical_name_means_the_only_file_of_that_name(name: str, means: str, tmp_path: Path) -> None:
    write(
        tmp_path,
        protocols__mix_dot_py="1",
        protocols__two_dot_py="2",
        protocols__two_dot_hso="3",
        mix_dot_py="4",
    )
    assert find_logical(name, tmp_path) == means
    assert FileFinder({}, [tmp_path]).find_full_name(name) == means
    handed_in = {
        "protocols/mix.py": b"1",
        "protocols/two.py": b"2",
        "protocols/two.hso": b"3",
        "mix.py": b"4",
    }
    assert FileFinder(handed_in, []).find_full_name(name) == means


def test_it_is_sent_along_under_its_full_name(tmp_path: Path) -> None:
    flow = "labos: 1\nname: f\nsteps: [{name: A, module: m, action: a, args: {f: protocols/mix}}]\n"
    write(tmp_path, flow_dot_yaml=flow, protocols__mix_dot_py="1")
    assert list(workflow_text(tmp_path / "flow.yaml")["files"]) == ["protocols/mix.py"]


def test_a_lab_may_keep_its_workcells_in_a_folder(tmp_path: Path) -> None:
    write(
        tmp_path,
        workcells__cell_dot_yaml=CELL,
        apps__growth__rpl__flow_dot_yaml="",
        parts__seal_dot_yaml="name: s",
    )
    deep = tmp_path / "apps" / "growth" / "rpl"
    assert find_lab_folder(deep) == tmp_path
    assert FileFinder({}, [deep]).find("../../../parts/seal.yaml").content == b"name: s"
    assert FileFinder({}, [deep]).find("../../../../secret").problem == "lies outside the workflow's folder"
    (deep / "below").mkdir()
    assert find_lab_folder(deep / "below") == deep / "below", "three folders above at the most"
    (tmp_path / "workcells" / "cell.yaml").write_text("no: workcell\n")
    assert find_lab_folder(deep) == deep

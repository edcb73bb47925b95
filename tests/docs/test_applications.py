"""The page about applications and the notebooks, carried out from the first line to the last."""

from __future__ import annotations

import contextlib
import io
import json
from pathlib import Path

import pytest

from tests.docs.markdown import DOCS, blocks
from tests.docs.test_tutorial import check_output
from tests.support.reading import CELL, WORKFLOW, open_reading_lab

PAGE = DOCS / "applications.md"
NOTEBOOKS = sorted((DOCS / "notebooks").glob("*.ipynb"))


def test_the_page_does_what_it_says(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("LABOS_URL", raising=False)
    files = {block.title: block.text for block in blocks(PAGE.read_text()) if block.title}
    assert {name: text.strip() for name, text in files.items()} == {
        "cell.yaml": CELL.strip(),
        "read.yaml": WORKFLOW.strip(),
    }
    names: dict[str, object] = {"__name__": "application"}
    said, ran = io.StringIO(), 0
    with open_reading_lab(tmp_path):
        for block in blocks(PAGE.read_text()):
            where = f"{PAGE.name}:{block.line}"
            if block.language == "python":
                said = io.StringIO()
                with contextlib.redirect_stdout(said):
                    exec(compile(block.text, where, "exec"), names)
                ran += 1
            elif block.language == "text":
                check_output(block.text, said.getvalue(), where)
    assert ran == 7


@pytest.mark.slow
@pytest.mark.parametrize("notebook", NOTEBOOKS, ids=lambda path: path.stem)
def test_notebooks_run(notebook: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    nbclient, nbformat = pytest.importorskip("nbclient"), pytest.importorskip("nbformat")
    monkeypatch.setenv("IPYTHONDIR", str(tmp_path / "ipython"))
    read = nbformat.read(notebook, as_version=4)
    with open_reading_lab(tmp_path):
        nbclient.NotebookClient(read, timeout=60, resources={"metadata": {"path": str(tmp_path)}}).execute()
    assert any(cell.get("outputs") for cell in read.cells)


@pytest.mark.parametrize("notebook", NOTEBOOKS, ids=lambda path: path.stem)
def test_notebooks_keep_no_outputs(notebook: Path) -> None:
    cells = [cell for cell in json.loads(notebook.read_text())["cells"] if cell["cell_type"] == "code"]
    assert cells
    assert [cell for cell in cells if cell["outputs"] or cell["execution_count"] is not None] == []

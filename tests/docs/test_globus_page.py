"""The page about Globus: its program runs with Globus' SDK against the stand-in, and prints what is said."""

from __future__ import annotations

import contextlib
import io
import sys
from pathlib import Path

import pytest

from labos.bootstrap import LabThread, descriptions
from labos.settings import Settings
from labos.spec import find_spec, load_workcell
from tests.docs.markdown import DOCS, blocks

PAGE = DOCS / "globus.md"
ANALYSIS = """
def fit(values):
    return {"mean": round(sum(values) / len(values), 6)}
"""


@pytest.mark.slow
def test_the_page_does_what_it_says(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    sdk = pytest.importorskip("globus_sdk")
    pytest.importorskip("globus_compute_sdk")
    from tests.support.globus import TOKEN, serve

    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))
    (tmp_path / "our_analysis.py").write_text(ANALYSIS)
    found = list(blocks(PAGE.read_text()))
    (program,) = (block.text for block in found if block.language == "python")
    (printed,) = (block.text for block in found if block.language == "text")
    (app,) = (line for line in program.splitlines() if line.startswith("access = "))
    cell = load_workcell(find_spec("workcells", "rpl"), descriptions())
    settings = Settings.make(tmp_path / "lab", speed=5000.0, simulate=True)
    said = io.StringIO()
    with LabThread(settings, [cell], nodes="none"), serve() as (globus, url):
        globus.files["55555555-0000-4000-8000-000000000000", "/plates/p1.csv"] = b"well,value\nA1,0.5\n"
        access = {"authorizer": sdk.AccessTokenAuthorizer(TOKEN), "base_url": url}
        program = program.replace(app, "")
        with contextlib.redirect_stdout(said):
            exec(compile(program, PAGE.name, "exec"), {"__name__": "application", "access": access})
    sys.modules.pop("our_analysis", None)
    assert said.getvalue().strip() == printed.strip()
    assert (len(globus.executed), len(globus.runs), len(globus.transfers), len(globus.entries)) == (
        1,
        1,
        1,
        1,
    )

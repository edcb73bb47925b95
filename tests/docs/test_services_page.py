"""The program on the page about computations runs, and the page names what the log says."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

from labos.bootstrap import LabThread, descriptions
from labos.client import LabClient
from labos.settings import Settings
from labos.spec import find_spec, load_workcell

PAGE = Path(__file__).parents[2] / "docs" / "services.md"
ANALYSIS = """
def fit(values):
    return {"mean": sum(values) / len(values)}

def read_wells(name):
    return [name]
"""


def test_the_page_holds(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    page = PAGE.read_text()
    (program,) = re.findall(r"```python\n(.*?)```", page, re.DOTALL)
    (tmp_path / "our_analysis.py").write_text(ANALYSIS)
    imports, _, rest = program.partition("\n\n")
    guarded = "".join(f"    {line}\n" for line in rest.splitlines())
    (tmp_path / "growth.py").write_text(f'{imports}\n\nif __name__ == "__main__":\n{guarded}')
    cell = load_workcell(find_spec("workcells", "rpl"), descriptions())
    settings = Settings.make(tmp_path / "lab", speed=5000.0, simulate=True)
    with LabThread(settings, [cell], nodes="none") as running, LabClient(running.url) as client:
        done = subprocess.run(
            [sys.executable, "growth.py"], cwd=tmp_path, capture_output=True, text=True, check=False
        )
        assert done.returncode == 0, done.stderr
        notes = [event["payload"] for event in client.events(type="experiment.noted")]
    assert sorted(note["name"] for note in notes) == ["our_analysis.fit", *["our_analysis.read_wells"] * 2]
    told = {fact for note in notes for fact in note["facts"]}
    assert told <= set(re.findall(r"`(\w+)`", page))

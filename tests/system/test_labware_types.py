"""A labware type of the lab's own: defined in a file, checked, kept by the log when the file is gone."""

from __future__ import annotations

from pathlib import Path

import pytest

from labos.bootstrap import LabThread, descriptions
from labos.client import LabClient
from labos.errors import BadInput, NotFound, Refused
from labos.settings import Settings
from labos.spec import load_workcell
from tests.support.lab_process import labos

SIX = """\
labos: 1
labware:
  six_well:
    footprint: {length_mm: 127.76, width_mm: 85.48, height_mm: 20}
    wells: {rows: 2, columns: 3, pitch_mm: 39.1, volume_ul: 16000}
    stackable: false
"""

CELL = """\
labos: 1
name: corner
labware: [plates]
modules:
  - {name: hidex, model: Hidex}
  - {name: stacker, model: sciclops}
stock:
  hidex.default: {six_well: 1}
"""


def sheet(folder: Path, rows: str) -> Path:
    path = folder / "sheet.csv"
    path.write_text(f"well,sample,volume\n{rows}")
    return path


def test_a_type_of_the_labs_own_is_known_to_the_lab(tmp_path: Path) -> None:
    home, file = tmp_path / "lab", tmp_path / "corner.yaml"
    types = tmp_path / "plates" / "six.yaml"
    types.parent.mkdir()
    types.write_text(SIX)
    file.write_text(CELL)
    settings = Settings.make(home, simulate=True, speed=5000.0)
    with (
        LabThread(settings, [load_workcell(file, descriptions())]) as running,
        LabClient(running.url) as client,
    ):
        with pytest.raises(BadInput, match=r"There is no well D1 on a six_well\. Its wells are A1 to B3\."):
            client.load_samples(sheet(tmp_path, "D1,yeast,1\n"), "ada", labware="P1")
        with pytest.raises(NotFound, match="Did you mean 'six_well'"):
            client.place("stacker.tower1", "six_wel", "ada")
        with pytest.raises(Refused, match="does not accept six_well: one may not stand upon another"):
            client.place("stacker.tower1", "six_well", "ada")
        # A change of the labware file alone is a change of the workcell, and goes along with its text.
        types.write_text(SIX.replace("16000", "3000") + SIX.split("labware:\n")[1].replace("six_", "own_"))
        apply = ("workcell", "apply", str(file), "--home", str(home))
        shown = labos(*apply, "--dry-run")
        towers = "".join(f"~ station stacker.tower{n}\n" for n in range(1, 6))  # they take neither
        assert shown.stdout == f"{towers}+ labware own_well\n~ labware six_well\n", shown.stderr
        done = labos(*apply, "--yes")
        assert done.stdout.endswith("corner is changed.\n"), done.stderr
        again = labos(*apply, "--yes")
        assert again.stdout == "corner agrees with the file.\n", again.stderr
        slip = tmp_path / "slip.yaml"
        slip.write_text(f"{CELL}stations: {{stacker.lidnest1: {{accepts: [six_wel]}}}}\n")
        told = labos(*apply[:2], str(slip), "--dry-run", *apply[3:]).stderr
        assert f"{slip}:9:41: stations.stacker.lidnest1.accepts[0]: Nobody describes" in told
        assert "Did you mean 'six_well'?" in told
        types.write_text(SIX.replace("rows: 2", "rows: 0"))
        faulty = labos(*apply, "--yes")
        assert (faulty.returncode, f"{types}:5:19:" in faulty.stderr) == (1, True), faulty.stderr
    types.unlink()
    file.unlink()
    with LabThread(settings, []) as running, LabClient(running.url) as client:
        with pytest.raises(BadInput, match="A well of a six_well holds 3000 µL"):
            client.load_samples(sheet(tmp_path, "A1,yeast,4000\n"), "ada", labware="P1")
        client.place("stacker.exchange", "own_well", "ada")
        assert client.load_samples(sheet(tmp_path, "B3,yeast,1\n"), "ada", labware="P1") == {"P1": 1}

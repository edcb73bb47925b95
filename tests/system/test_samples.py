"""Samples in, results out: a plate with a sheet goes through a reader, on real processes."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Iterator
from pathlib import Path

import pytest

from labos.bootstrap import LabThread, descriptions
from labos.client import LabClient
from labos.errors import BadInput, LabosError, NotFound, Refused
from labos.settings import Settings
from labos.spec import load_workcell
from tests.support.lab_process import PATIENCE_S, labos

CELL = """\
labos: 1
name: corner
modules:
  - {name: hidex, model: Hidex}
  - {name: camera, model: camera}
stock:
  hidex.default: {plate96: 1}
"""

READ = """\
labos: 1
name: read
workcell: corner
modules: [hidex]
steps:
  - {name: Close, module: hidex, action: close_lid}
  - {name: Read, module: hidex, action: read_plate, args: {assay_name: OD}}
  - {name: Open, module: hidex, action: open_lid}
"""


@pytest.fixture(scope="module")
def home(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("lab")


@pytest.fixture(scope="module")
def lab(home: Path) -> Iterator[LabThread]:
    (home / "corner.yaml").write_text(CELL)
    (home / "read.yaml").write_text(READ)
    cell = load_workcell(home / "corner.yaml", descriptions())
    with LabThread(Settings.make(home, speed=5000.0, simulate=True), [cell]) as running:
        yield running


@pytest.fixture
def client(lab: LabThread) -> Iterator[LabClient]:
    with LabClient(lab.url) as found:
        yield found


def sheet(folder: Path, text: str) -> Path:
    path = folder / "sheet.csv"
    path.write_text(text)
    return path


def test_a_faulty_sheet_leaves_no_trace(client: LabClient, home: Path, tmp_path: Path) -> None:
    path = sheet(tmp_path, "plate,well,sample\nP1,A1,x\nP1,A1,y\nP1,I9,z\nP8,A1,x\n")
    before = client.health()["position"]
    with pytest.raises(BadInput) as found:
        client.load_samples(path, "ada")
    for told in (
        f"{path}:3:4: well: The well A1 of P1 is listed twice",
        f"{path}:4:4: well: There is no well I9 on a plate96.",
        f"{path}:5:1: plate: No labware 'P8' stands on the bench.",
    ):
        assert told in str(found.value)
    assert client.health()["position"] == before
    done = labos("samples", "load", str(path), "--plate", "P1", "--home", str(home))
    assert done.returncode == 1
    assert f"{path}:4:4:" in done.stderr


def test_samples_meet_their_values(client: LabClient, home: Path, tmp_path: Path) -> None:
    nothing = sheet(tmp_path, "well,sample\nA1,x\n")
    with pytest.raises(BadInput, match="The plate is missing"):
        client.load_samples(nothing, "ada")
    with pytest.raises(Refused, match="No labware with a name stands at camera"):
        client.load_samples(nothing, "ada", station="camera.plate_station")
    with pytest.raises(NotFound, match="P9"):
        client.load_samples(nothing, "ada", labware="P9")
    text = "well,sample,volume,unit\nA1,code-17,0.1,mL\nH12,water,90,\n"
    done = labos(
        *("samples", "load", str(sheet(tmp_path, text)), "--station", "hidex.default"),
        *("--user", "ada", "--home", str(home)),
    )
    assert (done.returncode, done.stdout) == (0, "P1 holds 2 samples.\n"), done.stderr
    other = sheet(tmp_path, "well,sample\nA1,x\n")
    with pytest.raises(LabosError, match="registered from another sheet"):
        client.load_samples(other, "ada", labware="P1")

    shown = labos("samples", "show", "P1", "--csv", "--home", str(home))
    assert shown.stdout == "plate,well,sample,volume,unit\nP1,A1,code-17,100,uL\nP1,H12,water,90,uL\n"
    facts = json.loads(labos("samples", "show", "P1", "--json", "--home", str(home)).stdout)
    assert (facts["by"], facts["samples"][0]["sample"]) == ("ada", "code-17")
    assert labos("samples", "show", "P2", "--home", str(home)).returncode == 1

    run = client.submit(home / "read.yaml", user="ada")
    assert client.wait(run, timeout_s=PATIENCE_S).status == "completed"
    written = labos("results", run, "--csv", "--home", str(home))
    assert written.returncode == 0, written.stderr
    rows = {row["well"]: row for row in csv.DictReader(io.StringIO(written.stdout))}
    assert len(rows) == 96
    first = rows["A1"]
    assert [first[name] for name in ("run", "step", "plate", "sample", "quantity", "unit")] == [
        *(run, "Read", "P1", "code-17", "absorbance", "OD")
    ]
    assert float(first["value"]) > 0
    assert first["time"].endswith("Z")
    assert (rows["H12"]["sample"], rows["B2"]["sample"]) == ("water", "")
    (event,) = client.events(type="labware.samples_registered")
    assert event["payload"]["count"] == 2


def test_a_large_sheet_is_a_blob(client: LabClient, home: Path, tmp_path: Path) -> None:
    wells = [f"{row}{column}" for row in "ABCDEFGH" for column in range(1, 13)]
    text = "well,sample\n" + "".join(f"{well},{well}-{'x' * 180}\n" for well in wells)
    client.load_samples(sheet(tmp_path, text), "ada", labware="P1", replace=True)
    *_, event = client.events(type="labware.samples_registered")
    assert event["payload"]["wells"] == []
    assert len(event["payload"]["blob"]) == 64
    facts = json.loads(labos("samples", "show", "P1", "--json", "--home", str(home)).stdout)
    assert len(facts["samples"]) == 96
    assert facts["samples"][95]["sample"].startswith("H12-xxx")

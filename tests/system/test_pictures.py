"""A picture goes from a camera to the lab, on real processes: a file of the result, with the label that
stands on it."""

from __future__ import annotations

from pathlib import Path

import pytest

from labos.bootstrap import LabThread, descriptions
from labos.client import LabClient
from labos.settings import Settings
from labos.spec import load_workcell
from labos.store import FolderBlobs
from tests.support.lab_process import PATIENCE_S

pytest.importorskip("cv2", reason="OpenCV is not installed (it is with the extra `camera`)")

CELL = """\
labos: 1
name: corner
modules: [{name: camera, model: camera}]
stock:
  camera.plate_station: {plate96: 1}
"""

LOOK = """\
labos: 1
name: look
workcell: corner
modules: [camera]
steps:
  - {name: Read, module: camera, action: read_barcode}
  - {name: Look, module: camera, action: take_picture, args: {file_name: plate.png, rotation: 180}}
"""


def test_a_picture_is_a_file_of_the_lab(tmp_path: Path) -> None:
    from labos_drivers.camera import vision

    (tmp_path / "corner.yaml").write_text(CELL)
    workflow = tmp_path / "look.yaml"
    workflow.write_text(LOOK)
    home = tmp_path / "lab"
    cell = load_workcell(tmp_path / "corner.yaml", descriptions())
    settings = Settings.make(home, speed=100.0, simulate=True, wire=True)
    with LabThread(settings, [cell]) as lab, LabClient(lab.url) as client:
        run = client.submit(workflow, user="ada")
        done = client.wait(run, timeout_s=PATIENCE_S)
        assert done.status == "completed", done
        told = done.result("Look")
        barcode = done.result("Read")["barcode"]
        (plate,) = client.state()["labware"]
        assert plate["barcode"] == barcode
    assert told["file"] == "plate.png"
    data = FolderBlobs(home / "blobs").get(told["sha256"])
    assert data is not None
    assert len(data) == told["bytes"]
    picture = vision.decode(data)
    assert vision.read_label(picture) == barcode
    assert vision.is_occupied(picture) is True

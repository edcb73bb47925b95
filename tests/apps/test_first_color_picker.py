"""The first colour picker where a node dies at work."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from labos.client import LabClient
from labos.spec.library import find_specs_folder
from tests.apps.conftest import OpenLab
from tests.apps.support import notes, until_clean

APP = find_specs_folder() / "apps" / "first_color_picker.py"
SPEED = 60.0
"""A picture takes 83 ms then: time enough to kill the camera's node meanwhile."""

PATIENCE_S = 120.0


@pytest.mark.slow
@pytest.mark.timeout(300)
def test_it_goes_on_without_a_picture_that_nobody_has(open_lab: OpenLab, tmp_path: Path) -> None:
    with open_lab("rpl", SPEED) as lab, LabClient(lab.url) as client:
        app = subprocess.Popen(
            [sys.executable, str(APP), "--url", lab.url, "--rounds", "4"],
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
        )
        try:
            kill_camera_at_work(client, tmp_path / "lab", app)
            (question,) = client.state()["interventions"]
            client.resolve(question["id"], "done", "ada")
            said, _ = app.communicate(timeout=PATIENCE_S)
        finally:
            app.kill()
        until_clean(client)
        rounds, missing = (
            notes(client, "colors of the wells"),
            notes(client, "no picture: the same mixtures again"),
        )
    assert app.returncode == 0, said
    assert said.startswith("color picker: nearest ")
    assert len(missing) == 1
    assert rounds
    assert all(found["picture"] for found in rounds)


def kill_camera_at_work(client: LabClient, home: Path, app: subprocess.Popen[str]) -> None:
    """Kill the camera's node while it takes a picture, until the outcome of one is unknown."""
    for _ in iterate_accepted(client, "rpl/camera_module", app):
        note = json.loads((home / "nodes" / "rpl.camera_module.json").read_text())
        os.kill(note["pid"], signal.SIGKILL)
        while True:
            ended = [e["type"] for e in client.events() if e["type"].startswith("action.")][-1]
            if ended == "action.unknown" and client.state()["interventions"]:
                return
            if ended != "action.accepted" and ended != "action.unknown":
                break  # the picture was taken before
            time.sleep(0.02)


def iterate_accepted(client: LabClient, module: str, app: subprocess.Popen[str]) -> Iterator[Any]:
    """The actions of a module, each when its node has accepted it."""
    after, give_up = 0, time.monotonic() + PATIENCE_S
    while app.poll() is None:
        assert time.monotonic() < give_up, "the camera was not asked for a picture"
        for event in client.events(after):
            after = event["position"]
            if event["type"] == "action.accepted" and event["payload"]["module"] == module:
                yield event
        time.sleep(0.005)

"""Barcodes on real processes: read, found, contradicted by plates that a person has swapped."""

from __future__ import annotations

import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from labos.bootstrap import LabThread, descriptions
from labos.client import LabClient
from labos.settings import Settings
from labos.spec import load_workcell
from tests.integration.notify.servers import Hook, web_server
from tests.support.lab_process import PATIENCE_S, labos, until

CELL = """\
labos: 1
name: corner
modules: [{name: camera, model: camera}]
stations:
  wc.shelf: {kind: nest}
stock:
  camera.plate_station: {plate96: 1}
  wc.shelf: {plate96: 1}
"""

READ = """\
labos: 1
name: read
workcell: corner
modules: [camera]
steps:
  - {name: Read, module: camera, action: read_barcode}
  - {name: Look, module: camera, action: grab_image}
"""


@contextmanager
def _set_webhook(home: Path, url: str) -> Iterator[None]:
    """The lab of this folder tells people by a webhook."""
    (home / "contacts.yaml").write_text(f'contacts: {{duty: {{webhook: "{url}"}}}}\n')
    yield


def test_swapped_plates_are_noticed_and_put_right(tmp_path: Path) -> None:
    home = tmp_path / "lab"
    (tmp_path / "corner.yaml").write_text(CELL)
    workflow = tmp_path / "read.yaml"
    workflow.write_text(READ)

    def find_labware(barcode: str) -> list[dict[str, Any]]:
        done = labos("labware", "--barcode", barcode, "--json", "--home", str(home))
        assert done.returncode == 0, done.stderr
        stories: list[dict[str, Any]] = json.loads(done.stdout)
        return stories

    cell = load_workcell(tmp_path / "corner.yaml", descriptions())
    hook = Hook()
    home.mkdir()
    with (
        web_server(hook) as url,
        _set_webhook(home, url),
        LabThread(Settings.make(home, speed=5000.0, simulate=True), [cell]) as lab,
        LabClient(lab.url) as client,
    ):
        run = client.submit(workflow, user="ada")
        assert client.wait(run, timeout_s=PATIENCE_S).status == "completed"
        here = next(item for item in client.state()["labware"] if item["station"].startswith("camera"))
        code = here["barcode"]
        assert [story["id"] for story in find_labware(code)] == [here["id"]]
        other = next(item["id"] for item in client.state()["labware"] if item["id"] != here["id"])
        world = lab.runtime.world("corner")
        (first,), (second,) = world.at("camera.plate_station"), world.at("wc.shelf")
        named = labos("barcode", other, world.barcode(second), "--home", str(home))
        assert named.returncode == 0, named.stderr
        taken = labos("barcode", other, code, "--home", str(home))
        assert taken.returncode == 1
        assert f"{here['id']} already has the barcode {code}." in taken.stderr

        world.carry(first, "")
        world.carry(second, "camera.plate_station")
        world.carry(first, "wc.shelf")
        run = client.submit(workflow, user="ada")
        questions = until(lambda: client.state(waits=False)["interventions"], "a person is asked")
        assert questions[0]["kind"] == "barcode"
        assert f"{world.barcode(second)} is the barcode of {other}" in questions[0]["text"]
        # The kernel's own notifier has told of it.
        told = until(lambda: hook.bodies, "somebody is told")[0]
        assert told["title"] == f"{questions[0]['id']}: the lab asks you"
        assert told["lab_name"] == "lab, simulated"
        assert "labos resolve" in told["text"]
        waits = until(
            lambda: next(r for r in client.state()["runs"] if r["id"] == run)["waits"], "the run waits"
        )
        assert "camera.plate_station" in waits[0]["why"]
        done = labos("resolve", questions[0]["id"], "swapped", "--home", str(home))
        assert done.returncode == 0, done.stderr
        places = {item["id"]: item["station"] for item in client.state()["labware"]}
        assert places == {here["id"]: "wc.shelf", other: "camera.plate_station"}
        client.cancel(run, "ada")
    assert find_labware(code)[0]["stays"][-1]["places"] == ["corner/wc.shelf"]
    assert labos("labware", "--barcode", "nobody's", "--home", str(home)).returncode == 1

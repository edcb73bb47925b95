"""A lab whose instruments stand behind their wires: real drivers, real processes, simulated devices."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from labos.bootstrap import LabThread, descriptions
from labos.client import LabClient
from labos.core.ids import ModuleName
from labos.link import read_transcript
from labos.node import World
from labos.settings import Settings
from labos.spec import load_workcell
from tests.support.lab_process import Up, labos, statuses, until
from tests.support.processes import run_process

SPECS = Path(__file__).parents[2] / "specs"

CELL = """\
labos: 1
name: corner
modules:
  - {name: sealer, model: a4s_sealer}
"""

WORKFLOW = """\
labos: 1
name: seal
steps:
  - {name: Seal, module: sealer, action: seal, args: {time: 2.5, temperature: 170}}
"""


@pytest.mark.timeout(120)
def test_a_plate_is_sealed_over_a_wire(tmp_path: Path) -> None:
    (tmp_path / "corner.yaml").write_text(CELL)
    (tmp_path / "wf.yaml").write_text(WORKFLOW)
    home = tmp_path / "lab"
    cell = load_workcell(tmp_path / "corner.yaml", descriptions())
    settings = Settings.make(home, speed=100.0, simulate=True, wire=True)
    with LabThread(settings, [cell], nodes="none") as lab, LabClient(lab.url) as client:
        assert "--wire" in lab.runtime._make_argv(ModuleName("corner/sealer"), detach=False)
        node = start_node("sealer", home, tmp_path)
        try:
            until(
                lambda: {m["status"] for m in client.state(waits=False)["modules"]} == {"IDLE"},
                "an idle node",
            )
            placed = ("--place", "sealer.default=plate96")
            done = labos("run", str(tmp_path / "wf.yaml"), *placed, "--home", str(home))
            assert done.returncode == 0, done.stdout + done.stderr
        finally:
            assert end(node) == 0
    world = World(str(settings.world("corner")))
    done_to = [(m.verb, m.device, m.facts) for m in world.motions() if m.verb == "seal"]
    assert done_to == [
        ("seal", "sealer", {"time_s": 2.5, "temperature_c": 170}),
    ]
    assert world.crashes() == []
    world.close()
    assert read_sent(tmp_path / "sealer.txt").endswith(b"*00DT=0025zz!*00DH=0170zz!*00GS=zz!")


@pytest.mark.full
@pytest.mark.timeout(900)
def test_pcr_and_color_picker_behind_their_wires(tmp_path: Path) -> None:
    """All instruments of the workcell are driven by their real drivers."""
    up = Up(tmp_path / "lab", "--simulate", "--wire", "--speed", "100")
    app = [sys.executable, str(SPECS / "apps" / "first_color_picker.py"), "--home", str(up.home)]
    try:
        up.start("rpl")
        with up.client() as client, run_process(app, stdout=subprocess.PIPE, text=True) as picker:
            pcr = client.submit("pcr", user="ada")
            assert picker.wait(600) == 0, up.read_log()
            until(lambda: statuses(client, [pcr]) == ["completed"], "the PCR is done", 600)
        assert up.interrupt() == 0
        assert up.disagreements() == []
        assert up.motions("crash") == []
        for verb in ("pipette", "seal", "cycle", "peel", "picture", "discard"):
            assert up.motions(verb), verb
        assert {"action.failed", "action.unknown"}.isdisjoint(up.types())
    finally:
        up.clean_up()


def start_node(name: str, home: Path, talks: Path) -> subprocess.Popen[bytes]:
    return subprocess.Popen(
        [
            *(sys.executable, "-m", "labos", "node", "start", "--name", name, "--workcell", "corner"),
            *("--simulate", "--wire", "--trace", str(talks / f"{name}.txt")),
            *("--home", str(home), "--with-parent"),
        ],
        stdin=subprocess.PIPE,
    )


def end(node: subprocess.Popen[bytes]) -> int:
    assert node.stdin is not None
    node.stdin.close()
    return node.wait(30)


def read_sent(transcript: Path) -> bytes:
    return b"".join(record.data for record in read_transcript(transcript) if record.mark == ">")

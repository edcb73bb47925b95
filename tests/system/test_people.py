"""People as modules, in real processes: the inbox, killed nodes and kernels, twice the same word."""

from __future__ import annotations

import json
import os
import signal
from collections.abc import Iterator
from pathlib import Path

import pytest

from labos.node.world import World
from tests.simulation.test_people import PERSON, RPL
from tests.support.cells import PCR
from tests.support.lab_process import Up, labos, statuses, until

WORKFLOW = """
name: by hand
flowdef:
  - {name: take, module: sciclops, action: get_plate, args: {loc: tower1}}
  - name: carry
    module: operator
    action: carry_plate
    args: {source: sciclops.exchange, target: camera_module.plate_station, within: 5}
  - {name: look, module: operator, action: do, args: {instruction: check it}}
  - name: away
    module: pf400
    action: transfer
    args: {source: camera_module.plate_station, target: wc.trash}
"""


@pytest.fixture
def lab(tmp_path: Path) -> Iterator[Up]:
    (tmp_path / "cell.yaml").write_text(RPL.replace("modules:\n", PERSON, 1))
    (tmp_path / "by_hand.yaml").write_text(WORKFLOW)
    up = Up(tmp_path / "lab", "--simulate", "--speed", "500")
    yield up
    up.clean_up()


def inbox(lab: Up) -> list[dict[str, object]]:
    done = labos("inbox", "--json", "--home", str(lab.home))
    assert done.returncode == 0, done.stderr
    found: list[dict[str, object]] = json.loads(done.stdout)
    return found


def confirm(lab: Up, entry: dict[str, object], *options: str) -> int:
    argv = ("confirm", str(entry["id"]), "--user", "ada", "--home", str(lab.home), *options)
    return labos(*argv).returncode


def carry(lab: Up, source: str, target: str) -> None:
    """Do it on the simulated bench."""
    world = World(str(lab.home / "world" / "rpl.db"))
    world.grip("operator", source)
    world.release("operator", target)
    world.close()


def test_planned_work_outlives_its_node_and_its_kernel(lab: Up, tmp_path: Path) -> None:
    lab.start(str(tmp_path / "cell.yaml"))
    with lab.client() as client:
        run = client.submit(tmp_path / "by_hand.yaml", user="ada")
        entry = until(lambda: inbox(lab), "somebody is asked")[0]
        until(lambda: "action.accepted" in lab.types()[-6:] or inbox(lab)[0]["overdue"], "it is under way")
        assert until(lambda: inbox(lab)[0]["overdue"], "it is late")

        def operator() -> int:
            modules = client.state(waits=False)["modules"]
            found = next(m for m in modules if m["name"] == "rpl/operator")
            return found["process"]["pid"] if found["status"] != "GONE" else 0

        before = until(operator, "the node is there")
        os.kill(before, signal.SIGKILL)
        until(lambda: operator() not in (0, before), "its node is back")
    lab.kill()
    lab.options = ()
    lab.start()
    with lab.client() as client:
        assert [e["id"] for e in inbox(lab)] == [entry["id"]]
        until(lambda: operator_there(client), "its node is back")
        carry(lab, "sciclops.exchange", "camera_module.plate_station")
        assert confirm(lab, entry, "--why", "there you are") == 0
        assert confirm(lab, entry) == 1  # once is enough
        second = until(lambda: inbox(lab), "somebody is asked again")[0]
        assert "check it" in str(second["text"])
        assert confirm(lab, second, "--result", '{"fine": true}') == 0
        assert statuses(client, [run]) == ["completed"]
    twh = json.loads(labos("twh", "--json", "--home", str(lab.home)).stdout)["scopes"]
    assert {(s["planned"], s["interventions"]) for s in twh if s["kind"] == "run"} == {(2, 0)}
    assert lab.interrupt() == 0
    assert lab.disagreements() == []
    assert "action.unknown" not in lab.types()


def operator_there(client: object) -> bool:
    modules = client.state(waits=False)["modules"]  # type: ignore[attr-defined]
    return any(m["name"] == "rpl/operator" and m["status"] != "GONE" for m in modules)


def test_what_cannot_be_done_ends_the_run(lab: Up, tmp_path: Path) -> None:
    lab.start(str(tmp_path / "cell.yaml"))
    with lab.client() as client:
        run = client.submit(tmp_path / "by_hand.yaml", user="ada")
        entry = until(lambda: inbox(lab), "somebody is asked")[0]
        assert confirm(lab, entry, "--not-done", "--why", "no hands") == 0
        assert statuses(client, [run]) == ["failed"]
    assert lab.interrupt() == 0
    assert lab.disagreements() == []


def test_a_person_reaches_in_and_the_lab_goes_on(lab: Up) -> None:
    lab.start_with(*PCR)
    home = ("--home", str(lab.home))
    with lab.client() as client:
        run = client.submit("pcr", user="ada")
        until(lambda: "action.succeeded" in lab.types(), "something was done")
        entered = labos("access", "rpl", "--why", "oil", "--json", *home)
        assert entered.returncode == 0, entered.stderr
        told = json.loads(entered.stdout)
        assert (told["granted"], len(told["parking"])) == (True, 1)  # of the arms, sciclops has a home
        types = lab.types()
        assert "run.started" in types[: types.index("workcell.access_granted")]
        assert labos("access", "rpl", "--user", "bo", *home).returncode == 1
        held = labos("explain", run, *home).stdout
        assert "reaches into the workcell rpl" in held
        assert "labos access rpl --done" in held
        world = World(str(lab.home / "world" / "rpl.db"))
        world.stock("wc.output.14", "plate96")
        world.close()
        wrong = labos("access", "rpl", "--done", "--changed", "wc.output.14=nonsense", *home)
        assert (wrong.returncode, "nonsense" in wrong.stderr) == (1, True)
        unsaid = labos("access", "rpl", "--done", "--changed", "wc.output=plate96", *home)
        assert (unsaid.returncode, "Name the shelf" in unsaid.stderr) == (1, True)
        left = labos("access", "rpl", "--done", "--changed", "wc.output.14=plate96", *home)
        assert left.returncode == 0, left.stderr
        assert statuses(client, [run]) == ["completed"]
        output = next(s for s in client.state()["stations"] if s["name"] == "rpl/wc.output")
        assert len(output["labware"]) == 2  # what the person left there, and what the run brought
    assert lab.interrupt() == 0


def test_on_the_first_day_people_say_what_stands_on_the_bench(tmp_path: Path) -> None:
    up = Up(tmp_path / "real", "--real", "--no-nodes")
    try:
        up.start("rpl")
        home = ("--home", str(up.home))
        wrong = labos("bench", "declare", "wc.output=plate96", "sealer.default=nonsense", *home)
        assert wrong.returncode == 1
        assert "station.declared" not in up.types()  # all of it or nothing
        (tmp_path / "bench.yaml").write_text("camera_module.plate_station: plate96\nsealer.default:\n")
        argv = ("bench", "declare", str(tmp_path / "bench.yaml"), "sciclops.tower1=3xplate96", "--empty")
        done = labos(*argv, "--json", *home)
        assert done.returncode == 0, done.stderr
        told = json.loads(done.stdout)
        assert told["sciclops.tower1"] == ["plate96"] * 3
        assert told["camera_module.plate_station"] == ["plate96"]
        assert told["sealer.default"] == told["hidex.default"] == []
        again = labos("bench", "declare", "--empty", *home)
        assert again.stdout == "All stations were declared before.\n"
        assert up.interrupt() == 0
    finally:
        up.clean_up()


def test_a_workcell_is_changed_while_its_lab_runs(lab: Up, tmp_path: Path) -> None:
    lab.start("rpl")
    home = ("--home", str(lab.home))
    with lab.client() as client:

        def nodes() -> dict[str, str]:
            return {m["name"]: m["status"] for m in client.state(waits=False)["modules"]}

        until(lambda: "GONE" not in nodes().values(), "all nodes are there")
        cell = str(tmp_path / "cell.yaml")
        shown = labos("workcell", "apply", cell, "--dry-run", *home)
        assert shown.returncode == 0, shown.stderr
        assert "+ module operator" in shown.stdout
        assert "rpl/operator" not in nodes()
        assert labos("workcell", "apply", cell, "--yes", *home).returncode == 0
        until(lambda: nodes().get("rpl/operator") == "IDLE", "the new node is there")
        (tmp_path / "patient.yaml").write_text(
            RPL.replace("name: sealer\n", "name: sealer\n    timeout: 5 min\n    retry: {times: 2}\n")
        )
        patient = labos("workcell", "apply", str(tmp_path / "patient.yaml"), "--dry-run", *home)
        retry = "retry: none → times 2, delay_s 0.0, reset no"
        assert f"~ module sealer ({retry}; timeout_s: none → 300.0)" in patient.stdout, patient.stderr
        # And back: what is needed stays, what is free goes, and its node with it.
        run = client.submit(tmp_path / "by_hand.yaml", user="ada")
        entry = until(lambda: inbox(lab), "somebody is asked")[0]
        (tmp_path / "rpl.yaml").write_text(RPL)
        back = ("workcell", "apply", str(tmp_path / "rpl.yaml"), "--yes")
        refused = labos(*back, *home)
        assert (refused.returncode, "operator is at work" in refused.stderr) == (1, True)
        assert confirm(lab, entry, "--not-done") == 0
        assert statuses(client, [run]) == ["failed"]
        pid = next(m for m in client.state()["modules"] if m["name"] == "rpl/operator")["process"]["pid"]
        assert labos(*back, *home).returncode == 0
        assert "rpl/operator" not in nodes()
        until(lambda: not Path(f"/proc/{pid}").exists(), "its node has ended")
    assert lab.interrupt() == 0, lab.read_log()


def test_an_arm_is_taught_a_station(lab: Up) -> None:
    lab.start_with("sciclops", "pf400", "sealer")
    home = ("--home", str(lab.home))
    with lab.client() as client:

        def arm() -> int:
            found = next(m for m in client.state(waits=False)["modules"] if m["name"] == "rpl/pf400")
            return found["process"]["pid"] if found["status"] == "IDLE" else 0

        before = until(arm, "the arm is there")
        known = json.loads(labos("locations", "pf400", "--json", *home).stdout)
        pose = [value + 0.5 for value in known["sealer.default"]["pose"]]
        told = ",".join(map(str, pose))
        taught = labos("teach", "pf400", "sealer.default", "--pose", told, "--why", "moved", *home)
        assert taught.stdout == "pf400 now reaches sealer.default with version 1 of the pose.\n", (
            taught.stderr
        )
        short = labos("teach", "pf400", "sealer.default", "--pose", "1,2", *home)
        assert short.returncode == 1
        now = json.loads(labos("locations", "pf400", "--json", *home).stdout)["sealer.default"]
        assert now == {"pose": pose, "version": 1, "proven": False, "types": {}}
        until(lambda: arm() not in (0, before), "its node has the new pose")
    assert lab.interrupt() == 0, lab.read_log()

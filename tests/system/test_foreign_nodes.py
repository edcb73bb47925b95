"""A lab on real processes whose modules are reached by adapters, as its workcell file says."""

from __future__ import annotations

import json
import os
import signal
from collections.abc import Iterator
from pathlib import Path

import pytest

from labos.settings import free_port
from tests.integration.adapter.sealer import Sealer
from tests.support.foreign import ForeignProcess
from tests.support.lab_process import Up, labos, until
from tests.support.proxy import Proxy

CELL = """
labos: 1
name: corner
modules:
  - name: shaker
    interface: wei_rest_node
    config: {{rest_node_address: "{shaker}", poll_s: 0.2}}
    about:
      stations: {{plate: {{}}}}
      actions:
        shake:
          args: {{speed: {{type: int, minimum: 10}}, time_s: {{type: float, default: 0.2}}}}
          effects: [needs: {{}}]
          duration: 2
  - name: sealer
    model: A4S_sealer
    interface: rest_node
    config:
      rest_node_address: "{sealer}"
      rest:
        action: {{path: /action, params: {{action_handle: "{{action}}", action_vars: "{{args}}"}}}}
        outcome: {{status: status, error: error, result: data}}
        reset: {{path: /reset}}
stations:
  shaker.plate: {{independent: true}}
stock: {{sealer.default: {{plate96: 1}}, shaker.plate: {{plate96: 1}}}}
"""

FLOW = """
labos: 1
name: seal and shake
steps:
  - {name: seal, module: sealer, action: seal, args: {time: 2.0}}
  - {name: shake, module: shaker, action: shake, args: {speed: 300}}
"""

AGAIN = """
labos: 1
name: again
steps: [{name: shake, module: shaker, action: shake, args: {speed: 400}}]
"""


ALONE = """
labos: 1
name: corner
modules:
  - name: sealer
    interface: rest_node
    config:
      rest_node_address: "{sealer}"
      patience_s: 3600
      rest:
        action: {{path: /action, json: {{action_handle: "{{action}}", action_vars: "{{args}}"}}}}
        outcome: {{status: status, error: error, result: data}}
    about:
      stations: {{default: {{}}}}
      actions: {{seal: {{args: {{time: {{type: float}}}}, effects: [needs: {{}}], duration: 2}}}}
stock: {{sealer.default: {{plate96: 1}}}}
"""


@pytest.fixture
def shaker(tmp_path: Path) -> Iterator[ForeignProcess]:
    process = ForeignProcess("wei", tmp_path / "wei", free_port())
    try:
        yield process.start()
    finally:
        process.kill()


@pytest.fixture
def sealer() -> Iterator[Sealer]:
    device = Sealer()
    yield device
    device.close()


@pytest.fixture
def lab(tmp_path: Path) -> Iterator[Up]:
    up = Up(tmp_path / "lab", "--real", "--declare")
    yield up
    up.clean_up()


def test_one_workflow_on_foreign_nodes(
    shaker: ForeignProcess, sealer: Sealer, lab: Up, tmp_path: Path
) -> None:
    proxy = Proxy(shaker.port)
    cell, flow = tmp_path / "corner.yaml", tmp_path / "flow.yaml"
    cell.write_text(CELL.format(shaker=proxy.url, sealer=sealer.url))
    flow.write_text(FLOW)
    again = tmp_path / "again.yaml"
    again.write_text(AGAIN)
    said = labos("node", "about", "wei_rest_node", shaker.url)
    assert said.returncode == 0, said.stderr
    assert "speed: {type: int" in said.stdout
    lab.start(str(cell))
    with lab.client() as client:
        assert client.wait(client.submit(flow, user="ada"), timeout_s=60).status == "completed"
        assert sealer.seals == [{"time": 2.0, "temperature": 175.0}]
        assert [line["speed"] for line in shaker.truth("shake")] == [300]
        # A lost answer: nobody knows, so somebody is asked; it is not done again.
        proxy.lose_next(b"POST", b"/action")
        run = client.submit(again, user="ada")
        (question,) = until(lambda: client.state()["interventions"], "somebody is asked")
        assert "WEI keeps no record" in json.dumps(question)
        client.resolve(question["id"], "done", by="ada")
        assert client.wait(run, timeout_s=60).status == "completed"
    assert [line["speed"] for line in shaker.truth("shake")] == [300, 400]
    assert lab.interrupt() == 0, lab.read_log()


FORWARD = """
name: forward
parameters:
  feed_forward:
    - {key: seen, step: look, parameter_type: feed_forward_file}
steps:
  - {name: Look, key: look, node: bench, action: picture}
  - {name: Carry, node: bench, action: transfer, locations: {source: bench.a, target: bench.b}}
  - {name: Run, node: bench, action: run, files: {protocol: seen}}
"""

MADSCI = """
labos: 1
name: corner
modules:
  - name: bench
    interface: madsci_rest_node
    config:
      node_url: "{url}"
      poll_s: 0.2
      representations: {{bench.a: [1, 2], bench.b: [3, 4]}}
      resource_ids: {{bench.a: 01K5HDZZCF27YHD2WDGSXFPPKF}}
    about:
      manipulator: true
      stations: {{a: {{}}, b: {{}}, gripper: {{kind: gripper}}}}
      actions:
        picture: {{}}
        run: {{args: {{protocol: {{type: file}}}}}}
        transfer:
          args: {{source: {{type: station}}, target: {{type: station}}}}
          effects: [move: {{source: "{{source}}", target: "{{target}}"}}]
stock: {{bench.a: {{plate96: 1}}}}
"""


def test_a_file_that_a_step_has_returned_is_given_to_a_later_one(lab: Up, tmp_path: Path) -> None:
    """As MADSci's workflows feed it forward, with a real node of MADSci."""
    node = ForeignProcess("madsci", tmp_path / "madsci", free_port())
    try:
        node.start()
        cell, flow = tmp_path / "corner.yaml", tmp_path / "forward.yaml"
        cell.write_text(MADSCI.format(url=node.url))
        flow.write_text(FORWARD)
        lab.start(str(cell))
        with lab.client() as client:
            run = client.wait(client.submit(flow, user="ada"), timeout_s=60)
            assert run.status == "completed", run
        (carried,) = node.truth("transfer")
        assert (carried["source"], carried["resource"]) == ([1, 2], "01K5HDZZCF27YHD2WDGSXFPPKF")
        (ran,) = node.truth("run")
        assert ran["bytes"] == len(b"\x89PNG") + 256
        assert lab.interrupt() == 0, lab.read_log()
    finally:
        node.kill()


@pytest.mark.full
def test_an_interface_without_an_adapter_is_named(lab: Up, tmp_path: Path) -> None:
    cell = tmp_path / "toy.yaml"
    cell.write_text(
        "labos: 1\nname: toy\nmodules: [{name: sealer, model: A4S_sealer, interface: simulate_callback}]\n"
    )
    lab.start(str(cell))
    log = lab.home / "logs" / "toy.sealer.log"
    words = "no adapter for the interface 'simulate_callback' (WEI's own simulation)"
    until(lambda: log.exists() and words in log.read_text(), "the node says why it does not start")
    lab.interrupt()


@pytest.mark.full
@pytest.mark.timeout(300)
def test_an_adapter_that_is_killed_finds_its_action_again(lab: Up, tmp_path: Path) -> None:
    """The lab starts it again, the node still knows the action, and nobody has to be asked."""
    node = ForeignProcess("madsci", tmp_path / "madsci", free_port())
    cell, flow = tmp_path / "corner.yaml", tmp_path / "flow.yaml"
    shaker = CELL[: CELL.index("  - name: sealer")].replace("wei_rest_node", "madsci_rest_node")
    shaker = shaker.replace("[needs: {{}}]", "[]")
    cell.write_text(shaker.replace("rest_node_address", "node_url").format(shaker=node.url))
    flow.write_text(AGAIN.replace("speed: 400", "speed: 400, time_s: 15.0"))
    try:
        node.start()
        lab.start(str(cell))
        with lab.client() as client:
            run = client.submit(flow, user="ada")
            until(lambda: node.truth("shake"), "it shakes")
            (note,) = (lab.home / "nodes").glob("*.json")
            os.kill(json.loads(note.read_text())["pid"], signal.SIGKILL)
            assert client.wait(run, timeout_s=60).status == "completed"
        assert lab.interrupt() == 0, lab.read_log()
    finally:
        node.kill()
    assert [line["what"] for line in node.truth() if line["what"] != "startup"] == ["shake", "shaken"]
    assert "intervention.requested" not in lab.types()
    assert "action.unknown" not in lab.types()


@pytest.mark.full
def test_a_device_that_may_still_work_is_left_alone(sealer: Sealer, lab: Up, tmp_path: Path) -> None:
    """It cannot say that it works, and its adapter is killed: a person is asked at once, and the next step
    waits until the device must be at rest, here because a person resets it."""
    cell, flow = tmp_path / "corner.yaml", tmp_path / "flow.yaml"
    cell.write_text(ALONE.format(sealer=sealer.url))
    flow.write_text("".join(line for line in FLOW.splitlines(keepends=True) if "shaker" not in line))
    sealer.go.clear()
    lab.start(str(cell))
    with lab.client() as client:
        first = client.submit(flow, user="ada")
        until(lambda: sealer.seals, "it seals")
        (note,) = (lab.home / "nodes").glob("*.json")
        os.kill(json.loads(note.read_text())["pid"], signal.SIGKILL)
        (question,) = until(lambda: client.state()["interventions"], "somebody is asked")
        client.resolve(question["id"], "done", by="ada")
        assert client.wait(first, timeout_s=60).status == "completed"
        second = client.submit(flow, user="ada")

        def waits() -> bool:
            runs = [run for run in client.state()["runs"] if run["id"] == second]
            return any(wait["code"] == "module_busy" for run in runs for wait in run["waits"])

        until(waits, "the next one waits for it")
        assert len(sealer.seals) == 1
        sealer.go.set()
        client.reset("sealer", by="ada")
        assert client.wait(second, timeout_s=60).status == "completed"
        assert len(sealer.seals) == 2
    assert lab.interrupt() == 0, lab.read_log()

"""The services of the compose file: a node for each module, each of them started again alone.

Their commands and health checks run here as processes, without containers.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import pytest
import yaml

from labos.client import LabClient
from labos.core.ids import local
from labos.spec import find_spec
from tests.docs.test_pages import what_is_wrong
from tests.support.cells import rpl_with
from tests.support.composition import Composition, environment_file, environment_of, modules_of, services_of
from tests.support.lab_process import PATIENCE_S, labos, until

HERE = ("sciclops", "pf400", "sealer")
NODES = tuple(f"node-{module}" for module in HERE)

SECURE = ("compose.yaml", "compose.secure.yaml")

WORKFLOW = """
labos: 1
name: every module once
steps:
  - {name: home, module: sciclops, action: home}
  - {name: look, module: pf400, action: explore_workcell}
  - {name: reset, module: sealer, action: reset}
"""


def command_of(name: str, *files: str) -> str:
    """What a service starts, with the words of lab.env in place."""
    service = services_of(*files)[name]
    line = service["entrypoint"][-1].rpartition("exec ")[2].strip()
    for key, value in {**environment_file(), **environment_of(service)}.items():
        line = line.replace(f"$${key}", value)
    return line


@pytest.mark.parametrize("files", [("compose.yaml",), SECURE])
def test_there_is_a_node_for_each_module_and_its_command_exists(files: tuple[str, ...]) -> None:
    cell = yaml.safe_load(find_spec("workcells", environment_file()["LABOS_WORKCELL"]).read_text())
    services = services_of(*files)
    nodes = modules_of(services)
    assert sorted(nodes.values()) == sorted(module["name"] for module in cell["modules"])
    # They are hosts' names too: no underscore.
    assert set(nodes) == {f"node-{module.lower().replace('_', '-')}" for module in nodes.values()}
    for name in ("bus", "lab", "projector", *nodes):
        line = command_of(name, *files)
        assert what_is_wrong(line, strict=True) == ""
        if name != "projector":
            assert ("--secure" in line) == (len(files) == 2)


def test_services_are_started_again_alone_and_tell_how_they_are() -> None:
    services = services_of("compose.yaml")
    job = services.pop("retention")
    assert (job["restart"], job["profiles"]) == ("no", ["jobs"])
    ours = {name: service for name, service in services.items() if service["image"] == "labos"}
    assert {service["restart"] for service in services.values()} == {"unless-stopped"}
    assert [name for name in ours if "healthcheck" not in ours[name]] == ["projector"]
    for service in ours.values():
        assert (service["read_only"], service["init"], service["cap_drop"]) == (True, True, ["ALL"])
    hosts = [service["hostname"] for name, service in ours.items() if name.startswith("node-")]
    assert hosts == list(modules_of(services)), "Prometheus finds a node's metrics by its hostname"


@pytest.fixture
def composition(request: pytest.FixtureRequest, tmp_path: Path, postgres_url: str) -> Iterator[Composition]:
    cell = rpl_with(HERE, tmp_path / "rpl.yaml")
    files = getattr(request, "param", ("compose.yaml",))
    told = {
        "LABOS_UP": f"{cell} --simulate --speed 100",
        "LABOS_BACKUP": str(tmp_path / "backup"),
        "LABOS_ARCHIVE": str(tmp_path / "archive"),
        "LABOS_KEEP_DAYS": "0",
    }
    made = Composition(tmp_path, postgres_url, told, *files)
    yield made
    made.clean_up()


@pytest.mark.slow
@pytest.mark.postgres
def test_a_lab_of_services_and_a_node_that_is_killed(composition: Composition, tmp_path: Path) -> None:
    workflow = tmp_path / "workflow.yaml"
    workflow.write_text(WORKFLOW)
    composition.start(*NODES, "bus")  # nodes wait
    composition.await_healthy("bus")
    assert not composition.is_healthy(NODES[0])
    composition.start("lab")
    for name in ("lab", *NODES):
        composition.await_healthy(name)
    before = composition.pids()
    assert set(before) == {"bus", "lab", *NODES}
    with LabClient(composition.url, token=make_token(composition)) as client:
        until(lambda: states(client) == dict.fromkeys(HERE, "IDLE"), "the lab sees its nodes")
        run = client.submit(workflow, user="admin")
        assert client.wait(run, timeout_s=PATIENCE_S).status == "completed"
        composition.kill("node-sealer")
        until(lambda: states(client)["sealer"] != "IDLE", "the lab sees that the node is gone")
        run = client.submit(workflow, user="admin")
        composition.start("node-sealer")
        assert client.wait(run, timeout_s=PATIENCE_S).status == "completed"
        composition.await_healthy("node-sealer")
        after = composition.pids()
        assert [name for name in before if after[name] != before[name]] == ["node-sealer"]
        # The bus too: all find it again.
        composition.kill("bus")
        composition.start("bus")
        run = client.submit(workflow, user="admin")
        assert client.wait(run, timeout_s=PATIENCE_S).status == "completed"
        for _ in range(2):
            composition.start("retention")
            assert composition.wait("retention") == 0, composition.read_log("retention")
            run = client.submit(workflow, user="admin")
            assert client.wait(run, timeout_s=PATIENCE_S).status == "completed"
        assert "1 segments were moved" in composition.read_log("retention")
        assert client.health()["epoch"] == 1


@pytest.mark.slow
@pytest.mark.postgres
@pytest.mark.parametrize("composition", [SECURE], indirect=True)
def test_a_node_joins_a_secure_bus_when_its_certificate_was_issued(composition: Composition) -> None:
    composition.start("bus")
    composition.await_healthy("bus")
    composition.start("lab")
    composition.await_healthy("lab")
    composition.start("node-sealer")
    assert composition.wait("node-sealer") == 1
    assert "labos pki issue" in composition.read_log("node-sealer")
    made = labos("pki", "issue", "node", "rpl/sealer", "--home", str(composition.home))
    assert made.returncode == 0, made.stderr
    composition.start("node-sealer")
    composition.await_healthy("node-sealer")
    with LabClient(composition.url, token=make_token(composition)) as client:
        until(lambda: states(client)["sealer"] == "IDLE", "the lab sees its node")


def make_token(composition: Composition) -> str:
    """A token of the first user, who was made of lab.env and a secret."""
    words = ("--for", "admin", "--scope", "operator", "--days", "1", "--json")
    made = labos("token", "create", "test", *words, "--home", str(composition.home))
    assert made.returncode == 0, made.stderr
    return str(json.loads(made.stdout)["secret"])


def states(client: LabClient) -> dict[str, str]:
    """What each node answers when it is asked now."""
    return {local(found["module"]): found["answer"] for found in client.check_nodes()}

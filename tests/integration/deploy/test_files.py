"""The files in deploy/: the system's own tools find no fault with them, and the commands in them exist."""

from __future__ import annotations

import json
import re
import shlex
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path
from xml.etree import ElementTree

import httpx
import pytest
import yaml

from labos.settings import free_port
from tests.docs.markdown import ROOT
from tests.docs.test_pages import what_is_wrong
from tests.support.composition import services_of
from tests.support.lab_process import Up, labos, until
from tests.support.prometheus import Prometheus

DEPLOY = ROOT / "deploy"
UNITS = sorted([*(DEPLOY / "systemd").glob("*.service"), *(DEPLOY / "systemd").glob("*.timer")])
MOST_EXPOSED = 2.0
"""Of 10, as `systemd-analyze security` grades it; a unit without any hardening has 9.6."""

needs_systemd = pytest.mark.skipif(not shutil.which("systemd-analyze"), reason="there is no systemd here")


ENVIRONMENTS = ("labos.env", "three-hosts.env")


def environment(name: str = "labos.env") -> dict[str, str]:
    lines = (DEPLOY / "systemd" / name).read_text().splitlines()
    return dict(line.split("=", 1) for line in lines if line and not line.startswith("#"))


def commands_of(unit: Path, told: str = "labos.env") -> list[str]:
    """What a unit starts, as systemd makes it of the environment file."""
    found = []
    for line in re.findall(r"^ExecStart=(.*)$", unit.read_text(), re.MULTILINE):
        for name, value in environment(told).items():
            line = line.replace(f"${{{name}}}", value).replace(f"${name}", value)
        found.append(line.replace("%i", "sealer"))
    return found


@pytest.fixture
def installed(tmp_path: Path) -> Path:
    """The units as on a computer where LabOS is installed: with a program that is there."""
    for unit in UNITS:
        name = unit.name.replace("@.", "@sealer.")
        text = unit.read_text().replace("/opt/labos/bin/labos", sys.executable)
        (tmp_path / name).write_text(text)
    return tmp_path


@needs_systemd
@pytest.mark.parametrize("unit", UNITS, ids=lambda unit: unit.name)
def test_systemd_finds_no_fault_with_a_unit(installed: Path, unit: Path) -> None:
    """It only warns of what it does not know, and exits with 0: it has to say nothing."""
    name = unit.name.replace("@.", "@sealer.")
    done = subprocess.run(
        ["systemd-analyze", "verify", f"./{name}"], cwd=installed, capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")


@needs_systemd
@pytest.mark.parametrize(
    "unit", [unit for unit in UNITS if unit.suffix == ".service"], ids=lambda unit: unit.name
)
def test_a_unit_exposes_little(installed: Path, unit: Path) -> None:
    name = unit.name.replace("@.", "@sealer.")
    done = subprocess.run(
        ["systemd-analyze", "security", "--offline=true", "--no-pager", f"./{name}"],
        cwd=installed,
        capture_output=True,
        text=True,
        check=False,
    )
    exposed = re.search(r"exposure level .*?: ([\d.]+)", done.stdout)
    assert exposed, done.stderr
    assert float(exposed[1]) <= MOST_EXPOSED


@pytest.mark.parametrize("unit", UNITS, ids=lambda unit: unit.name)
def test_what_a_unit_starts_exists(unit: Path) -> None:
    assert [line for line in commands_of(unit) if what_is_wrong(line, strict=True)] == []
    assert unit.suffix == ".timer" or commands_of(unit)


@pytest.mark.parametrize("unit", UNITS, ids=lambda unit: unit.name)
def test_what_a_unit_starts_on_several_hosts_exists(unit: Path) -> None:
    """With the settings of a secure bus. A kernel that may be the standby needs no unit of its own."""
    lines = commands_of(unit, "three-hosts.env")
    assert "$LABOS_STANDBY" not in " ".join(lines) or unit.name == "labos-standby.service"
    lines = [line.replace("$LABOS_STANDBY", "") for line in lines]
    assert [line for line in lines if what_is_wrong(line, strict=True)] == []


def test_every_variable_of_a_unit_is_in_the_environment_file() -> None:
    used = {name for unit in UNITS for name in re.findall(r"\$\{?(LABOS_\w+)", unit.read_text())}
    assert used <= environment().keys()


def test_the_compose_file_fits_its_schema() -> None:
    pytest.importorskip("check_jsonschema")
    done = subprocess.run(
        [sys.executable, "-m", "check_jsonschema", "--builtin-schema", "vendor.compose-spec", "compose.yaml"],
        cwd=DEPLOY / "compose",
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stdout


def test_the_compose_file_publishes_on_this_computer_only() -> None:
    services = yaml.safe_load((DEPLOY / "compose" / "compose.yaml").read_text())["services"]
    ports = [port for service in services.values() for port in service.get("ports", [])]
    assert ports
    assert [port for port in ports if not port.startswith("127.0.0.1:")] == []
    images = [service["image"] for service in services.values() if service["image"] != "labos"]
    assert [image for image in images if not re.search(r":v?\d", image)] == [], "an image has no version"


def test_the_grafana_of_the_compose_file_is_told_what_its_provisioning_asks_for() -> None:
    grafana = yaml.safe_load((DEPLOY / "compose" / "compose.yaml").read_text())["services"]["grafana"]
    files = [path for path in (DEPLOY / "grafana" / "provisioning").rglob("*") if path.is_file()]
    asked = {name for path in files for name in re.findall(r"\$(LABOS_\w+)", path.read_text())}
    assert asked - {"LABOS_SQLITE_FILE"} <= grafana["environment"].keys()
    mounted = dict(volume.split(":")[1::-1] for volume in grafana["volumes"])
    place, _, folder = grafana["environment"]["LABOS_DASHBOARDS"].rpartition("/")
    assert list((DEPLOY / "compose" / mounted[place] / folder).glob("*.json"))


@pytest.mark.slow
def test_the_prometheus_of_the_compose_file_finds_the_lab(tmp_path: Path) -> None:
    """A lab that is started as in its container, and Prometheus with the configuration of its container: only
    the places are others. The name of the lab's container is one of its names."""
    service = yaml.safe_load((DEPLOY / "compose" / "compose.yaml").read_text())["services"]["lab"]
    options = re.findall(r"exec labos up \$\$LABOS_UP (.*)", service["entrypoint"][-1])[0]
    port, password = free_port(), tmp_path / "admin"
    password.write_text("correct horse battery")
    options = options.replace("/run/secrets/admin", str(password)).replace("$$LABOS_ADMIN", "admin")
    options = options.replace("--http-port 8720", f"--http-port {port}").replace("--bus tcp/bus:7447", "")
    options = options.replace("--host 0.0.0.0", "--host 127.0.0.1")  # without a bus of its own service
    lab = Up(tmp_path / "lab", "--simulate", *shlex.split(options))
    token = tmp_path / "token"
    text = (DEPLOY / "compose" / "prometheus.yml").read_text()
    for there, here in (
        ("lab:8720", f"127.0.0.1:{port}"),
        ("/run/secrets/prometheus", str(token)),
        ("/etc/prometheus/rules.yml", str(DEPLOY / "prometheus" / "rules.yml")),
        ("15s", "1s"),
    ):
        assert there in text
        text = text.replace(there, here)
    try:
        lab.start("rpl")
        said = labos(
            "token",
            "create",
            "prometheus",
            "--for",
            "admin",
            "--scope",
            "viewer",
            "--days",
            "366",
            "--json",
            "--home",
            str(lab.home),
        )
        assert said.returncode == 0, said.stderr
        token.write_text(json.loads(said.stdout)["secret"])
        shown = {"authorization": f"Bearer {token.read_text()}", "host": "lab:8720"}
        found = httpx.get(f"http://127.0.0.1:{port}/metrics/targets", headers=shown)
        assert (found.status_code, found.json()[0]["targets"]) == (200, ["lab:8720"])
        with Prometheus(tmp_path, text) as prometheus:
            until(lambda: prometheus.ask("labos_build_info"), "Prometheus has the lab's metrics")
    finally:
        lab.clean_up()


def test_the_compose_file_with_a_secure_bus() -> None:
    """It leaves nothing of the lab open: the bus that other computers reach asks for certificates."""
    services = services_of("compose.yaml", "compose.secure.yaml")
    assert services["bus"]["ports"] == ["7447:7447"]
    assert services["lab"]["ports"] == ["127.0.0.1:8720:8720"]
    for name in ("bus", "lab"):
        assert "--secure" in services[name]["entrypoint"][-1]
        assert {"read_only", "cap_drop", "security_opt"} <= services[name].keys()


@pytest.mark.skipif(not shutil.which("logrotate"), reason="there is no logrotate here")
def test_logs_are_rotated(tmp_path: Path) -> None:
    logs = tmp_path / "lab" / "logs"
    logs.mkdir(parents=True)
    log = logs / "rpl.sealer.log"
    text = (DEPLOY / "logrotate" / "labos-nodes").read_text().replace("/var/lib/labos", str(tmp_path))
    rules = tmp_path / "rules"
    rules.write_text(re.sub(r"^ *su .*$", "", text, flags=re.MULTILINE))
    rules.chmod(0o644)
    with log.open("a") as writing:  # a node that holds its log open
        writing.write("old\n")
        writing.flush()
        rotate = ["logrotate", "--force", "--state", str(tmp_path / "state"), str(rules)]
        done = subprocess.run(rotate, capture_output=True, text=True, check=False)
        assert (done.returncode, done.stderr) == (0, "")
        writing.write("new\n")
    assert log.read_text() == "new\n"
    assert (logs / "rpl.sealer.log.1").read_text() == "old\n"


def test_the_image_holds_what_the_package_is_built_of() -> None:
    copied = re.findall(
        r"^COPY (?!--)(.*) \S+$", (DEPLOY / "compose" / "Containerfile").read_text(), re.MULTILINE
    )
    names = {name for line in copied for name in shlex.split(line)}
    assert {"labos", "drivers", "migrations", "specs", "pyproject.toml", "README.md", "LICENSE"} <= names
    assert [name for name in names if not (ROOT / name).exists()] == []
    built = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["hatch"]["build"]["targets"]["wheel"]
    assert {*built["packages"], *built["force-include"]} <= {
        *names,
        *(f"{name}/labos_drivers" for name in names),
    }


def test_the_windows_service_starts_a_command_that_exists() -> None:
    service = ElementTree.parse(DEPLOY / "windows" / "labos-node.xml").getroot()
    assert what_is_wrong(f"labos {service.findtext('arguments')}", strict=True) == ""


def test_every_file_is_told_of() -> None:
    page = (ROOT / "docs" / "install.md").read_text()
    ours = ("systemd", "compose", "tls", "windows", "logrotate")
    files = [path for folder in ours for path in (DEPLOY / folder).iterdir() if not path.name.startswith(".")]
    assert [path.name for path in files if f"`{path.name}`" not in page] == []

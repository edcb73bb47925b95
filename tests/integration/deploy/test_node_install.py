"""``labos node install``: what the archive holds, and that the node in it joins its lab."""

from __future__ import annotations

import os
import re
import shlex
import shutil
import stat
import subprocess
import sys
import tarfile
from collections.abc import Iterator
from pathlib import Path

import pytest

from labos.bootstrap import LabThread, descriptions
from labos.cli.app import main
from labos.core.ids import ModuleName
from labos.errors import BadInput
from labos.pki import Authority, PartyIdentity
from labos.services.node_package import NodePackage, pack_node
from labos.settings import Settings
from labos.spec import find_spec, load_workcell
from tests.integration.deploy.test_files import needs_systemd
from tests.support.lab_process import until

SEALER = ModuleName("rpl/sealer")

WRONG = {
    "a name with a space": ("rpl", "my sealer", "tcp/lab:7447"),
    "a name that leads elsewhere": ("rpl", "../sealer", "tcp/lab:7447"),
    "no port": ("rpl", "sealer", "tcp/lab"),
    "a command in the address": ("rpl", "sealer", "tcp/lab:7447;reboot"),
    "no scheme": ("rpl", "sealer", "lab:7447"),
    "secure without a certificate": ("rpl", "sealer", "tls/lab:7447"),
}


@pytest.mark.parametrize("what", WRONG)
def test_what_cannot_be_installed(what: str) -> None:
    workcell, name, connect = WRONG[what]
    with pytest.raises(BadInput) as refused:
        pack_node(NodePackage(workcell, name, connect, "labos-sdl"))
    assert refused.value.remedy


def test_without_an_authority_it_says_what_to_name(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["node", "install", "rpl/sealer", "--connect", "tls/lab:7447", "--home", str(tmp_path / "none")]
    assert main(words) == 1
    assert "--cert FOLDER" in capsys.readouterr().err
    assert main(["node", "install", "sealer", "--connect", "tcp/lab:7447"]) == 1
    assert "WORKCELL/MODULE" in capsys.readouterr().err


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Iterator[LabThread]:
    cell = load_workcell(find_spec("workcells", "rpl"), descriptions())
    home = tmp_path_factory.mktemp("install") / "lab"
    with LabThread(
        Settings.make(home, simulate=True, speed=1000.0, secure=True), [cell], nodes="none"
    ) as running:
        yield running


@pytest.fixture(scope="module")
def installed(lab: LabThread, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The root of another computer, after the archive was unpacked and installed there, twice."""
    folder = tmp_path_factory.mktemp("computer")
    file = folder / "sealer.tar.gz"
    bus = lab.runtime.bus_endpoint
    words = ["node", "install", "rpl/sealer", "--connect", bus, "-o", str(file), "--option", "--simulate"]
    assert main([*words, "--home", str(lab.runtime.settings.home)]) == 0
    assert stat.S_IMODE(file.stat().st_mode) == 0o600, "it holds a private key"
    with tarfile.open(file) as archive:
        archive.extractall(folder, filter="data")
    root = folder / "root"
    program = root / "opt" / "labos" / "bin"
    program.mkdir(parents=True)
    for name in ("labos", "python"):
        program.joinpath(name).symlink_to(Path(sys.executable).with_name(name))
    for _ in range(2):
        subprocess.run(
            ["sh", folder / "labos-node-rpl-sealer" / "install.sh"],
            env={**os.environ, "ROOT": str(root), "LABOS_KEEP_PROGRAM": "1"},
            check=True,
            stdout=subprocess.DEVNULL,
        )
        (root / "etc" / "labos" / "labos.env").write_text("LABOS_HOME=/srv/other\n")
    return root


def test_what_is_where(installed: Path, lab: LabThread) -> None:
    place = installed / "etc" / "labos" / "certificates" / "rpl.sealer"
    assert sorted(path.name for path in place.iterdir()) == ["ca.pem", "cert.pem", "key.pem"]
    assert stat.S_IMODE((place / "key.pem").stat().st_mode) == 0o600
    authority = Authority(lab.runtime.settings.pki)
    own = authority.credentials(PartyIdentity("node", "rpl/sealer", lab.runtime.kernel.lab))
    assert (place / "key.pem").read_bytes() == own.key.read_bytes()
    assert (installed / "etc" / "labos" / "labos.env").read_text() == "LABOS_HOME=/srv/other\n"
    assert (installed / "usr" / "lib" / "sysusers.d" / "labos.conf").is_file()


@needs_systemd
def test_systemd_finds_no_fault_with_the_unit(installed: Path, tmp_path: Path) -> None:
    text = (installed / "etc" / "systemd" / "system" / "labos-node@.service").read_text()
    (tmp_path / "labos-node@sealer.service").write_text(text.replace("/opt/labos/bin/labos", sys.executable))
    done = subprocess.run(
        ["systemd-analyze", "verify", "./labos-node@sealer.service"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
    )
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")


def test_the_installed_node_joins_the_lab(installed: Path, lab: LabThread, tmp_path: Path) -> None:
    """Started as its unit says, from what is below the root alone."""
    unit = (installed / "etc" / "systemd" / "system" / "labos-node@.service").read_text()
    line = next(iter(re.findall(r"^ExecStart=(.*)$", unit, re.MULTILINE))).replace("%i", "sealer")
    settings = (installed / "etc" / "labos" / "node-sealer.env").read_text().splitlines()
    for name, value in (each.split("=", 1) for each in settings):
        line = line.replace(f"${{{name}}}", value).replace(f"${name}", value)
    line = line.replace("/opt/", f"{installed}/opt/").replace("/etc/", f"{installed}/etc/")
    argv = [sys.executable, *shlex.split(line)]
    environment = {**os.environ, "LABOS_HOME": str(tmp_path / "home")}
    modules = lab.runtime.kernel.state.modules.by_name
    with subprocess.Popen(
        argv, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    ) as node:
        try:
            until(lambda: modules[SEALER].joined, "the sealer joins", 30.0)
        finally:
            node.kill()


@pytest.mark.full
@pytest.mark.timeout(600)
def test_the_script_makes_the_program_of_a_wheel(tmp_path: Path) -> None:
    """pip and a package index, as on a new computer."""
    root = Path(__file__).parents[3]
    subprocess.run(
        [sys.executable, "-m", "pip", "wheel", "-q", "--no-deps", "-w", tmp_path, root], check=True
    )
    wheel = next(tmp_path.glob("labos_sdl-*.whl"))
    data = pack_node(NodePackage("rpl", "sealer", "tcp/lab:7447", "labos-sdl", "", None, (wheel,)))
    (tmp_path / "node.tar.gz").write_bytes(data)
    shutil.unpack_archive(tmp_path / "node.tar.gz", tmp_path / "there", filter="data")
    computer = tmp_path / "computer"
    script = next((tmp_path / "there").glob("*/install.sh"))
    subprocess.run(["sh", script], env={**os.environ, "ROOT": str(computer)}, check=True)
    program = computer / "opt" / "labos" / "bin" / "labos"
    told = subprocess.run([program, "node", "install", "--help"], check=True, capture_output=True, text=True)
    assert "install.sh" in told.stdout
    words = ["node", "install", "rpl/peeler", "--connect", "tcp/lab:7447", "-o", "peeler.tar.gz"]
    subprocess.run([program, *words], check=True, cwd=tmp_path)
    with tarfile.open(tmp_path / "peeler.tar.gz") as archive:
        assert "labos-node-rpl-peeler/labos-node@.service" in archive.getnames()

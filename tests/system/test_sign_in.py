"""A lab gets its users: from the first one, added on its own computer, to a program that runs a workflow with
a token. No secret and no name is found anywhere but where it belongs."""

from __future__ import annotations

import gzip
import json
import os
import signal
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

from labos.cli.app import group
from tests.support.lab_process import Up, until
from tests.system.test_private import children_of

pytestmark = pytest.mark.slow

PASSWORD, NAME, MAIL = "correct horse unmistakable", "Ada Unmistakable", "ada@unmistakable.example"
OF_DEVICE = "arm password of the device"
FLOW = "labos: 1\nname: seal\nsteps:\n  - {name: seal, module: sealer, action: seal}\n"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("sign_in")


@pytest.fixture(scope="module")
def lab(folder: Path) -> Iterator[Up]:
    up = Up(folder / "lab", "--simulate", "--speed", "200")
    # A crash writes where every thread was; secrets of devices stand in the environment.
    up.environment = {"LABOS_LOG": "debug", "PYTHONFAULTHANDLER": "1", "ARM_PASSWORD": OF_DEVICE}
    try:
        yield up.start_with("sciclops", "pf400", "sealer")
    finally:
        up.clean_up()


def run(folder: Path, *words: str, typed: str = "", fails: bool = False, **environment: str) -> str:
    """A command of somebody whose own files are in the folder; ``typed`` comes by standard input."""
    env = {"LABOS_TOKEN": None, "XDG_CONFIG_HOME": str(folder / "config"), **environment}
    done = CliRunner().invoke(group, [*words, "--home", str(folder / "lab")], input=typed, env=env)
    said = f"{done.output}{done.exception or ''}"
    assert (done.exit_code != 0) == fails, f"{words}: {said}"
    return said


def test_from_the_first_user_to_a_program(lab: Up, folder: Path) -> None:
    until(lambda: "this lab has no users" in lab.read_log(), "it says that it is open")
    told = json.loads(run(folder, "whoami", "--json"))
    assert told["how"] == "open"
    said = run(folder, "user", "add", "ada", "--name", NAME, "--mail", MAIL)
    assert "ada is the admin" in said
    assert "labos user password ada" in said
    assert "labos login" in run(folder, "pause", "lab", fails=True)
    run(folder, "user", "password", "ada", typed=f"{PASSWORD}\n")
    assert "wrong" in run(folder, "login", "--user", "ada", typed="a wrong one\n", fails=True)
    run(folder, "login", "--user", "ada", typed=f"{PASSWORD}\n")
    assert f"ada ({NAME}), by a token" in run(folder, "whoami")
    tokens = folder / "config" / "labos" / "tokens.json"
    assert tokens.stat().st_mode & 0o777 == 0o600
    run(folder, "user", "add", "robot", "--service", "--role", "operator")
    made = json.loads(
        run(folder, "token", "create", "picker", "--for", "robot", "--scope", "operator", "--json")
    )
    (folder / "seal.yaml").write_text(FLOW)
    (folder / "policy.yaml").write_text("labos: 1\ntrusted: [robot]\n")
    run(folder, "policy", "--apply", str(folder / "policy.yaml"))
    place = ("--place", "sealer.default=plate96")
    run(folder, "run", str(folder / "seal.yaml"), *place, LABOS_TOKEN=made["secret"])
    assert "robot" in run(folder, "token", "list", "--for", "robot")
    run(folder, "token", "revoke", made["token"]["id"])
    assert "revoked" in run(folder, "pause", "lab", LABOS_TOKEN=made["secret"], fails=True)

    secrets = {PASSWORD, made["secret"], *json.loads(tokens.read_text()).values()}
    key = (folder / "lab" / "home.key").read_text().strip()
    assert all(len(secret) > 20 for secret in secrets)
    look_everywhere(lab, folder, secrets, key)
    look_into_copies(folder, {*secrets, key, OF_DEVICE})
    assert lab.process is not None
    node = next(pid for pid in children_of(lab.process.pid) if is_node(pid))
    os.kill(node, signal.SIGSEGV)
    until(
        lambda: any(b"Segmentation" in file.read_bytes() for file in logs(folder)), "it wrote its last words"
    )
    look_everywhere(lab, folder, secrets, key)

    assert "You are signed out" in run(folder, "logout")
    assert "labos login" in run(folder, "pause", "lab", fails=True)
    run(folder, "user", "erase", "ada")
    lab.process.send_signal(signal.SIGABRT)
    lab.process.wait(60)
    crashed = (folder / "lab" / "up.log").read_text()
    assert "Fatal Python error: Aborted" in crashed
    assert not any(secret in crashed for secret in (*secrets, key, NAME, MAIL, OF_DEVICE))
    lab.start_with("sciclops", "pf400", "sealer")
    assert lab.interrupt() == 0
    assert not (folder / "lab" / "home.key").exists()
    for file in (folder / "lab").rglob("*"):
        assert not file.is_file() or b"nmistakable" not in file.read_bytes(), file
    assert {record.head.actor for record in lab.records()} >= {"ada", "robot"}


def is_node(pid: int) -> bool:
    try:
        return b"sealer" in Path(f"/proc/{pid}/cmdline").read_bytes()
    except OSError:
        return False


def logs(folder: Path) -> list[Path]:
    return [file for file in (folder / "lab" / "logs").rglob("*") if file.is_file()]


def look_into_copies(folder: Path, secrets: set[str]) -> None:
    """What is handed on or kept elsewhere bears no secret: backups, bundles, exports, shown settings."""
    made = folder / "copies"
    made.mkdir()
    run(folder, "backup", str(made / "backup"))
    run(folder, "key", "create")
    run(folder, "checkpoint")
    run(folder, "bundle", "R1", "-o", str(made / "R1.zip"))
    told = [run(folder, *words) for words in (("log", "--json"), ("doctor",), ("nodes", "--json"))]
    contents = [(str(file), file.read_bytes()) for file in made.rglob("*") if file.is_file()]
    assert {Path(name).suffix for name, _ in contents} >= {".gz", ".zip", ".json"}
    for name, content in list(contents):
        if name.endswith(".gz"):
            contents.append((name, gzip.decompress(content)))
        elif name.endswith(".zip"):
            with zipfile.ZipFile(name) as bundle:
                contents += [(f"{name}/{part}", bundle.read(part)) for part in bundle.namelist()]
    for name, content in (*contents, *(("what a command said", text.encode()) for text in told)):
        for secret in secrets:
            assert secret.encode() not in content, f"{secret} in {name}"


def read_of_children(parent: int, name: str) -> list[str]:
    """A file of /proc for each process of a lab. All are read again if one has ended meanwhile."""
    while True:
        try:
            return [Path(f"/proc/{pid}/{name}").read_text(errors="replace") for pid in children_of(parent)]
        except (FileNotFoundError, ProcessLookupError):
            continue


def look_everywhere(lab: Up, folder: Path, secrets: set[str], key: str) -> None:
    """Secrets are neither in the lab's folder nor in its log nor in what processes were started with, and
    names are in no event."""
    database = {"labos.db", "labos.db-wal"}
    for file in (folder / "lab").rglob("*"):
        if not file.is_file() or file.name == "home.key":
            continue
        content = file.read_bytes()
        for secret in (*secrets, key, OF_DEVICE):
            assert secret.encode() not in content, f"{secret} in {file}"
        if file.name not in database:
            assert b"nmistakable" not in content, file
    for record in lab.records():
        assert b"nmistakable" not in record.payload
    assert lab.process is not None
    lines = read_of_children(lab.process.pid, "cmdline")
    assert len(lines) > 3
    for line in lines:
        assert not any(secret in line for secret in (*secrets, key, NAME, MAIL, OF_DEVICE)), line
    for inherited in read_of_children(lab.process.pid, "environ"):  # a device's own secret may stand there
        assert not any(secret in inherited for secret in (*secrets, key, NAME, MAIL)), inherited
    with lab.client() as client:
        abouts: list[dict[str, Any]] = [dict(event) for event in client.events(type="node.joined")]
        told = json.dumps([abouts, client.state(), client.users(), client.health()])
    assert not any(secret in told for secret in (*secrets, key, NAME, MAIL))

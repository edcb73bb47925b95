"""What a lab makes can be read by its owner only, and no process shows a password."""

from __future__ import annotations

import os
import stat
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.support.cells import PCR
from tests.support.lab_process import Up, labos, until

MARKER = "hunter2marker"

pytestmark = pytest.mark.timeout(120)


@pytest.fixture
def lab(tmp_path: Path) -> Iterator[Up]:
    up = Up(tmp_path / "lab", "--simulate", "--speed", "1000")
    before = os.umask(0o022)
    yield up
    up.clean_up()
    os.umask(before)


def children_of(parent: int) -> set[int]:
    """The processes below one, itself included."""
    parents: dict[int, int] = {}
    for entry in Path("/proc").iterdir():
        if entry.name.isdecimal():
            try:
                words = (entry / "stat").read_text(errors="replace").rpartition(")")[2].split()
            except OSError:
                continue
            parents[int(entry.name)] = int(words[1])
    found, size = {parent}, 0
    while len(found) > size:
        size = len(found)
        found |= {pid for pid, above in parents.items() if above in found}
    return found


def test_files_and_folders_are_the_owners(lab: Up) -> None:
    lab.start_with(*PCR)
    with lab.client() as client:
        until(lambda: all(m["status"] == "IDLE" for m in client.state()["modules"]), "all nodes are there")
        run = client.submit("pcr", user="ada")
        client.wait(run, timeout_s=60)
    assert lab.interrupt() == 0, lab.read_log()
    own = {lab.home / "up.log", lab.home}  # made by this test
    found = [path for path in lab.home.rglob("*") if path not in own]
    assert len(found) > 20
    open_to_others = [str(path) for path in found if stat.S_IMODE(path.stat().st_mode) & 0o077]
    assert open_to_others == []


def test_a_new_home_is_private(tmp_path: Path) -> None:
    from labos.bootstrap import LabThread, descriptions
    from labos.settings import Settings
    from labos.spec import find_spec, load_workcell

    before = os.umask(0o022)
    try:
        cell = load_workcell(find_spec("workcells", "rpl"), descriptions())
        home = tmp_path / "a" / "lab"
        with LabThread(Settings.make(home, simulate=True), [cell], nodes="none"):
            for folder in (home, home.parent, home / "world"):
                assert stat.S_IMODE(folder.stat().st_mode) == 0o700, folder
            assert stat.S_IMODE((home / "kernel.json").stat().st_mode) == 0o600
    finally:
        os.umask(before)


def test_no_process_shows_the_databases_password(lab: Up, postgres_url: str) -> None:
    user, _, rest = postgres_url.partition("@")
    url = f"{user}:{MARKER}@{rest}"
    told = labos("log", "--home", str(lab.home), "--database", url)
    assert told.returncode != 0
    assert "LABOS_DATABASE_URL" in told.stderr
    assert MARKER not in told.stderr + told.stdout
    lab.environment = {"LABOS_DATABASE_URL": url}
    lab.start_with(*PCR)
    assert lab.process is not None
    with lab.client() as client:
        until(lambda: all(m["status"] == "IDLE" for m in client.state()["modules"]), "all nodes are there")
    processes = children_of(lab.process.pid)
    assert len(processes) > 4
    for pid in processes:
        try:
            assert MARKER.encode() not in Path(f"/proc/{pid}/cmdline").read_bytes()
        except FileNotFoundError:
            continue
    assert lab.interrupt() == 0, lab.read_log()
    for log in (lab.home / "logs").iterdir():
        assert MARKER not in log.read_text(errors="replace"), log

"""The retention unit's own commands, beside a running kernel: nothing is lost, also if they are killed."""

from __future__ import annotations

import json
import os
import shlex
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from labos.cli.app import main
from labos.services.doctor import LONG_AGO_NS, NOTE, check_retention, note_retention
from labos.store import FolderBlobs, read_backup
from tests.integration.deploy.test_files import DEPLOY, commands_of
from tests.support.composition import services_of
from tests.support.lab_process import PATIENCE_S, Up, labos

UNIT = DEPLOY / "systemd" / "labos-retention.service"
SEGMENTS = 6
WORKFLOW = "labos: 1\nname: w\nsteps:\n  - {name: reset, module: sealer, action: reset}\n"
FILE_AGE_S = 60 * 86_400.0


class Retention:
    """The commands of the unit, with settings of this test: everything but the newest segment is old."""

    def __init__(self, lab: Up, folder: Path) -> None:
        self.lab, self.backup, self.archive = lab, folder / "safe", folder / "archive"
        self.settings = {
            "/opt/labos/bin/labos": "",
            "/var/lib/labos/backup": str(self.backup),
            "/var/lib/labos/archive": str(self.archive),
            "--keep-days 400": "--keep-days 0",
        }

    def commands(self) -> list[list[str]]:
        found = []
        for line in commands_of(UNIT):
            for there, here in self.settings.items():
                line = line.replace(there, here)
            found.append(shlex.split(line))
        return found

    def start(self, words: list[str]) -> subprocess.Popen[bytes]:
        return subprocess.Popen(
            [sys.executable, "-m", "labos", *words],
            env={**os.environ, "LABOS_HOME": str(self.lab.home)},
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
        )

    def run(self) -> tuple[int, list[str]]:
        """As systemd runs the lines of a oneshot unit: one after the other, to the first that fails.
        Returns its exit code, and what each has said."""
        told = []
        for words in self.commands():
            process = self.start(words)
            said, _ = process.communicate(timeout=PATIENCE_S)
            told.append(said.decode())
            if process.returncode:
                return process.returncode, told
        return 0, told

    def make_segments(self) -> None:
        """Some segments, with something in the log between them."""
        for _ in range(SEGMENTS - 1):
            assert self.work() == "completed"
            assert labos("backup", str(self.backup), LABOS_HOME=str(self.lab.home)).returncode == 0

    def work(self) -> str:
        with self.lab.client() as client:
            run = client.submit({"name": "w.yaml", "text": WORKFLOW}, user="ada")
            return str(client.wait(run, timeout_s=PATIENCE_S).status)


@pytest.fixture
def retention(tmp_path: Path) -> Iterator[Retention]:
    lab = Up(tmp_path / "lab", "--simulate", "--speed", "1000")
    try:
        lab.start_with("sealer", "sciclops", "pf400")
        made = Retention(lab, tmp_path)
        made.make_segments()
        yield made
    finally:
        lab.clean_up()


def segments_in(folder: Path) -> set[str]:
    return {path.name for path in folder.glob("log-*")}


@pytest.mark.slow
def test_the_unit_moves_what_is_old_while_the_kernel_runs(retention: Retention) -> None:
    lab = retention.lab
    blobs = FolderBlobs(lab.home / "blobs")
    named = set(blobs.names())
    orphan, young = blobs.put(b"of a request that was refused"), blobs.put(b"arriving just now")
    at = time.time() - FILE_AGE_S
    for name in (*named, orphan):
        os.utime(blobs._find_file(name), (at, at))
    code, told = retention.run()
    assert code == 0, told
    whole = read_backup(retention.backup)
    assert len(whole.segments) >= SEGMENTS - 1
    assert f"{len(whole.segments) - 1} segments were moved" in told[2]
    assert "The backup is intact" in told[3]
    assert set(blobs.names()) == {*named, young}
    assert segments_in(retention.backup) == {whole.segments[-1].file}
    assert segments_in(retention.archive) == {segment.file for segment in whole.segments[:-1]}
    assert_nothing_lost(retention)
    found = json.loads(labos("doctor", "--json", "--home", str(lab.home)).stdout)["findings"]
    assert [one["state"] for one in found if one["name"] == "retention"] == ["ok"]


@pytest.mark.slow
def test_killed_in_the_middle_it_is_finished_the_next_time(retention: Retention) -> None:
    moving = next(words for words in retention.commands() if "--move-old" in words)
    process = retention.start(moving)
    give_up = time.monotonic() + PATIENCE_S
    while not segments_in(retention.archive) and time.monotonic() < give_up:
        pass  # a segment takes some milliseconds
    process.kill()  # -9
    process.communicate()
    known = {segment.file for segment in read_backup(retention.backup).segments}
    assert known <= segments_in(retention.backup) | segments_in(retention.archive)
    code, told = retention.run()
    assert code == 0, told
    assert len(segments_in(retention.backup)) == 1
    assert_nothing_lost(retention)


@pytest.mark.slow
def test_nothing_moves_out_of_a_backup_that_is_not_whole(retention: Retention) -> None:
    blobs = FolderBlobs(retention.lab.home / "blobs")
    orphan = blobs.put(b"of a request that was refused")
    os.utime(blobs._find_file(orphan), (0, 0))
    damaged = retention.backup / read_backup(retention.backup).segments[1].file
    whole = damaged.read_bytes()
    damaged.write_bytes(whole[:-20])
    code, told = retention.run()
    assert (code, len(told)) == (1, 2), told
    assert "damaged" in told[1]
    assert segments_in(retention.archive) == set()
    assert orphan in blobs.names()
    damaged.write_bytes(whole)
    assert retention.run()[0] == 0


def assert_nothing_lost(retention: Retention) -> None:
    """All of the log comes back from both folders together, and the kernel works on."""
    words = ("restore", str(retention.backup), "--rehearse", "--json", "--home", str(retention.lab.home))
    assert labos(*words).returncode == 1, "without the archive it cannot come back"
    done = labos(*words, "--archive", str(retention.archive))
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["position"] == read_backup(retention.backup).position
    assert labos("verify", "--home", str(retention.lab.home)).returncode == 0
    assert retention.work() == "completed"
    with retention.lab.client() as client:
        assert client.health()["epoch"] == 1


def test_the_compose_file_has_the_same_steps() -> None:
    lines = services_of("compose.yaml")["retention"]["entrypoint"][-1].splitlines()
    ours = [line.replace("$$LABOS", "$LABOS") for line in lines if line.startswith("labos ")]
    unit = [
        line.partition("/bin/")[2].replace("${", "$").replace("}", "")
        for line in UNIT.read_text().splitlines()
        if line.startswith("ExecStart=")
    ]
    assert ours == unit


def test_how_long_ago_it_was_is_noted(tmp_path: Path) -> None:
    assert check_retention(tmp_path, 0) is None
    note_retention(tmp_path, "moved_at", 1)
    found = check_retention(tmp_path, LONG_AGO_NS + 1)
    assert found is not None
    assert (found.state, "removed never" in found.result) == ("warning", True)
    note_retention(tmp_path, "removed_at", LONG_AGO_NS)
    states = [check_retention(tmp_path, LONG_AGO_NS + more) for more in (0, 2)]
    assert [one.state for one in states if one is not None] == ["ok", "warning"]
    (tmp_path / NOTE).write_bytes(b"[]")
    assert check_retention(tmp_path, 0) is None
    note_retention(tmp_path / "none", "moved_at", 1)  # nobody's lab


@pytest.mark.parametrize("words", [(), ("--backup", "safe", "--detached")])
def test_an_archive_goes_with_a_backup(words: tuple[str, ...], capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["verify", *words, "--archive", "there"]) == 2
    assert "--archive needs --backup FOLDER" in capsys.readouterr().err

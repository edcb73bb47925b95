"""Disks that fill, fail, turn read-only or change a byte, and a server that crashes, under real labs.

Callers get the error, nothing is sent that is not in the log, and the lab goes on or starts again.
"""

from __future__ import annotations

import errno
import json
import os
import re
import shutil
import sqlite3
import subprocess
from collections.abc import Callable, Iterator
from contextlib import closing
from pathlib import Path

import pytest
from click.testing import CliRunner

from labos.cli.app import group
from labos.client import LabClient
from labos.errors import LabosError
from labos.store import open_store
from tests.integration.store.records import batch, write_records
from tests.support.bad_disk import BadDisk
from tests.support.cells import PCR
from tests.support.lab_process import Up, statuses, until
from tests.support.postgres import PostgresServer

SPEED = ("--simulate", "--speed", "800", "--quiet")
CANNOT_WRITE = re.compile(r"cannot write its log at the moment: The \w+ database .*is not available")


@pytest.fixture
def lab(tmp_path: Path) -> Iterator[Up]:
    up = Up(tmp_path / "lab", *SPEED)
    yield up
    up.clean_up()


@pytest.fixture
def disk(tmp_path: Path) -> Iterator[Path]:
    """A small disk of its own."""
    folder = tmp_path / "disk"
    folder.mkdir()
    if mount("-t", "tmpfs", "-o", "size=12m", "tmpfs", str(folder)):
        pytest.skip("this user may not mount a disk")
    yield folder
    subprocess.run(["umount", "--lazy", str(folder)], check=True)


def mount(*arguments: str) -> int:
    return subprocess.run(["mount", *arguments], capture_output=True, check=False).returncode


def run_command(*argv: str, code: int = 0) -> str:
    result = CliRunner().invoke(group, argv)
    told = result.output + (str(result.exception) if isinstance(result.exception, LabosError) else "")
    assert result.exit_code == code, told
    return told


def whole(lab: Up) -> None:
    """The chain holds, and no node did what the log does not know."""
    told = run_command("verify", "--journals", "--home", str(lab.home))
    assert "is intact" in told
    assert "contain nothing that the log lacks" in told
    assert lab.disagreements() == []


def count(lab: Up, kind: str) -> int:
    return lab.types().count(kind)


def refusal(lab: Up) -> str:
    """What a caller hears while the log cannot be written; empty if it was taken."""
    try:
        with LabClient(home=lab.home, patience_s=0.5) as client:
            client.take_out("hidex", "nobody can note this", "ada")
            client.put_back("hidex", "ada")
    except LabosError as error:
        return str(error)
    return ""


def fill(disk: Path) -> None:
    handle = os.open(disk / "ballast", os.O_WRONLY | os.O_CREAT)
    try:
        while True:
            os.write(handle, bytes(4096))
    except OSError:
        pass
    finally:
        os.close(handle)


def outlive(lab: Up, database: str, then: str, fail: Callable[[], None], mend: Callable[[], None]) -> None:
    """Two PCRs under a disk that fails, until it is mended."""
    lab.options = (*SPEED, "--database", database, "--on-database-loss", then)
    lab.start_with(*PCR, "hidex")
    with lab.client() as client:
        runs = [client.submit("pcr", user=user) for user in ("ada", "bo")]
        until(lambda: count(lab, "action.succeeded") >= 3, "the runs are on their way")
    process = lab.process
    assert process is not None
    fail()
    if then == "wait":
        # Who asked at that very moment hears that it is not known, everybody after that the lab cannot write.
        until(lambda: CANNOT_WRITE.search(refusal(lab)), "callers hear of it")
        assert process.poll() is None
        mend()
        until(lambda: not refusal(lab), "the lab takes commands again")
        assert "log_reopened" in lab.read_log()
    else:
        until(lambda: refusal(lab) and process.poll() is not None, "the kernel stops")
        assert process.returncode == 1
        assert "not available" in lab.read_log()
        whole_so_far = run_command("verify", "--journals", "--home", str(lab.home))
        assert "contain nothing that the log lacks" in whole_so_far
        mend()
        lab.options = (*SPEED, "--database", database)
        lab.start()
    with lab.client() as client:
        assert statuses(client, runs) == ["completed", "completed"]
    assert lab.interrupt() == 0, lab.read_log()
    whole(lab)


@pytest.mark.full
@pytest.mark.parametrize("then", ["wait", "stop"])
def test_a_full_disk_costs_time_only(lab: Up, disk: Path, then: str) -> None:
    outlive(
        lab, f"sqlite:///{disk / 'labos.db'}", then, lambda: fill(disk), lambda: (disk / "ballast").unlink()
    )


FAILURES = {"write": (errno.EIO, "w"), "sync": (errno.EIO, "s"), "read-only": (errno.EROFS, "wo")}


@pytest.mark.full
@pytest.mark.parametrize("then", ["wait", "stop"])
@pytest.mark.parametrize("failing", list(FAILURES))
def test_a_failing_disk_costs_time_only(lab: Up, tmp_path: Path, failing: str, then: str) -> None:
    """Its system says EIO for a write or for a sync, or has made it read-only as it does after an error."""
    bad = BadDisk(tmp_path, "labos.db")
    lab.environment = bad.environment
    outlive(lab, f"sqlite:///{tmp_path / 'labos.db'}", then, lambda: bad.fails(*FAILURES[failing]), bad.mend)


@pytest.mark.full
@pytest.mark.postgres
@pytest.mark.parametrize("then", ["wait", "stop"])
def test_a_server_that_crashes_under_load(
    lab: Up, own_postgres: Callable[[], PostgresServer], then: str
) -> None:
    server = own_postgres()
    url = server.create_database("lab")
    lab.options = (*SPEED, "--database", url, "--on-database-loss", then)
    lab.start_with(*PCR, "hidex")
    process = lab.process
    assert process is not None
    with lab.client() as client:
        runs = [client.submit("pcr", user=user) for user in ("ada", "bo")]
        for crash in range(3 if then == "wait" else 1):
            until(lambda n=crash: count(lab, "action.succeeded") >= 3 * n + 3, "the runs are on their way")
            server.stop(immediate=True)
            assert until(lambda: refusal(lab), "a caller hears of it")
            if then == "stop":
                until(lambda: process.poll() is not None, "the kernel stops")
                assert process.returncode == 1
                assert "PostgreSQL database" in lab.read_log()
            server.start()
            if then == "stop":
                lab.start()
            until(lambda: not refusal(lab), "the lab takes commands again")
    with lab.client() as client:
        assert statuses(client, runs) == ["completed", "completed"]
    assert lab.interrupt() == 0, lab.read_log()
    whole(lab)


# -- damage at rest ----------------------------------------------------------------------------


def test_a_flipped_bit_in_the_file_is_found_and_located(tmp_path: Path) -> None:
    home = tmp_path / "lab"
    home.mkdir()
    store = open_store(f"sqlite:///{home / 'labos.db'}")
    write_records(store, 300)
    records = list(store.read())
    store.close()
    with closing(sqlite3.connect(home / "labos.db")) as connection:
        connection.execute("PRAGMA wal_checkpoint(TRUNCATE)")
    file = home / "labos.db"
    good = file.read_bytes()
    for record in (records[0], records[150], records[299]):
        at = good.find(record.envelope) + len(record.envelope) // 2
        file.write_bytes(good[:at] + bytes([good[at] ^ 4]) + good[at + 1 :])
        told = run_command("verify", "--home", str(home), code=1)
        assert f"Position {record.head.position}: the hash does not follow" in told
    file.write_bytes(good)
    run_command("verify", "--home", str(home))


def test_a_truncated_write_ahead_log_is_found_by_a_checkpoint(tmp_path: Path) -> None:
    home, cut = tmp_path / "lab", tmp_path / "cut"
    home.mkdir()
    cut.mkdir()
    store = open_store(f"sqlite:///{home / 'labos.db'}")
    head = write_records(store, 20)
    for _ in range(5):
        head = store.append(head, batch(head, 20))
    checkpoint = str(tmp_path / "checkpoint.json")
    run_command("verify", "--home", str(home), "--checkpoint", checkpoint)
    for name in ("labos.db", "labos.db-wal"):
        shutil.copy(home / name, cut / name)
    store.close()
    wal = cut / "labos.db-wal"
    with wal.open("r+b") as file:
        file.truncate(wal.stat().st_size * 2 // 3)
    # The chain alone does not show it: what is left is a whole log.
    assert "is intact" in run_command("verify", "--home", str(cut))
    told = run_command("verify", "--home", str(cut), "--checkpoint", checkpoint, code=1)
    assert "the log ends at position" in told


@pytest.mark.full
def test_a_truncated_write_ahead_log_is_found_by_its_last_position_and_the_nodes_journals(
    lab: Up, tmp_path: Path
) -> None:
    """A power cut that took what was said to be synced: the disk lied."""
    lab.start_with(*PCR, "hidex")
    with lab.client() as client:
        run = client.submit("pcr", user="ada")
        assert statuses(client, [run]) == ["completed"]
        lab.kill()
    wal = lab.home / "labos.db-wal"
    with wal.open("r+b") as file:
        file.truncate(wal.stat().st_size * 2 // 3)
    assert "its end is lost" in run_command("verify", "--home", str(lab.home), code=1)
    (lab.home / "labos.head").unlink()  # the disk lost that too
    assert "is intact" in run_command("verify", "--home", str(lab.home))
    told = json.loads(run_command("verify", "--journals", "--json", "--home", str(lab.home), code=1))
    assert "know more than the log" in told["fault"]

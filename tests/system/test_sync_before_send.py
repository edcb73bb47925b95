"""What strace saw: a request is on disk before it is sent, and in the journal before it moves."""

from __future__ import annotations

import os
import re
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from labos.client import LabClient
from labos.errors import LabosError
from labos.settings import find_kernel
from labos.spec import find_spec

CALLS = "trace=pwrite64,write,writev,fsync,fdatasync,sendto,sendmsg"


def trace_run(home: Path, trace: Path) -> None:
    """One colour plate is fetched in a lab that runs under strace."""
    argv = ["strace", "-f", "-tt", "-s", "65535", "-y", "-e", CALLS, "-o", str(trace)]
    argv += [sys.executable, "-m", "labos", "up", "rpl", "--simulate", "--speed", "500", "--quiet"]
    argv += ["--home", str(home), "--no-nodes"]
    with (home / "up.log").open("wb") as log:
        lab = subprocess.Popen(argv, stdout=log, stderr=log)
    nodes = []
    try:
        give_up = time.monotonic() + 60
        while find_kernel(home) is None:
            assert time.monotonic() < give_up, (home / "up.log").read_text()
            time.sleep(0.1)
        info = find_kernel(home)
        assert info is not None
        for driver in ("sciclops", "pf400"):
            argv = [sys.executable, "-m", "labos", "node", "start", driver, "--name", driver]
            argv += ["--workcell", "rpl", "--simulate", "--home", str(home), "--connect", info.bus]
            nodes.append(subprocess.Popen(argv, stderr=subprocess.DEVNULL))
        with LabClient(home=home) as client:
            while time.monotonic() < give_up:
                try:
                    run = client.submit(find_spec("workflows", "cp_newplate"), {}, user="ada", request="one")
                    break
                except LabosError:
                    time.sleep(0.2)
            assert client.wait(run, timeout_s=60).succeeded
    finally:
        for node in nodes:
            node.terminate()
        info = find_kernel(home)
        if info is not None:
            os.kill(info.pid, signal.SIGINT)  # strace itself does not pass signals on
        try:
            for process in (*nodes, lab):
                process.wait(60)
        finally:
            for process in (*nodes, lab):
                process.kill()


@pytest.mark.skipif(shutil.which("strace") is None, reason="strace is not installed (package strace)")
@pytest.mark.timeout(180)
def test_a_request_is_synced_before_it_is_sent(tmp_path: Path) -> None:
    home, trace = tmp_path / "lab", tmp_path / "trace"
    home.mkdir()
    trace_run(home, trace)
    lines = trace.read_text(errors="replace").splitlines()
    sends = [
        (number, match.group(1))
        for number, line in enumerate(lines)
        if "socket:" in line or "TCP:" in line
        for match in [re.search(r'\\"op\\":\\"start\\".*?\\"action\\":\\"([0-9a-f-]{36})', line)]
        if match
    ]
    assert len({action for _, action in sends}) >= 2
    for sent_at, action in sends:
        written_at = max(
            (
                n
                for n in range(sent_at)
                if "labos.db-wal" in lines[n] and "write" in lines[n] and action in lines[n]
            ),
            default=None,
        )
        assert written_at is not None, f"{action} was sent before it was written"
        synced = [
            n
            for n in range(written_at + 1, sent_at)
            if re.search(r"(fsync|fdatasync)\(\d+<[^>]*labos\.db-wal>", lines[n])
        ]
        assert synced, f"{action} was sent at line {sent_at} without a sync after line {written_at}"

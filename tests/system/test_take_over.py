"""`labos take-over`: an upgrade without a stop. Two versions, real Postgres, real nodes, runs going on."""

from __future__ import annotations

import itertools
import json
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from labos.cli.take_over import expect_to_listen
from labos.core.actions import ActionRequested
from labos.core.lab import KernelStarted
from labos.core.registry import decode
from labos.errors import Refused
from tests.support.lab_process import Up, labos, statuses, until
from tests.support.other_version import copy_as
from tests.system.test_standby import AWAY, CELL, Pair, await_requests

pytestmark = [pytest.mark.postgres, pytest.mark.timeout(240)]

NEWER = "9.9.1"
LEASE_S = 6.0


@pytest.fixture
def pair(tmp_path: Path, postgres_url: str) -> Iterator[Pair]:
    made = Pair(tmp_path, postgres_url, 60.0)
    made.second.environment = {
        "PYTHONPATH": copy_as(NEWER, tmp_path / "newer"),
        "PYTHONSAFEPATH": "1",  # the folder of the tests holds the older version
    }
    (tmp_path / "rpl.yaml").write_text(CELL)
    (tmp_path / "away.yaml").write_text(AWAY)
    yield made
    made.clean_up()


def take_over(pair: Pair, before: Up, after: Up) -> dict[str, object]:
    """The kernel leaves the lab to the other one, and ends."""
    done = labos("take-over", "--json", "--home", str(pair.home))
    assert done.returncode == 0, f"{done.stdout}{done.stderr}{after.read_log()}"
    told: dict[str, object] = json.loads(done.stdout)
    assert before.process is not None
    assert before.process.wait(30) == 0, before.read_log()
    until(after.is_there, "the other kernel answers")
    return told


@pytest.mark.slow
def test_a_newer_version_takes_over_and_gives_back(
    pair: Pair, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pair.start(str(tmp_path / "rpl.yaml"))
    with pair.first.client() as client:
        runs = [client.submit(tmp_path / "away.yaml", user=user) for user in ("ada", "bo", "cy")]
    await_requests(pair, 2)
    there = take_over(pair, pair.first, pair.second)
    assert there["stood_by"] == [f"{NEWER} on {_host()}"]
    nodes = pair.nodes()
    back = Up(pair.home, "--standby", *pair.first.options[3:])
    said = len((pair.home / "up.log").read_text())
    back.launch()
    try:
        until(lambda: "Standing by" in (pair.home / "up.log").read_text()[said:], "the older one stands by")
        asked = pair.first.types().count("action.requested")
        with pair.second.client() as client:  # on a busy machine the others have ended by now
            runs += [client.submit(tmp_path / "away.yaml", user=user) for user in ("di", "ed", "flo")]
        await_requests(pair, asked + 1)
        here = take_over(pair, pair.second, back)
        with back.client() as client:
            assert statuses(client, runs) == ["completed"] * len(runs), back.read_log()
            modules = client.state(waits=False)["modules"]
        assert {m["name"]: m["process"]["pid"] for m in modules} == nodes, "its nodes are the same"
        assert back.interrupt() == 0
    finally:
        back.clean_up()
    starts = sound(back)
    pauses = [float(str(told["without_kernel_s"])) for told in (there, here)]
    assert max(pauses) < LEASE_S / 2
    with capsys.disabled():
        longest = max(after - before for before, after in itertools.pairwise(starts))
        print(f"\nwithout a kernel for {pauses[0]:.2f} and {pauses[1]:.2f} s; longest pause {longest:.2f} s")


def sound(lab: Up) -> list[float]:
    """No step was lost or repeated, by the devices' own account; returns when each was asked for (s)."""
    assert lab.disagreements() == []
    assert len(lab.motions("grip")) == 3 * 6
    assert len(lab.motions("discard")) == 6
    types = lab.types()
    assert types.count("run.completed") == 6
    assert not {"intervention.requested", "action.unknown"} & set(types)
    starts, told, epochs = [], set(), []
    for record in lab.records():
        event = decode(record.head.type, record.head.schema, record.payload)
        if isinstance(event, ActionRequested):
            assert (event.action, event.attempt) not in told
            told.add((event.action, event.attempt))
            starts.append(record.head.recorded_at / 1e9)
        elif isinstance(event, KernelStarted):
            epochs.append(event.epoch)
    assert epochs == [1, 2, 3]
    assert len({action for action, _ in told}) == 3 * 6  # one that was not sent yet is asked for once more
    return starts


@pytest.mark.slow
def test_a_kernel_that_nobody_could_follow_stays(tmp_path: Path, postgres_url: str) -> None:
    """This lab has no standby; or its nodes would end with it."""
    lab = Up(tmp_path / "lab", "--simulate", "--speed", "300", "--database", postgres_url)
    cell = tmp_path / "rpl.yaml"
    cell.write_text(CELL)
    try:
        lab.start(str(cell))
        refused = labos("take-over", "--home", str(lab.home))
        assert refused.returncode == 1
        assert "This lab has no standby" in refused.stderr
        assert lab.is_there()
        assert lab.interrupt() == 0
        none = labos("take-over", "--home", str(lab.home))
        assert none.returncode == 1
        assert "No kernel runs" in none.stderr
    finally:
        lab.clean_up()


@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="only Linux tells")
def test_a_kernel_of_an_earlier_version_is_not_ended(tmp_path: Path) -> None:
    """One that does not listen to the signal would end by it."""
    for listens, code in (
        (False, "import time; print('here', flush=True); time.sleep(60)"),
        (
            True,
            "import signal, time; signal.signal(signal.SIGUSR1, lambda *_: None); print('here', flush=True); "
            "time.sleep(60)",
        ),
    ):
        process = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True)
        try:
            assert process.stdout is not None
            assert process.stdout.readline() == "here\n"
            if listens:
                expect_to_listen(process.pid, signal.SIGUSR1)
            else:
                with pytest.raises(Refused, match="earlier version"):
                    expect_to_listen(process.pid, signal.SIGUSR1)
            assert process.poll() is None
        finally:
            process.kill()
            process.wait()
            process.stdout.close()


def _host() -> str:
    import socket

    return socket.gethostname()

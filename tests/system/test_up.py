"""``labos up`` on real processes: interrupted, killed, started twice, on taken ports."""

from __future__ import annotations

import os
import re
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from labos.core.canonical import digest
from labos.settings import find_kernel
from tests.support.cells import PCR
from tests.support.lab_process import Up, labos, statuses, until

SPECS = Path(__file__).parents[2] / "specs"


HOME = "labos: 1\nname: w\nsteps:\n  - {name: home, module: sciclops, action: home}\n"


@pytest.fixture
def lab(tmp_path: Path) -> Iterator[Up]:
    up = Up(tmp_path / "lab")
    yield up
    up.clean_up()


def begin_home(lab: Up) -> str:
    """Submit a run whose only step moves for 30 s, and wait until it moves; returns the run's id."""
    (lab.home / "wf.yaml").write_text(HOME)
    with lab.client() as client:
        run = client.submit(lab.home / "wf.yaml", user="ada")
        until(lambda: "action.accepted" in lab.types(), "it moves")
    return run


def make_cycling(lab: Up) -> bool:
    """Whether the thermocycler was told to run its programme."""
    return any(
        record.head.type == "action.requested" and b'"name":"run_program"' in record.payload
        for record in lab.records()
    )


@pytest.mark.smoke
def test_interrupted_it_goes_on_where_it_was(lab: Up) -> None:
    lab.options = ("--simulate", "--speed", "5000")
    lab.start_with(*PCR)
    with lab.client() as client:
        runs = [client.submit("pcr", user=user) for user in ("ada", "bo")]
        until(lambda: make_cycling(lab), "the thermocycler works")
    assert lab.interrupt() == 0, lab.read_log()
    assert find_kernel(lab.home) is None
    # What was under way was finished: nobody has to be asked.
    assert "action.unknown" not in lab.types()
    assert lab.disagreements() == []
    lab.options = ()
    lab.start()
    with lab.client() as client:
        assert statuses(client, runs) == ["completed", "completed"]
        assert client.health()["epoch"] == 2
    assert lab.interrupt() == 0
    assert lab.disagreements() == []
    assert "intervention.requested" not in lab.types()
    # The robots were given the protocol as it was when the runs were submitted.
    pinned = digest((SPECS / "workflows/protocols/pcr_prep.yaml").read_bytes())
    ran = [motion.facts["protocol"] for motion in lab.motions("pipette")]
    assert set(ran) == {pinned}


@pytest.mark.parametrize(
    "detach",
    [
        pytest.param((), id="attached", marks=pytest.mark.full),
        pytest.param(("--detach-nodes",), id="detached"),
    ],
)
def test_killed_it_goes_on_where_it_was(lab: Up, detach: tuple[str, ...]) -> None:
    lab.options = ("--simulate", "--speed", "3000", *detach)
    lab.start_with(*PCR)
    with lab.client() as client:
        run = client.submit("pcr", user="ada")
        until(lambda: make_cycling(lab), "the thermocycler works")
        nodes = {m["name"]: m["process"]["pid"] for m in client.state()["modules"]}
    lab.kill()
    assert find_kernel(lab.home) is None
    # As if the kernel had died between the start of this node and its note about it.
    (lab.home / "nodes" / "rpl.peeler.json").unlink()
    lab.options = detach
    lab.start()
    with lab.client() as client:
        assert statuses(client, [run]) == ["completed"]
        kept = {m["name"]: m["process"]["pid"] for m in client.state()["modules"]}
    assert (kept == nodes) is bool(detach)
    assert lab.interrupt() == 0, lab.read_log()
    assert lab.disagreements() == []
    assert lab.types().count("run.completed") == 1
    assert "intervention.requested" not in lab.types()


def test_a_second_kernel_is_refused(lab: Up, tmp_path: Path) -> None:
    lab.options = ("--simulate", "--speed", "2000", "--no-nodes")
    lab.start("rpl")
    database = f"sqlite:///{lab.home}/labos.db"
    other = str(tmp_path / "other")
    done = labos("up", "rpl", "--simulate", "--home", other, "--database", database)
    assert done.returncode == 1
    assert "Another kernel already runs the lab" in done.stderr
    assert "Traceback" not in done.stderr
    assert find_kernel(lab.home) is not None
    assert lab.interrupt() == 0
    # And it stays what it is.
    faster = labos("up", "rpl", "--speed", "3000", "--home", str(lab.home))
    assert (faster.returncode, "speed 2000" in faster.stderr) == (1, True)
    real = labos("up", "rpl", "--real", "--home", str(lab.home))
    assert (real.returncode, "simulated" in real.stderr) == (1, True)


def test_a_second_kernel_from_another_folder_leaves_nothing_there(lab: Up, tmp_path: Path) -> None:
    lab.options = ("--simulate", "--no-nodes")
    lab.start("rpl")
    there, other = f"sqlite:///{lab.home / 'labos.db'}", tmp_path / "other"
    (lab.home / "wf.yaml").write_text(HOME)
    refused = labos(
        *("run", str(lab.home / "wf.yaml"), "--simulate", "--home", str(other / "lab2"), "--database", there)
    )
    assert refused.returncode == 1
    assert re.search(r"Another kernel already runs the lab in .*: pid \d+ on [^ ()]+\. ", refused.stderr), (
        refused
    )
    assert not other.exists()


def test_what_is_cut_short_by_closing_is_said(lab: Up) -> None:
    lab.options = ("--simulate", "--speed", "1")
    lab.start_with("sciclops", "pf400")
    run = begin_home(lab)
    assert lab.process is not None
    lab.process.send_signal(signal.SIGINT)
    until(lambda: "for 30 s at most" in lab.read_log(), "it closes")
    assert lab.interrupt() == 0, "in a hurry"
    assert f"sciclops.home of {run} was interrupted: the next start finds out" in lab.read_log()


@pytest.mark.slow
def test_a_second_interrupt_is_not_lost_just_after_the_message(lab: Up) -> None:
    """The reader of a pipe is faster than the lab that has written to it."""
    lab.options = ("--simulate", "--speed", "1", "--quiet")
    lab.stdout = subprocess.PIPE
    lab.start_with("sciclops", "pf400")
    run = begin_home(lab)
    assert lab.process is not None
    assert lab.process.stdout is not None
    lab.process.send_signal(signal.SIGINT)
    printed = b""
    while b"for 30 s at most" not in printed:
        printed += os.read(lab.process.stdout.fileno(), 4096)
    lab.process.send_signal(signal.SIGINT)
    printed += lab.process.communicate(timeout=20)[0]  # less than the 30 s
    assert lab.process.returncode == 0
    assert f"sciclops.home of {run} was interrupted: the next start finds out" in printed.decode()


def test_a_port_in_use_is_named(lab: Up) -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = str(taken.getsockname()[1])
        for option in ("--bus-port", "--http-port"):
            done = labos("up", "rpl", "--simulate", "--no-nodes", "--home", str(lab.home), option, port)
            assert done.returncode == 1
            assert port in done.stderr
            assert re.search("in use|cannot be used", done.stderr)
            assert "Traceback" not in done.stderr
    # Nothing is left half-done: the same home starts on another port.
    lab.options = ("--no-nodes",)
    lab.start("rpl")
    assert lab.interrupt() == 0


def test_a_new_lab_has_to_be_told_whether_it_moves_real_instruments(tmp_path: Path) -> None:
    done = labos("up", "rpl", "--home", str(tmp_path / "lab"))
    assert done.returncode == 2
    assert "--simulate" in done.stderr
    assert not (tmp_path / "lab").exists()


def test_a_node_by_hand_finds_its_lab(lab: Up) -> None:
    argv = [sys.executable, "-m", "labos", "node", "start"]
    argv += ["--name", "sealer", "--workcell", "rpl", "--simulate", "--home", str(lab.home)]
    node = subprocess.Popen(argv, stdin=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        # It may be there first.
        lab.options = ("--simulate", "--speed", "2000", "--no-nodes")
        lab.start("rpl")
        with lab.client() as client:

            def has_joined() -> bool:
                modules = client.state(waits=False)["modules"]
                return any(m["name"] == "rpl/sealer" and m["status"] == "IDLE" for m in modules)

            until(has_joined, "the node has joined")
            # Its kernel is killed, and another takes over.
            lab.kill()
            lab.options = ("--no-nodes",)
            lab.start()
            until(lambda: lab.types().count("node.joined") >= 1 and has_joined(), "the node is back")
        node.terminate()
        assert node.wait(10) == 0
        assert lab.interrupt() == 0
    finally:
        if node.poll() is None:
            node.kill()
            node.wait()

"""Nodes that are forks of one process: they are told apart, told of, and outlive it."""

from __future__ import annotations

import asyncio
import os
import signal
import socket
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import msgspec
import pytest

from labos.clock import SystemClock
from labos.runtime.fork_server import PACKET, StartChild
from labos.runtime.spawning import PYTHON, ForkServer
from labos.runtime.supervisor import NodeCommand, Supervisor
from labos.settings import Settings, is_alive
from tests.support.processes import run_process

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="nodes are forks on Linux only")


def waiting_node(home: Path, name: str) -> NodeCommand:
    """A node whose lab never comes: it waits until nobody attends it."""
    words = ("--name", name, "--workcell", "cell", "--home", str(home), "--with-parent")
    return NodeCommand(f"cell/{name}", (*PYTHON, "node", "start", "a4s_sealer", *words))


def keeper_of(folder: Path, server: ForkServer) -> Supervisor:
    notes, logs = folder / "nodes", folder / "logs"
    return Supervisor(notes, logs, SystemClock(), is_alive, Settings.make(folder).journal, spawner=server)


async def until(holds: Callable[[], object], patience_s: float = 30.0) -> None:
    async with asyncio.timeout(patience_s):
        while not holds():  # noqa: ASYNC110 - what is looked at tells nobody
            await asyncio.sleep(0.01)


async def all_wait(keeper: Supervisor) -> None:
    """Every node's process has come as far as it can without a lab."""
    for module, node in keeper.nodes.items():
        log = keeper.find_log(module)
        await until(lambda node=node, log=log: node.pid and "waiting_for_the_lab" in log.read_text())


def parent_of(pid: int) -> int:
    return int(Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[1])


def find_shown_name(pid: int) -> str:
    """What `ps` shows of a process."""
    return Path(f"/proc/{pid}/cmdline").read_text()


def test_nodes_are_forks_with_names_logs_and_sessions_of_their_own(tmp_path: Path) -> None:
    async def main() -> None:
        server = ForkServer(tmp_path / "server.log", is_alive)
        keeper = keeper_of(tmp_path, server)
        keeper.start([waiting_node(tmp_path, name) for name in ("a", "b")])
        await all_wait(keeper)
        a, b = keeper.nodes["cell/a"], keeper.nodes["cell/b"]
        assert {parent_of(a.pid), parent_of(b.pid)} == {server.pid}
        assert len({os.getsid(pid) for pid in (os.getpid(), server.pid, a.pid, b.pid)}) == 4
        assert find_shown_name(b.pid).startswith("labos node start a4s_sealer --name b")
        pids = server.pid, a.pid, b.pid
        assert await keeper.close() == []
        assert not any(map(is_alive, pids))
        assert not (tmp_path / "server.log").read_text()

    asyncio.run(main())


def test_the_server_tells_how_a_node_ended(tmp_path: Path) -> None:
    async def main() -> None:
        server = ForkServer(tmp_path / "server.log", is_alive)
        child = await server.spawn((*PYTHON, "node", "start", "a4s_sealer"), tmp_path / "log", attended=True)
        await until(lambda: child.poll() is not None)
        assert child.poll() == 2
        assert "Missing option '--name'" in (tmp_path / "log").read_text()
        node = waiting_node(tmp_path, "a")
        killed = await server.spawn(node.argv, tmp_path / "a.log", attended=True)
        os.kill(killed.pid, signal.SIGKILL)
        await until(lambda: killed.poll() is not None)
        assert killed.poll() == -signal.SIGKILL
        server.close()

    asyncio.run(main())


def test_nodes_outlive_their_server_and_the_next_has_another(tmp_path: Path) -> None:
    async def main() -> None:
        server = ForkServer(tmp_path / "server.log", is_alive)
        keeper = keeper_of(tmp_path, server)
        keeper.start([waiting_node(tmp_path, name) for name in ("a", "b")])
        await all_wait(keeper)
        a, b, first = keeper.nodes["cell/a"], keeper.nodes["cell/b"], server.pid
        stays = a.pid
        os.kill(first, signal.SIGKILL)
        await until(lambda: server.pid == 0)
        os.kill(b.pid, signal.SIGKILL)
        await until(lambda: b.starts == 2 and b.state == "running")
        assert server.pid not in (0, first)
        assert (a.pid, a.starts, a.state) == (stays, 1, "running")
        assert parent_of(b.pid) == server.pid
        await keeper.close()
        assert not is_alive(stays)

    asyncio.run(main())


def test_a_frozen_server_is_done_without(tmp_path: Path) -> None:
    async def main() -> None:
        server = ForkServer(tmp_path / "server.log", is_alive, patience_s=10.0)
        node = waiting_node(tmp_path, "a")
        first = await server.spawn(node.argv, tmp_path / "a.log", attended=True)
        frozen = server.pid
        os.kill(frozen, signal.SIGSTOP)
        server._patience_s = 0.2
        second = await server.spawn(node.argv, tmp_path / "b.log", attended=True)
        assert not is_alive(frozen)
        assert parent_of(second.pid) == os.getpid()
        for child in (first, second):
            child.close_stdin()
        await until(lambda: first.poll() is not None and second.poll() is not None)

    asyncio.run(main())


def test_the_server_ends_without_an_error_if_its_kernel_dies_before_an_answer(tmp_path: Path) -> None:
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    argv = [*PYTHON, "node", "fork-server", str(theirs.fileno())]
    with (
        theirs,
        (tmp_path / "server.log").open("wb") as log,
        run_process(argv, stdin=subprocess.DEVNULL, stderr=log, pass_fds=(theirs.fileno(),)) as server,
    ):
        theirs.close()
        socket.send_fds(ours, [msgspec.json.encode(StartChild(("--version",)))], [0, log.fileno()])
        assert ours.recv(PACKET, socket.MSG_PEEK)  # the answer is there, and stays unread
        ours.close()
        assert server.wait(30) == 0
    assert "reset" not in (tmp_path / "server.log").read_text()


def test_the_server_ends_with_its_kernel(tmp_path: Path) -> None:
    code = (
        "import asyncio, sys; from pathlib import Path\n"
        "from labos.runtime.spawning import ForkServer; from labos.settings import is_alive\n"
        "async def main():\n"
        "    server = ForkServer(Path(sys.argv[1]), is_alive)\n"
        "    child = await server.spawn(sys.argv[2:], Path(sys.argv[1]), attended=True)\n"
        "    print(server.pid, child.pid, flush=True); await asyncio.sleep(600)\n"
        "asyncio.run(main())"
    )
    argv = waiting_node(tmp_path, "a").argv
    argv = [sys.executable, "-c", code, str(tmp_path / "log"), *argv]
    with run_process(argv, stdout=subprocess.PIPE, text=True) as kernel:
        assert kernel.stdout is not None
        server, node = map(int, kernel.stdout.readline().split())
    asyncio.run(until(lambda: not is_alive(server) and not is_alive(node)))

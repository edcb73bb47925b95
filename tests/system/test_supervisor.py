"""Node processes that crash, that never start, that will not stop, and that were left behind."""

from __future__ import annotations

import asyncio
import json
import os
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

from labos.clock import SystemClock
from labos.node.journal_file import find_process
from labos.runtime.supervisor import NodeCommand, Supervisor
from labos.settings import Settings, is_alive
from tests.support.processes import run_process


def command(name: str, code: str) -> NodeCommand:
    return NodeCommand(f"cell/{name}", (sys.executable, "-c", code, name))


def supervisor(folder: Path, *, detach: bool = False, patience: int = 3) -> Supervisor:
    notes, logs = folder / "nodes", folder / "logs"
    journal = Settings.make(folder).journal
    return Supervisor(notes, logs, SystemClock(), is_alive, journal, detach=detach, patience=patience)


async def until(holds: Callable[[], object], patience_s: float = 15.0) -> None:
    async with asyncio.timeout(patience_s):
        while not holds():  # noqa: ASYNC110 - what is looked at tells nobody
            await asyncio.sleep(0.01)


ENDS_WITH_PARENT = "import sys; print('up', flush=True); sys.stdin.read()"
STUBBORN = "import time; print('up', flush=True); time.sleep(600)"


def test_a_crashed_node_is_started_again(tmp_path: Path) -> None:
    async def main() -> None:
        keeper = supervisor(tmp_path)
        keeper.start([command("a", ENDS_WITH_PARENT)])
        node = keeper.nodes["cell/a"]
        await until(lambda: node.pid and "up" in keeper.find_log("cell/a").read_text())
        first = node.pid
        os.kill(first, signal.SIGKILL)
        await until(lambda: node.starts == 2 and node.state == "running")
        assert node.pid != first
        await keeper.close()
        assert node.state == "stopped"
        assert not is_alive(node.pid)

    asyncio.run(main())


def test_a_node_that_cannot_start_is_given_up_with_its_reason(tmp_path: Path) -> None:
    async def main() -> None:
        keeper = supervisor(tmp_path, patience=2)
        broken = command("b", "import sys; sys.exit('labos: there is no such device')")
        keeper.start([broken, NodeCommand("cell/c", ("/nowhere/python",))])
        b, c = keeper.nodes["cell/b"], keeper.nodes["cell/c"]
        await until(lambda: b.state == c.state == "quarantined")
        assert (b.starts, b.why) == (2, "labos: there is no such device")
        assert "cannot be started" in c.why
        await keeper.close()

    asyncio.run(main())


def test_a_node_that_will_not_stop_is_killed_when_its_time_is_over(tmp_path: Path) -> None:
    async def main() -> None:
        keeper = supervisor(tmp_path)
        keeper.start([command("d", STUBBORN)])
        node = keeper.nodes["cell/d"]
        await until(lambda: node.pid)
        pid = node.pid
        await keeper.close(grace_s=0.1)
        assert not is_alive(pid)

    asyncio.run(main())


def test_a_detached_node_is_found_again(tmp_path: Path) -> None:
    async def main() -> None:
        first = supervisor(tmp_path, detach=True)
        first.start([command("e", STUBBORN)])
        await until(lambda: first.nodes["cell/e"].pid)
        pid = first.nodes["cell/e"].pid
        # Its kernel dies: nobody keeps it any more.
        for task in first._tasks.values():
            task.cancel()
        second = supervisor(tmp_path, detach=True)
        second.start([command("e", STUBBORN)])
        node = second.nodes["cell/e"]
        await until(lambda: node.state == "running")
        assert (node.pid, node.starts) == (pid, 0)
        first._children["cell/e"].poll()
        stopping = asyncio.create_task(second.close())
        await until(lambda: first._children["cell/e"].poll() is not None)
        await stopping
        assert node.state == "stopped"

    asyncio.run(main())


def test_a_node_that_nobody_noted_is_found_by_its_journal(tmp_path: Path) -> None:
    """The kernel died between the start of a detached node and its note about it."""
    journal = Settings.make(tmp_path).journal("cell/f")
    code = (
        "import sys, time; from pathlib import Path\n"
        "from labos.node.journal_file import FileJournalFile\n"
        "file = FileJournalFile(Path(sys.argv[2])); print('up', flush=True); time.sleep(600)"
    )
    argv = [sys.executable, "-c", code, "f", str(journal)]

    async def main(unnoted: subprocess.Popen[str]) -> None:
        assert unnoted.stdout is not None
        assert unnoted.stdout.readline() == "up\n"
        keeper = supervisor(tmp_path, detach=True)
        keeper.start([NodeCommand("cell/f", tuple(argv))])
        node = keeper.nodes["cell/f"]
        await until(lambda: node.pid)
        assert (node.pid, node.starts, node.state) == (unnoted.pid, 0, "running")
        assert json.loads((tmp_path / "nodes" / "cell.f.json").read_text())["pid"] == unnoted.pid
        unnoted.kill()
        unnoted.wait()
        await until(lambda: node.starts == 1 and "up" in keeper.find_log("cell/f").read_text())
        assert find_process(journal) == node.pid
        await keeper.close()
        assert find_process(journal) == 0

    with run_process(argv, stdout=subprocess.PIPE, text=True) as unnoted:
        asyncio.run(main(unnoted))

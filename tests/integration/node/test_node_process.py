"""Nodes in processes of their own, killed at the worst moment."""

from __future__ import annotations

import asyncio
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from labos.clock import Uuid7Ids
from labos.node.journal import Journal
from labos.node.journal_file import FileJournalFile
from tests.integration.bus.contract import until
from tests.integration.node.bench import Kernel, bench
from tests.integration.ports import free_endpoint

ROOT = Path(__file__).parents[3]


@contextmanager
def node_process(endpoint: str, folder: Path, *options: str) -> Iterator[subprocess.Popen[bytes]]:
    """A node in a process of its own, which does not outlive the test, however that ends."""
    command = [sys.executable, "-m", "tests.integration.node.node_process", endpoint, str(folder), *options]
    with subprocess.Popen(command, cwd=ROOT) as process:
        try:
            yield process
        finally:
            process.kill()


async def await_connected(kernel: Kernel) -> None:
    """The node answers, and has connected its device: before that it is busy with just this."""
    await until(lambda: any(kernel.alive.values()), 10.0)
    kernel.journal = (await kernel.about()).journal
    async with asyncio.timeout(10.0):
        while (await kernel.state()).status == "BUSY":  # noqa: ASYNC110 - another process
            await asyncio.sleep(0.01)


def test_a_node_process_acts_is_killed_and_remembers(tmp_path: Path) -> None:
    async def main() -> None:
        endpoint = free_endpoint()
        async with bench(tmp_path, endpoint) as here:
            kernel = here.kernel
            with node_process(endpoint, tmp_path) as process:
                await await_connected(kernel)
                await kernel.start("a1", times=3)
                published = await kernel.outcome("a1")
                assert (await kernel.ask("a1")).outcome == published
                await kernel.start("a2", "wait")
                await until(lambda: len(here.world.motions("wait")) == 1)
                process.kill()
                killed = time.monotonic()
                await until(lambda: not any(kernel.alive.values()), 2.0)
                assert time.monotonic() - killed < 1.0
            journal = kernel.journal
            with node_process(endpoint, tmp_path) as process:
                await await_connected(kernel)
                assert kernel.journal == journal
                again = await kernel.ask("a1")
                assert (again.status, again.outcome) == ("finished", published)
                assert (await kernel.start("a2", "wait")).status == "interrupted"
                assert (await kernel.start("a3")).status == "finished"
                await kernel.outcome("a3")
                assert (await kernel.admin("shutdown")).done
                assert process.wait(10.0) == 0
            assert [m.verb for m in here.world.motions()] == ["wave", "wait", "wave"]

    asyncio.run(main())


def test_a_reset_whose_node_is_killed_is_interrupted_and_not_repeated(tmp_path: Path) -> None:
    async def main() -> None:
        endpoint = free_endpoint()
        async with bench(tmp_path, endpoint) as here:
            kernel = here.kernel
            with node_process(endpoint, tmp_path, "--slow-reset") as process:
                await await_connected(kernel)
                assert (await kernel.reset("a1")).status == "accepted"
                await until(lambda: len(here.world.motions("reset")) == 1)
                process.kill()
                await until(lambda: not any(kernel.alive.values()), 2.0)
            with node_process(endpoint, tmp_path) as process:
                await await_connected(kernel)
                assert [(o.name, o.status) for o in (await kernel.about()).open] == [("reset", "interrupted")]
                assert (await kernel.reset("a1")).status == "interrupted"
                assert (await kernel.ask("a1", void=True)).status == "interrupted"
                assert (await kernel.recover("a2")).succeeded
                await kernel.admin("shutdown")
                assert process.wait(10.0) == 0
            assert len(here.world.motions("reset")) == 2

    asyncio.run(main())


WRITER = """
import asyncio, sys
from labos.clock import Uuid7Ids
from labos.node import journal as module
from labos.node.journal_file import FileJournalFile
from labos.node.protocol import Outcome
module.COMPACT_BYTES = 3000
async def main():
    journal = await module.Journal.open(FileJournalFile(sys.argv[1]), Uuid7Ids())
    first = max([int(a.action) for a in journal.memory.list_attempts()], default=journal.memory.pruned) + 1
    for n in range(first, first + 100000):
        journal.accept(str(n), 1, n, "work")
        await journal.sync()
        print("accepted", n, flush=True)
        journal.end(str(n), 1, Outcome(True, "all", "x" * 50))
        journal.prune(n - 20)
        await journal.sync()
        print("ended", n, flush=True)
asyncio.run(main())
"""


@pytest.mark.slow
def test_a_journal_whose_process_is_killed_while_it_writes(tmp_path: Path) -> None:
    """What was answered for before the kill is there after it, compactions included."""
    path = tmp_path / "killed.journal"

    async def check(said: list[str]) -> None:
        journal = await Journal.open(FileJournalFile(path), Uuid7Ids())
        try:
            for line in said:
                verb, number = line.split()
                if journal.memory.is_forgotten(int(number)):
                    continue
                attempt = journal.memory.find(number, 1)
                assert attempt is not None, line
                assert verb == "accepted" or attempt.status == "finished", line
        finally:
            await journal.close()

    for round_ in range(6):
        command = [sys.executable, "-c", WRITER, str(path)]
        with subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, text=True) as process:
            assert process.stdout is not None
            # Killed at another place each time, in the midst of its writing.
            said = [process.stdout.readline() for _ in range(40 + 37 * round_)]
            process.kill()
            said += process.stdout.readlines()
        asyncio.run(check([line for line in said if line.endswith("\n")]))

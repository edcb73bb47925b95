"""``labos node reset-epoch``: a journal that was told an epoch or a position that cannot be."""

from __future__ import annotations

import asyncio
from pathlib import Path

from click.testing import CliRunner

from labos.cli.app import group
from labos.clock import Uuid7Ids
from labos.errors import LabosError
from labos.node.journal import Journal, Memory, read_journal
from labos.node.journal_file import FileJournalFile
from labos.node.protocol import Outcome
from tests.integration.node.bench import LAB, Bench
from tests.integration.node.test_node_server import Check, check

__all__ = ["check"]

DONE = Outcome(True, "all")


async def poison(path: Path) -> Journal:
    """As an older LabOS let itself be told."""
    journal = await Journal.open(FileJournalFile(path), Uuid7Ids())
    journal.bind(LAB)
    journal.raise_epoch(7)
    journal.accept("a1", 1, 11, "wave")
    journal.end("a1", 1, DONE)
    journal.raise_epoch(2**62)
    journal.rewind(0)
    await journal.sync()
    return journal


def reset_epoch(home: Path, *options: str, code: int = 0) -> str:
    words = ("node", "reset-epoch", "cell/arm", "--home", str(home), "--user", "ada", *options)
    result = CliRunner().invoke(group, words)
    told = result.output + (str(result.exception) if isinstance(result.exception, LabosError) else "")
    assert result.exit_code == code, told
    return told


def read(path: Path) -> Memory:
    return read_journal(path.read_bytes())


def test_an_absurd_epoch_is_put_right_and_what_was_done_stays(tmp_path: Path) -> None:
    path = tmp_path / "journals" / "cell.arm.journal"

    async def main() -> None:
        journal = await poison(path)
        await journal.close()

    asyncio.run(main())
    told = reset_epoch(tmp_path, "--epoch", "8", "--why", "a script sent 2^62")
    assert f"epoch 8, acknowledged up to position 0 (it was epoch {2**62}" in told
    after = read(path)
    assert after.epoch == 8
    assert [(a.action, a.status, a.outcome) for a in after.list_attempts()] == [("a1", "finished", DONE)]
    for line in (path.read_text(), "".join(str(c) for c in after.corrections)):
        assert "ada" in line
        assert "a script sent 2^62" in line


def test_an_absurd_position_is_put_right(tmp_path: Path) -> None:
    path = tmp_path / "journals" / "cell.arm.journal"

    async def main() -> None:
        journal = await poison(path)
        journal.prune(2**60)
        await journal.sync()
        await journal.close()

    asyncio.run(main())
    reset_epoch(tmp_path, "--epoch", "8", "--position", "40", "--why", "acknowledged too much")
    after = read(path)
    assert (after.epoch, after.pruned) == (8, 40)
    assert after.is_forgotten(40)
    assert not after.is_forgotten(41)


def test_it_is_refused_while_the_node_runs_and_where_it_would_raise(tmp_path: Path) -> None:
    path = tmp_path / "journals" / "cell.arm.journal"

    async def main() -> None:
        journal = await poison(path)
        before = path.read_bytes()
        told = await asyncio.to_thread(reset_epoch, tmp_path, "--epoch", "8", "--why", "x", code=1)
        assert "in use by another process" in told
        assert path.read_bytes() == before
        await journal.close()

    asyncio.run(main())
    before = path.read_bytes()
    assert "cannot be set" in reset_epoch(tmp_path, "--epoch", str(2**62 + 1), "--why", "x", code=1)
    assert "cannot be set" in reset_epoch(tmp_path, "--position", "1", "--why", "x", code=1)
    assert "--epoch, --position or both" in reset_epoch(tmp_path, "--why", "x", code=2)
    assert path.read_bytes() == before
    assert "There is no journal" in reset_epoch(tmp_path / "other", "--epoch", "8", "--why", "x", code=1)
    assert not (tmp_path / "other").exists()


def test_a_module_that_obeyed_nobody_works_again(check: Check, tmp_path: Path) -> None:
    async def scenario(here: Bench) -> None:
        path = tmp_path / "journals" / "cell.arm.journal"
        journal = await poison(path)
        await journal.close()
        server = await here.node(file=FileJournalFile(path))
        here.kernel.epoch = 9
        assert (await here.kernel.start("a2")).status == "fenced"
        await server.close()
        await asyncio.to_thread(reset_epoch, tmp_path, "--epoch", "8", "--why", "a script sent 2^62")
        await here.node(file=FileJournalFile(path))
        assert (await here.kernel.start("a2")).status == "finished"

    check(scenario)

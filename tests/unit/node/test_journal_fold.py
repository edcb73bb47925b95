"""Whatever a node does with its journal, the file folds to what the node remembers."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Coroutine
from copy import deepcopy
from pathlib import Path
from typing import Any

import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, precondition, rule

from labos.node._memory import Memory
from labos.node._records import write_line
from labos.node.journal import Attempt, Journal, JournalError, read_journal
from labos.node.protocol import Outcome
from tests.unit.node.memory import Counter, MemoryFile

JOURNALS = Path(__file__).parent / "journals"


def memory(journal: Journal) -> Memory:
    return deepcopy(journal.memory)


def restart(memory: Memory) -> Memory:
    """What is left of a node's memory when its process is gone."""
    after = deepcopy(memory)
    for attempt in after.list_attempts():
        if attempt.status == "running":
            attempt.status = "interrupted"
    return after


class FoldMachine(RuleBasedStateMachine):
    """Every way to change a journal's memory, and every way to lose the process."""

    @initialize()
    def begin(self) -> None:
        self.loop = asyncio.new_event_loop()
        self.file = MemoryFile()
        self.journal = self.wait(Journal.open(self.file, Counter("j")))
        self.synced = memory(self.journal)
        self.numbers = 0

    def wait(self, coroutine: Coroutine[Any, Any, Any]) -> Any:
        return self.loop.run_until_complete(coroutine)

    def attempts(self, *statuses: str) -> list[Attempt]:
        return [attempt for attempt in self.journal.memory.list_attempts() if attempt.status in statuses]

    def sync(self) -> None:
        self.wait(self.journal.sync())
        self.synced = memory(self.journal)

    # -- what changes it ---------------------------------------------------------------------

    @rule(action=st.sampled_from("abc"), attempt=st.integers(1, 3), position=st.integers(1, 30))
    def accept(self, action: str, attempt: int, position: int) -> None:
        with contextlib.suppress(ValueError):
            self.journal.accept(action, attempt, position, "work")

    @precondition(lambda self: self.attempts("running"))
    @rule(data=st.data(), n=st.integers(0, 9))
    def end(self, data: st.DataObject, n: int) -> None:
        one = data.draw(st.sampled_from(self.attempts("running")), "attempt")
        self.journal.end(one.action, one.attempt, Outcome(n % 2 == 0, "all", {"n": n}, "e" * n, n, n))

    @precondition(lambda self: self.attempts("running"))
    @rule(data=st.data())
    def note_handle(self, data: st.DataObject) -> None:
        one = data.draw(st.sampled_from(self.attempts("running")), "attempt")
        self.journal.note_handle(one.action, one.attempt, "run-17")

    @precondition(lambda self: self.attempts("interrupted"))
    @rule(data=st.data())
    def take_up(self, data: st.DataObject) -> None:
        self.journal.take_up(data.draw(st.sampled_from(self.attempts("interrupted")), "attempt"))

    @precondition(lambda self: self.attempts("running"))
    @rule(data=st.data())
    def give_up(self, data: st.DataObject) -> None:
        one = data.draw(st.sampled_from(self.attempts("running")), "attempt")
        self.journal.give_up(one, "the device cannot say")

    @rule(action=st.sampled_from("abc"), attempt=st.integers(1, 3), position=st.integers(1, 30))
    def void(self, action: str, attempt: int, position: int) -> None:
        self.journal.forbid_attempts(action, attempt, position)

    @rule(position=st.integers(1, 40))
    def prune(self, position: int) -> None:
        self.journal.prune(position)

    @rule(position=st.integers(0, 30))
    def rewind(self, position: int) -> None:
        self.journal.rewind(position)

    @rule()
    def bind(self) -> None:
        self.journal.bind("lab")

    @rule(epoch=st.integers(1, 9))
    def raise_epoch(self, epoch: int) -> None:
        self.journal.raise_epoch(epoch)

    # -- what keeps it -----------------------------------------------------------------------

    @precondition(lambda self: self.journal.memory.epoch or self.journal.memory.pruned)
    @rule(data=st.data())
    def correct(self, data: st.DataObject) -> None:
        epoch = data.draw(st.integers(0, self.journal.memory.epoch), "epoch")
        position = data.draw(st.integers(0, self.journal.memory.pruned), "position")
        self.journal.correct(epoch=epoch, position=position, by="ada", at_ns=1, why="a test")

    @rule()
    def write(self) -> None:
        self.sync()

    @rule()
    def compact_with_the_next_write(self) -> None:
        self.journal._compact_at = 0

    @rule(action=st.sampled_from("abc"), position=st.integers(1, 30))
    def fail_to_accept_and_mend(self, action: str, position: int) -> None:
        self.file.fail = True
        try:
            self.journal.accept(action, 3, position, "work")
        except ValueError:
            self.file.fail = False
            return
        with pytest.raises(JournalError):
            self.wait(self.journal.sync())
        self.journal.withdraw(action, 3)
        self.file.fail = False
        self.wait(self.journal.mend())
        self.sync()

    # -- what loses the process --------------------------------------------------------------

    @rule()
    def close_and_reopen(self) -> None:
        self.wait(self.journal.close())
        before = memory(self.journal)
        self.reopen(before)

    @rule(data=st.data())
    def crash(self, data: st.DataObject) -> None:
        """The last line was under way: any part of it may be there."""
        line = write_line(self.journal._queue) if self.journal._queue else b""
        there = data.draw(st.integers(0, len(line)), "bytes on disk")
        before = memory(self.journal) if there >= len(line) - 1 else self.synced
        self.file.data += line[:there]
        self.reopen(before)

    def reopen(self, before: Memory) -> None:
        self.journal = self.wait(Journal.open(self.file, Counter("other")))
        assert memory(self.journal) == restart(before)
        self.synced = memory(self.journal)

    def teardown(self) -> None:
        if hasattr(self, "loop"):
            self.loop.close()


TestFoldMachine = FoldMachine.TestCase
TestFoldMachine.settings = settings(max_examples=60, stateful_step_count=40, deadline=None)


# -- journals of older LabOSes -----------------------------------------------------------------


@pytest.mark.parametrize("name", ["every_record", "compacted"])
def test_an_older_journal_is_read_as_it_was_meant(name: str) -> None:
    journal = read_journal((JOURNALS / f"{name}.journal").read_bytes())
    assert (journal.id, journal.lab, journal.epoch) == ("j1", "lab", 1000)
    assert (journal.pruned, journal.pruned_by) == (13, 1000)
    assert {a.action: (a.attempt, a.position, a.name) for a in journal.list_attempts()} == {
        "a2": (2, 11, "seal"),
        "a6": (1, 15, "work"),
        "a7": (2, 16, "peel"),
    }
    assert journal.is_void("a8", 1) == (name == "compacted")
    assert {a.outcome for a in journal.list_attempts()} == {None}


def test_an_older_journal_that_could_not_be_opened_any_more_is_opened() -> None:
    """Taken up after a restart, acknowledged while it ran, and ended: three records without the fourth."""

    async def main() -> None:
        file = MemoryFile((JOURNALS / "taken_up_and_pruned.journal").read_bytes())
        for _ in range(2):
            journal = await Journal.open(file, Counter("other"))
            ended = journal.memory.find("a1", 1)
            assert ended is not None
            assert (ended.status, ended.handle) == ("finished", "device-8")
            assert ended.outcome == Outcome(True, "all", {"n": 1}, "", 5, 6)
            assert journal.memory.pruned == 20
            journal._compact_at = 0
            journal.raise_epoch(journal.memory.epoch + 1)
            await journal.sync()
        journal.prune(20)
        assert journal.memory.list_attempts() == []

    asyncio.run(main())


def test_what_cannot_be_written_is_not_remembered() -> None:
    async def main() -> None:
        file = MemoryFile()
        journal = await Journal.open(file, Counter("j"))
        journal.accept("a1", 1, 10, "work")
        with pytest.raises(ValueError, match="surrogates"):
            journal.end("a1", 1, Outcome(False, "none", error="the device said \ud800"))
        running = journal.memory.find("a1", 1)
        assert running is not None
        assert running.status == "running"
        await journal.sync()
        assert not journal.broken
        assert read_journal(file.data) == journal.memory

    asyncio.run(main())

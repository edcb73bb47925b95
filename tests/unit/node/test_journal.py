"""What a node remembers, against a small model and against damage."""

from __future__ import annotations

import asyncio
from collections.abc import Coroutine
from typing import Any

import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, precondition, rule

from labos.errors import JournalDamaged
from labos.node import journal as module
from labos.node._records import Opened, encode, write_line
from labos.node.journal import Journal, JournalError, knows_more, read_journal
from labos.node.protocol import Outcome
from tests.unit.node.memory import Counter, MemoryFile

DONE = Outcome(True, "all", {"n": 1})


def run(coroutine: Coroutine[Any, Any, None]) -> None:
    asyncio.run(coroutine)


async def reopen(file: MemoryFile) -> Journal:
    return await Journal.open(file, Counter("other"))


async def sample(file: MemoryFile) -> Journal:
    """A journal with something of everything."""
    journal = await Journal.open(file, Counter("j"))
    journal.bind("lab")
    journal.raise_epoch(3)
    journal.accept("a1", 1, 10, "work")
    await journal.sync()
    journal.note_handle("a1", 1, "device-7")
    await journal.sync()
    journal.end("a1", 1, DONE)
    journal.accept("a2", 2, 11, "seal")
    await journal.sync()
    journal.forbid_attempts("a3", 4, 12)
    await journal.sync()
    return journal


def test_a_journal_is_read_back() -> None:
    async def main() -> None:
        file = MemoryFile()
        first = await sample(file)
        again = await reopen(file)
        assert (again.memory.id, again.memory.lab, again.memory.epoch) == (first.memory.id, "lab", 3)
        a1, a2 = again.memory.find("a1", 1), again.memory.find("a2", 2)
        assert a1 is not None
        assert (a1.status, a1.outcome, a1.handle) == ("finished", DONE, "device-7")
        assert a2 is not None
        assert (a2.status, a2.name) == ("interrupted", "seal")
        assert again.memory.is_void("a3", 4)
        assert again.memory.is_void("a3", 1)
        assert not again.memory.is_void("a3", 5)
        assert again.memory.is_void("a2", 1)
        assert again.memory.find_earlier("a2", 3) is a2
        assert [u.status for u in again.memory.list_unacknowledged()] == ["finished", "interrupted"]

    run(main())


def test_what_must_not_start_is_not_accepted() -> None:
    async def main() -> None:
        journal = await sample(MemoryFile())
        journal.prune(5)
        for action, attempt, position in [
            ("a1", 1, 10),
            ("a3", 4, 12),
            ("a3", 2, 12),
            ("a2", 1, 11),
            ("new", 1, 5),
        ]:
            with pytest.raises(ValueError, match="must not start"):
                journal.accept(action, attempt, position, "work")
        with pytest.raises(ValueError, match="belongs to lab lab"):
            journal.bind("another")

    run(main())


def test_prune_forgets_all_but_what_runs_and_refuses_the_old() -> None:
    async def main() -> None:
        file = MemoryFile()
        journal = await sample(file)
        journal.prune(12)
        await journal.sync()
        assert journal.memory.is_forgotten(12)
        assert not journal.memory.is_forgotten(13)
        assert journal.memory.find("a1", 1) is None
        assert not journal.memory.is_void("a3", 4)
        running = journal.memory.find("a2", 2)
        assert running is not None
        assert running.status == "running"
        journal.end("a2", 2, DONE)
        assert journal.memory.find("a2", 2) is not None
        journal.prune(12)
        assert journal.memory.find("a2", 2) is None
        await journal.sync()
        writes = file.writes
        journal.prune(12)
        journal.prune(3)
        await journal.sync()
        assert file.writes == writes
        assert (await reopen(file)).memory.pruned == 12

    run(main())


def test_a_rewound_journal_takes_requests_again_from_there_on() -> None:
    async def main() -> None:
        file = MemoryFile()
        journal = await sample(file)
        journal.raise_epoch(8)
        journal.prune(50)
        journal.raise_epoch(1000)
        journal.rewind(60)
        journal.rewind(20)
        await journal.sync()
        for again in (journal.memory, (await reopen(file)).memory, read_journal(file.data)):
            assert (again.pruned, again.pruned_by) == (20, 1000)
            assert again.is_forgotten(20)
            assert not again.is_forgotten(21)

    run(main())


def test_what_was_acknowledged_tells_a_log_that_was_cut() -> None:
    starts = [(1, 1), (2, 40), (1000, 101)]
    for acknowledged, by, end, more in [
        (0, 0, 0, False),
        (39, 1, 200, False),
        (40, 1, 200, True),
        (100, 2, 200, False),
        (101, 2, 200, True),
        (150, 1000, 200, False),
        (201, 1000, 200, True),
        (150, 7, 200, True),
        (150, 0, 200, False),
        (201, 0, 200, True),
    ]:
        assert knows_more(acknowledged, by, end, starts) is more


def test_what_was_interrupted_and_pruned_does_not_come_back() -> None:
    async def main() -> None:
        file = MemoryFile()
        await sample(file)
        second = await reopen(file)
        second.prune(12)
        await second.sync()
        third = await reopen(file)
        assert third.memory.list_attempts() == []

    run(main())


def test_a_grown_journal_is_compacted(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "COMPACT_BYTES", 4000)

    async def main() -> None:
        file = MemoryFile()
        journal = await Journal.open(file, Counter("j"))
        journal.bind("lab")
        largest = 0
        for n in range(1, 500):
            journal.accept(f"a{n}", 1, n, "work")
            await journal.sync()
            journal.end(f"a{n}", 1, DONE)
            journal.prune(n - 5)
            await journal.sync()
            largest = max(largest, len(file.data))
        assert largest < 8000
        assert file.replaced > 5
        again = await reopen(file)
        assert [a.action for a in again.memory.list_attempts()] == [
            a.action for a in journal.memory.list_attempts()
        ]
        assert (again.memory.id, again.memory.lab, again.memory.pruned) == (journal.memory.id, "lab", 494)

    run(main())


def test_writes_that_wait_share_one_sync() -> None:
    async def main() -> None:
        file = MemoryFile()
        journal = await Journal.open(file, Counter("j"))
        writes = file.writes
        file.gate = asyncio.Event()

        async def accept(n: int) -> None:
            journal.accept(f"a{n}", 1, n, "work")
            await journal.sync()

        tasks = [asyncio.create_task(accept(n)) for n in range(1, 3)]
        await asyncio.sleep(0)
        await asyncio.sleep(0)
        tasks += [asyncio.create_task(accept(n)) for n in range(3, 50)]
        await asyncio.sleep(0)
        assert not any(task.done() for task in tasks)
        tasks[0].cancel()
        file.gate.set()
        await asyncio.gather(*tasks[1:])
        assert file.writes == writes + 2
        assert len((await reopen(file)).memory.list_attempts()) == 49

    run(main())


def test_a_disk_that_is_full_is_told_and_can_be_mended() -> None:
    async def main() -> None:
        file = MemoryFile()
        journal = await sample(file)
        file.fail = True
        journal.accept("a9", 1, 20, "work")
        with pytest.raises(JournalError, match="No space left"):
            await journal.sync()
        journal.withdraw("a9", 1)
        journal.end("a2", 2, DONE)
        with pytest.raises(JournalError):
            await journal.sync()
        with pytest.raises(JournalError):
            await journal.mend()
        assert (await reopen(MemoryFile(file.data))).memory.find("a9", 1) is None
        file.fail = False
        await journal.mend()
        await journal.sync()
        journal.accept("a10", 1, 21, "work")
        await journal.sync()
        again = await reopen(file)
        assert again.memory.is_void("a9", 1)
        ended = again.memory.find("a2", 2)
        assert ended is not None
        assert ended.status == "finished"
        assert again.memory.find("a10", 1) is not None

    run(main())


def test_what_was_interrupted_stays_so_through_a_compaction(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "COMPACT_BYTES", 0)

    async def main() -> None:
        file = MemoryFile()
        await sample(file)
        before = file.replaced
        second = await reopen(file)
        assert file.replaced == before + 1
        second.prune(12)
        await second.sync()
        assert (await reopen(file)).memory.list_attempts() == []

    run(main())


# -- damage ------------------------------------------------------------------------------------


def test_the_last_record_torn_at_any_byte() -> None:
    async def main() -> None:
        file = MemoryFile()
        await sample(file)
        start = file.data.rindex(b"\n", 0, -1) + 1
        for length in range(start, len(file.data)):
            torn = MemoryFile(file.data[:length])
            journal = await reopen(torn)
            assert journal.memory.find("a1", 1) is not None
            # Only the whole record counts, with or without the mark of its end.
            assert journal.memory.is_void("a3", 4) == (length >= len(file.data) - 1)
            journal.forbid_attempts("a8", 1, 30)
            await journal.sync()
            assert (await reopen(torn)).memory.is_void("a8", 1)

    run(main())


def test_sectors_of_zeros_at_the_end_are_a_torn_write() -> None:
    async def main() -> None:
        file = MemoryFile()
        await sample(file)
        for tail in (b"\0" * 512, b"\0" * 100 + b'"position":12}]\n'):
            journal = await reopen(MemoryFile(file.data + tail))
            assert journal.memory.is_void("a3", 4)

    run(main())


def test_damage_before_the_last_record_at_any_byte() -> None:
    async def main() -> None:
        file = MemoryFile()
        await sample(file)
        last = file.data.rindex(b"\n", 0, -1) + 1
        for place in range(last):
            data = bytearray(file.data)
            data[place] ^= 0x11
            with pytest.raises(JournalDamaged):
                await reopen(MemoryFile(bytes(data)))
        # Nor is a synced last record thrown away because a bit of it turned.
        for place in range(last, len(file.data)):
            data = bytearray(file.data)
            data[place] ^= 0x01
            if place == len(file.data) - 1:
                assert (await reopen(MemoryFile(bytes(data)))).memory.is_void("a3", 4)
            else:
                with pytest.raises(JournalDamaged):
                    await reopen(MemoryFile(bytes(data)))

    run(main())


def test_lines_that_are_missing_or_foreign() -> None:
    async def main() -> None:
        file = MemoryFile()
        await sample(file)
        lines = file.data.splitlines(keepends=True)
        with pytest.raises(JournalDamaged, match="lost its beginning"):
            await reopen(MemoryFile(b"".join(lines[1:])))
        with pytest.raises(JournalDamaged, match="without its start"):
            await reopen(MemoryFile(lines[0] + lines[2]))
        with pytest.raises(JournalDamaged):
            await reopen(MemoryFile(b"something else\n"))
        newer = write_line([encode(Opened("j", 2))])
        with pytest.raises(JournalDamaged, match="format 2"):
            await reopen(MemoryFile(newer))

    run(main())


# -- a model -----------------------------------------------------------------------------------

ACTIONS = st.sampled_from(["a", "b", "c"])
ATTEMPTS = st.integers(1, 3)


class JournalMachine(RuleBasedStateMachine):
    """The journal against dictionaries, through restarts and compactions."""

    @initialize()
    def begin(self) -> None:
        self.loop = asyncio.new_event_loop()
        self.file = MemoryFile()
        self.journal = self.wait(Journal.open(self.file, Counter("j")))
        self.accepted: dict[tuple[str, int], tuple[int, str]] = {}
        self.void: dict[str, tuple[int, int]] = {}
        self.pruned = 0
        self.epoch = 0

    def wait(self, coroutine: Coroutine[Any, Any, Any]) -> Any:
        return self.loop.run_until_complete(coroutine)

    def must_not(self, action: str, attempt: int, position: int) -> bool:
        return (
            (action, attempt) in self.accepted
            or attempt <= self.void.get(action, (0, 0))[0]
            or any(a == action and n > attempt for a, n in self.accepted)
            or position <= self.pruned
        )

    @rule(action=ACTIONS, attempt=ATTEMPTS, position=st.integers(1, 30))
    def accept(self, action: str, attempt: int, position: int) -> None:
        if self.must_not(action, attempt, position):
            with pytest.raises(ValueError, match="must not start"):
                self.journal.accept(action, attempt, position, "work")
        else:
            self.journal.accept(action, attempt, position, "work")
            self.accepted[action, attempt] = (position, "running")

    @precondition(lambda self: any(status == "running" for _, status in self.accepted.values()))
    @rule(data=st.data())
    def end(self, data: st.DataObject) -> None:
        running = [key for key, (_, status) in self.accepted.items() if status == "running"]
        key = data.draw(st.sampled_from(running))
        self.journal.end(*key, DONE)
        self.accepted[key] = (self.accepted[key][0], "finished")

    @rule(action=ACTIONS, attempt=ATTEMPTS, position=st.integers(1, 30))
    def void_it(self, action: str, attempt: int, position: int) -> None:
        self.journal.forbid_attempts(action, attempt, position)
        known, at = self.void.get(action, (0, 0))
        if attempt > known:
            self.void[action] = (attempt, max(at, position))

    @rule(position=st.integers(1, 30))
    def prune(self, position: int) -> None:
        self.journal.prune(position)
        self.pruned = max(position, self.pruned)
        self.accepted = {k: v for k, v in self.accepted.items() if v[0] > position or v[1] == "running"}
        live = {action for action, _ in self.accepted}
        self.void = {a: v for a, v in self.void.items() if v[1] > position or a in live}

    @rule(epoch=st.integers(1, 9))
    def raise_epoch(self, epoch: int) -> None:
        self.journal.raise_epoch(epoch)
        self.epoch = max(self.epoch, epoch)

    @rule(torn=st.binary(max_size=30))
    def restart(self, torn: bytes) -> None:
        self.wait(self.journal.sync())
        self.file.data += torn.replace(b"\n", b"")
        self.journal = self.wait(reopen(self.file))
        self.accepted = {
            key: (at, "interrupted" if status == "running" else status)
            for key, (at, status) in self.accepted.items()
        }

    @rule()
    def fill_the_disk_and_mend(self) -> None:
        self.file.fail = True
        self.journal.raise_epoch(self.epoch + 1)
        self.epoch += 1
        with pytest.raises(JournalError):
            self.wait(self.journal.sync())
        self.file.fail = False
        self.wait(self.journal.mend())

    @invariant()
    def agrees(self) -> None:
        if not hasattr(self, "journal"):
            return
        assert {
            (a.action, a.attempt): (a.position, a.status) for a in self.journal.memory.list_attempts()
        } == self.accepted
        assert (self.journal.memory.pruned, self.journal.memory.epoch) == (self.pruned, self.epoch)
        for action in "abc":
            for attempt in range(1, 5):
                expected = (action, attempt) not in self.accepted and (
                    attempt <= self.void.get(action, (0, 0))[0]
                    or any(a == action and n > attempt for a, n in self.accepted)
                )
                assert self.journal.memory.is_void(action, attempt) == expected

    def teardown(self) -> None:
        if hasattr(self, "loop"):
            self.loop.close()


TestJournalMachine = JournalMachine.TestCase
TestJournalMachine.settings = settings(max_examples=100, stateful_step_count=30, deadline=None)

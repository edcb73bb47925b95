"""The store against a model of a few lines, by random sequences of calls, on both databases.

Two kernels contend for one log. The model knows who holds it, how long it is and what it contains;
whatever the store answers must be what the model answers.
"""

from __future__ import annotations

import itertools
import os
import shutil
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, settings
from hypothesis import strategies as st
from hypothesis.stateful import (
    RuleBasedStateMachine,
    invariant,
    precondition,
    rule,
    run_state_machine_as_test,
)

from labos.core.envelope import GENESIS, Record
from labos.errors import Fenced, LogDamaged, Refused
from labos.ports import Head, LogQuery
from labos.store import SqlEventStore, find_first_damage, open_store
from tests.integration.store.records import LAB, batch

LONG_S = 600.0
KERNELS = st.sampled_from([0, 1])
TYPES = ["run.started", "run.paused", "action.requested"]


class Log(RuleBasedStateMachine):
    """Subclassed with the URL of an empty database."""

    new_url: Callable[[], str]

    def __init__(self) -> None:
        super().__init__()
        self.url = type(self).new_url()
        self.home = Path(tempfile.mkdtemp(prefix="labos-home-"))
        self.stores = [self.open_store(), self.open_store()]
        self.heads: list[Head | None] = [None, None]
        self.records: list[Record] = []
        self.epoch = 0
        self.holder: int | None = None
        self.snapshot: tuple[int, bytes, str, bytes] | None = None

    def open_store(self) -> SqlEventStore:
        return open_store(self.url, home=self.home)

    def teardown(self) -> None:
        for store in self.stores:
            store.close()
        shutil.rmtree(self.home)

    @property
    def hash(self) -> bytes:
        return self.records[-1].hash if self.records else GENESIS

    def store(self, kernel: int) -> SqlEventStore:
        return self.stores[kernel]

    @rule(kernel=KERNELS)
    def claim(self, kernel: int) -> None:
        if self.holder is not None and self.holder != kernel:
            with pytest.raises(Refused, match="Another kernel already runs"):
                self.store(kernel).claim(LAB, f"kernel {kernel}", LONG_S)
            return
        head = self.store(kernel).claim(LAB, f"kernel {kernel}", LONG_S)
        self.epoch += 1
        assert (head.lab, head.position, head.hash, head.epoch) == (
            LAB,
            len(self.records),
            self.hash,
            self.epoch,
        )
        self.heads[kernel], self.holder = head, kernel

    @rule(kernel=KERNELS, n=st.integers(1, 45), kind=st.sampled_from(TYPES))
    def append(self, kernel: int, n: int, kind: str) -> None:
        head = self.heads[kernel]
        if head is None:
            return
        records = batch(head, n, type=kind)
        if self.holder == kernel and head.epoch == self.epoch:
            self.heads[kernel] = self.store(kernel).append(head, records)
            self.records += records
        else:
            with pytest.raises(Fenced):
                self.store(kernel).append(head, records)

    @precondition(lambda self: self.holder is not None and self.records)
    @rule(back=st.integers(1, 3))
    def append_behind_an_old_head(self, back: int) -> None:
        """What a kernel would do that had missed its own last batches."""
        at = max(len(self.records) - back, 0)
        hash_ = self.records[at - 1].hash if at else GENESIS
        old = Head(LAB, at, hash_, self.epoch)
        with pytest.raises(Fenced):
            self.store(self.holder or 0).append(old, batch(old, 1))

    @rule(kernel=KERNELS)
    def renew(self, kernel: int) -> None:
        head = self.heads[kernel]
        if head is None:
            return
        if head.epoch == self.epoch:
            self.store(kernel).renew(head.epoch, LONG_S)
        else:
            with pytest.raises(Fenced):
                self.store(kernel).renew(head.epoch, LONG_S)

    @rule(kernel=KERNELS)
    def release(self, kernel: int) -> None:
        head = self.heads[kernel]
        if head is not None and self.holder == kernel:
            self.store(kernel).release(head.epoch)
            self.holder, self.heads[kernel] = None, None

    @rule(kernel=KERNELS)
    def die_and_start_again(self, kernel: int) -> None:
        """The process is gone with its locks; another opens the same log."""
        self.store(kernel).close()
        self.stores[kernel] = self.open_store()
        self.heads[kernel] = None
        if self.holder == kernel:
            self.holder = None

    @rule(kernel=KERNELS, after=st.integers(0, 60), length=st.none() | st.integers(0, 60))
    def read(self, kernel: int, after: int, length: int | None) -> None:
        upto = None if length is None else after + length
        assert list(self.store(kernel).read(after, upto)) == self.records[after:upto]

    @rule(
        kernel=KERNELS,
        types=st.lists(st.sampled_from([*TYPES, "run", "action.*"]), max_size=2),
        after=st.integers(0, 40),
        last=st.none() | st.integers(0, 10),
    )
    def select(self, kernel: int, types: list[str], after: int, last: int | None) -> None:
        def is_wanted(record: Record) -> bool:
            names = [name.removesuffix(".*") for name in types]
            kind = record.head.type
            return not names or any(kind == name or kind.startswith(f"{name}.") for name in names)

        expected = [r for r in self.records[after:] if is_wanted(r)]
        if last is not None:
            expected = expected[len(expected) - min(last, len(expected)) :]
        found = self.store(kernel).select(LogQuery(after=after, types=tuple(types), last=last))
        assert list(found) == expected

    @precondition(lambda self: self.records)
    @rule(kernel=KERNELS, data=st.binary(max_size=50), whole=st.booleans())
    def keep_a_snapshot(self, kernel: int, data: bytes, whole: bool) -> None:
        hash_ = self.hash if whole else bytes(32)
        self.store(kernel).save_snapshot(len(self.records), hash_, "fold", data)
        self.snapshot = (len(self.records), hash_, "fold", data)

    @rule(kernel=KERNELS)
    def load_the_snapshot(self, kernel: int) -> None:
        kept = self.snapshot
        if kept is not None and kept[1] == bytes(32):  # genuine, and of another history
            with pytest.raises(LogDamaged, match=f"position {kept[0]} "):
                self.store(kernel).load_snapshot("fold")
            return
        found = self.store(kernel).load_snapshot("fold")
        assert found == (None if kept is None else (kept[0], kept[1], kept[3]))
        assert self.store(kernel).load_snapshot("another fold") is None

    @invariant()
    def the_head_says_where_the_log_ends(self) -> None:
        reader = self.stores[1 if self.holder == 0 else 0]
        head = reader.head()
        assert (head.position, head.hash, head.epoch) == (len(self.records), self.hash, self.epoch)


def check(new_url: Callable[[], str], examples: int, steps: int) -> None:
    machine: Any = type("LogOfThisDatabase", (Log,), {"new_url": staticmethod(new_url)})
    run_state_machine_as_test(
        machine,
        settings=settings(
            max_examples=examples,
            stateful_step_count=steps,
            deadline=None,
            derandomize=os.environ.get("LABOS_RANDOM") != "1",
            database=None,
            suppress_health_check=list(HealthCheck),
        ),
    )


@pytest.mark.parametrize(
    ("examples", "steps"),
    [(3, 20), pytest.param(150, 60, marks=[pytest.mark.full, pytest.mark.timeout(900)])],
)
def test_sqlite_does_what_the_model_does(examples: int, steps: int) -> None:
    with tempfile.TemporaryDirectory() as folder:
        numbers = itertools.count()
        check(lambda: f"sqlite:///{Path(folder) / f'{next(numbers)}.db'}", examples, steps)
        for path in Path(folder).glob("*.db"):
            store = open_store(f"sqlite:///{path}", read_only=True)
            assert find_first_damage(store) is None
            store.close()


@pytest.mark.postgres
@pytest.mark.parametrize(
    ("examples", "steps"),
    [(2, 15), pytest.param(60, 60, marks=[pytest.mark.full, pytest.mark.timeout(900)])],
)
def test_postgres_does_what_the_model_does(postgres_server: Any, examples: int, steps: int) -> None:
    numbers = itertools.count()
    urls: list[str] = []

    def new_url() -> str:
        urls.append(postgres_server.create_database(f"model_{examples}_{next(numbers)}"))
        return urls[-1]

    check(new_url, examples, steps)
    for url in urls:
        store = open_store(url, read_only=True)
        assert find_first_damage(store) is None
        store.close()

"""What it costs to ask for one run: its own events, however long the log is."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from sqlalchemy import text

from labos.core.envelope import Record
from labos.errors import NotFound
from labos.ports import LogQuery
from labos.services.runs import run_histories, run_history
from labos.store import SqlEventStore, open_store
from labos.store._reader import make_selection
from tests.unit.services.logbook import Logbook


class Counting:
    """A log that counts what is read of it."""

    def __init__(self, log: SqlEventStore) -> None:
        self.log, self.read_records = log, 0

    def select(self, query: LogQuery) -> Iterator[Record]:
        for record in self.log.select(query):
            self.read_records += 1
            yield record


def lab(others: int) -> Logbook:
    """R1 is carried through; R2 has its plan from R1; others wait behind them."""
    book = Logbook()
    book.furnish()
    book.submit("pcr")
    book.carry_through("R1", steps=3)
    for number in range(others + 1):
        book.submit("pcr" if number % 2 == 0 else "cp_newplate", user=f"u{number}")
    return book


@pytest.mark.parametrize("run", ["R1", "R2"])
def test_one_run_costs_its_own_events(tmp_path: Path, run: str) -> None:
    costs = []
    for others in (2, 80):
        store = open_store(lab(others).save(tmp_path / str(others)), create=False, read_only=True)
        try:
            counting = Counting(store)
            story = run_history(counting, run)  # type: ignore[arg-type]
            assert story.in_play == 14
            assert story == run_histories(store)[run]
            costs.append(counting.read_records)
        finally:
            store.close()
    assert costs[0] == costs[1]


def test_a_stream_is_found_by_its_index(tmp_path: Path) -> None:
    store = open_store(lab(2).save(tmp_path), create=False, read_only=True)
    try:
        backend = store._backend
        query = (
            make_selection(LogQuery(streams=("R1",)), backend.contains).order_by(text("position")).limit(500)
        )
        plain = str(query.compile(backend.reading, compile_kwargs={"literal_binds": True}))
        steps = [str(row[3]) for row in backend.fetch(f"EXPLAIN QUERY PLAN {plain}", ())]
        assert any("USING INDEX" in step and "stream=?" in step for step in steps), steps
        with pytest.raises(NotFound, match="no run 'R99'"):
            run_history(store, "R99")
    finally:
        store.close()

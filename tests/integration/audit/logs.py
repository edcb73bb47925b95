"""Logs in memory, and the tables that are made of them."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

from labos.audit.database import AuditDatabase
from labos.audit.projector import Projector
from labos.audit.query import open_asker
from labos.audit.tables import VIEWS
from labos.core.envelope import GENESIS, Record
from labos.core.ids import LabId
from labos.ports import Head
from labos.store import read_segment

GOLDEN = Path(__file__).parents[2] / "golden"


class GrowingLog:
    """The first records of a log, up to ``end``."""

    def __init__(self, records: list[Record], end: int | None = None) -> None:
        self.records = records
        self.end = len(records) if end is None else end

    def head(self) -> Head:
        if not self.end:
            return Head(LabId(""), 0, GENESIS, 0)
        last = self.records[self.end - 1]
        return Head(LabId(last.head.lab), self.end, last.hash, 1, last.head.recorded_at)

    def read(self, after: int = 0, upto: int | None = None) -> Iterator[Record]:
        return iter(self.records[after : self.end if upto is None else min(upto, self.end)])

    def replay(self, after: int = 0, upto: int | None = None) -> Any:
        raise NotImplementedError

    def select(self, query: Any) -> Any:
        raise NotImplementedError

    def load_snapshot(self, fingerprint: str) -> None:
        return None


@cache
def golden(name: str) -> list[Record]:
    return list(read_segment(GOLDEN / f"{name}.jsonl.gz"))


def project(log: GrowingLog, database: AuditDatabase) -> int:
    return Projector(log, database).catch_up()


def read_everything(url: str) -> dict[str, list[tuple[Any, ...]]]:
    """All rows of all views."""
    with open_asker(url) as asker:
        return {
            table.view: sorted(
                (tuple(row) for row in asker.ask(f"SELECT * FROM {table.view}").rows), key=repr
            )
            for table in VIEWS
        }

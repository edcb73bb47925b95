"""The log of a lab, read over HTTP, for queries on a computer that cannot open the log itself."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING, Any

import msgspec

from labos.core.canonical import digest
from labos.core.envelope import GENESIS, Envelope, Record
from labos.core.ids import LabId
from labos.core.words import Kept
from labos.ports import EventLine, Head, LogQuery

if TYPE_CHECKING:
    from labos.client._lab import LabClient

MOST_LAST = 1000
"""At most so many last events are requested; for more, the log is read from its beginning."""


class _Page(msgspec.Struct, frozen=True):
    events: list[EventLine]
    position: int


_OF_ENVELOPE = tuple(name for name in EventLine.__struct_fields__ if name in Envelope.__struct_fields__)
_encode = msgspec.json.Encoder(order="sorted").encode  # the form in which the log stores it
_page = msgspec.json.Decoder(_Page)


class LabLog:
    """Reads a page at a time: with words in place of references, or as it is ``stored``."""

    def __init__(self, client: LabClient, *, stored: bool = False) -> None:
        self._client = client
        self._stored = stored
        self._lab = ""

    def head(self) -> Head:
        """The end of the log. Raises LabUnreachable."""
        health = self._client.health()
        last = next(self.select(LogQuery(last=1)), None)
        recorded_at = last.head.recorded_at if last is not None else 0
        return Head(
            LabId(health["lab"]),
            health["position"],
            last.hash if last is not None else GENESIS,
            health["epoch"],
            recorded_at,
        )

    def read(self, after: int = 0, upto: int | None = None) -> Iterator[Record]:
        """Records in order."""
        return self.select(LogQuery(after=after, upto=upto))

    def replay(self, after: int = 0, upto: int | None = None) -> Iterator[tuple[Any, ...]]:
        """(position, type, schema, recorded_at, payload) of each record."""
        for record in self.read(after, upto):
            head = record.head
            yield head.position, head.type, head.schema, head.recorded_at, record.payload

    def load_snapshot(self, fingerprint: str) -> None:
        """There is none: the log is folded from its beginning."""
        return None

    def words_of(self, references: Iterable[str]) -> dict[str, Kept]:
        """Nothing: the lab has replaced the references already."""
        return {}

    def select(self, query: LogQuery) -> Iterator[Record]:
        """The records of a query, in order."""
        if query.upto == 0:
            return iter(())
        asked = {
            "type": list(query.types),
            "stream": list(query.streams),
            "correlation": query.correlation,
            "actor": query.actor,
            "mentions": query.mentions,
            "upto": query.upto or 0,
            "since": query.since_ns or 0,
            "until": query.until_ns or 0,
        }
        if self._stored:
            asked["stored"] = True
        if query.last is not None and query.last <= MOST_LAST:
            records, _ = self._ask({**asked, "after": query.after, "last": query.last})
            return iter(records)
        found = self._iterate_pages(asked, query.after)
        return found if query.last is None else iter(deque(found, query.last))

    def _iterate_pages(self, asked: dict[str, Any], after: int) -> Iterator[Record]:
        while True:
            records, position = self._ask({**asked, "after": after})
            yield from records
            if position <= after or (asked["upto"] and position >= asked["upto"]):
                return
            after = position

    def _ask(self, asked: dict[str, Any]) -> tuple[list[Record], int]:
        """The records of a page, and the position at which the next page begins."""
        page = _page.decode(self._client.page_of_events(asked))
        if page.events and not self._lab:
            self._lab = str(self._client.health()["lab"])
        return [self._record(event) for event in page.events], page.position

    def _record(self, event: EventLine) -> Record:
        payload = bytes(event.payload)
        named = {name: getattr(event, name) for name in _OF_ENVELOPE}
        head = Envelope(lab=self._lab, digest=digest(payload), **named)
        return Record(head, _encode(head), payload, bytes.fromhex(event.hash))


class LabFiles:
    """The lab's files over HTTP, by their SHA-256."""

    def __init__(self, client: LabClient) -> None:
        self._client = client

    def get(self, digest: str) -> bytes:
        """Raises NotFound, LogDamaged, LabUnreachable."""
        return self._client.file(digest)

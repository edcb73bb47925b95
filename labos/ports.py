"""The interfaces of the kernel and the nodes to the outside, as protocols.

Each port has a real implementation and one for the seeded simulation; both pass the same tests.
"""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Iterable, Iterator, Mapping, Sequence
from typing import Any, Protocol

import msgspec

from labos.core.envelope import Record
from labos.core.ids import LabId
from labos.core.words import Kept


class Head(msgspec.Struct, frozen=True):
    """The end of the log, and the kernel that may write it."""

    lab: LabId
    position: int
    hash: bytes
    epoch: int
    recorded_at: int = 0


class LogQuery(msgspec.Struct, frozen=True):
    """A selection of the log. Empty fields select everything; times are UTC nanoseconds. A record
    ``mentions`` a text that is in its payload, in its stream or in its words."""

    after: int = 0
    upto: int | None = None
    types: tuple[str, ...] = ()
    streams: tuple[str, ...] = ()
    correlation: str = ""
    actor: str = ""
    mentions: str = ""
    since_ns: int | None = None
    until_ns: int | None = None
    last: int | None = None


class StoredSnapshot(msgspec.Struct, frozen=True):
    """The row of the snapshot. ``fault`` says why it is not ``genuine``; ``tampered``: it has a seal, but not
    a correct one. ``on_log`` is the hash of the log at the snapshot's position; None if the log is
    shorter."""

    position: int
    hash: bytes
    fingerprint: str
    data: bytes
    genuine: bool
    tampered: bool
    fault: str
    on_log: bytes | None


class StoredWords(msgspec.Struct, frozen=True):
    """Words beside the log. ``position`` is the first event that refers to them, and ``erased_at`` the event
    that erased them (0: none). If that is after the end of the log, they were erased in a log of which this
    one is an older copy."""

    words: Kept
    position: int
    erased_at: int


class EventLine(msgspec.Struct, frozen=True):
    """A record of the log, as HTTP sends it and clients read it. ``time`` is ``recorded_at`` (UTC
    nanoseconds) for people; ``version`` counts the events of its ``stream``; ``correlation`` is the run or
    experiment to which it belongs; ``causation`` is the id of the event that caused it, or the mark of the
    request that caused it (``request:…``); ``hash`` links it to the previous event."""

    position: int
    time: str
    recorded_at: int
    type: str
    schema: int
    version: int
    stream: str
    actor: str
    correlation: str
    causation: str
    id: str
    payload: msgspec.Raw
    hash: str


Row = tuple[Any, ...]


class Log(Protocol):
    """The log, for reading."""

    def head(self) -> Head:
        """The end of the log. Raises StoreUnavailable."""

    def read(self, after: int = 0, upto: int | None = None) -> Iterator[Record]:
        """Records in order, from ``after + 1``."""

    def replay(self, after: int = 0, upto: int | None = None) -> Iterator[Row]:
        """(position, type, schema, recorded_at, payload) of each record."""

    def select(self, query: LogQuery) -> Iterator[Record]:
        """Records that a query selects, in order."""

    def words_of(self, references: Iterable[str]) -> Mapping[str, Kept]:
        """The words beside the log for references, also erased ones."""

    def load_snapshot(self, fingerprint: str) -> tuple[int, bytes, bytes] | None:
        """(position, hash, data) of the newest snapshot of this fold, if its hash is still the
        log's hash at that position."""


class EventStore(Log, Protocol):
    """The log. Calls block; the kernel makes them from its writer thread only."""

    def replay(
        self, after: int = 0, upto: int | None = None, *, before: bytes = b"", end: Head | None = None
    ) -> Iterator[Row]:
        """Each record is checked: ``before`` is the hash that the log must have at ``after``, and ``end`` the
        head with which it must end. Raises LogDamaged."""

    def claim(self, lab: LabId, owner: str, lease_s: float) -> Head:
        """Become the lab's one kernel: raise the epoch and take the lease. ``lab`` is the id to give to an
        empty log. Raises Refused while another kernel is running."""

    def renew(self, epoch: int, lease_s: float) -> None:
        """Keep the lease. Raises Fenced if another kernel has taken over."""

    def release(self, epoch: int, *, to_standby: bool = False) -> None:
        """Give the lease back, so that the next kernel need not wait for it to expire; with ``to_standby``
        the lab counts as abandoned, and a standby takes over at once."""

    def append(self, expected: Head, records: Sequence[Record]) -> Head:
        """Write records after ``expected``, all or none; they are synced to disk on return.

        Raises Fenced if the head is not the expected one, StoreUnavailable if the outcome of the commit is
        not known or nothing was written.
        """

    def scrub(self) -> str:
        """Remove what remains of erased words from the database's files. Returns why something may still
        remain, empty if nothing does."""

    def save_snapshot(self, position: int, hash_: bytes, fingerprint: str, data: bytes) -> None:
        """Store a disposable picture of the state; it replaces older ones."""

    def close(self) -> None: ...


class Person(msgspec.Struct, frozen=True):
    """A user's name and address. They are stored beside the log, which contains only the id."""

    user: str
    name: str = ""
    mail: str = ""


class Token(msgspec.Struct, frozen=True):
    """The record of a token, without its secret. ``scope`` is the highest role that it allows: `viewer`,
    `submitter`, `operator` or `admin`. Times are UTC nanoseconds, 0 for not yet."""

    id: str
    user: str
    label: str
    scope: str
    created_at: int
    expires_at: int
    used_at: int = 0
    revoked_at: int = 0


class Session(msgspec.Struct, frozen=True):
    """A browser session of a signed-in user; ``how`` is `password` or `oidc`."""

    user: str
    how: str
    created_at: int
    expires_at: int


class AccountStore(Protocol):
    """The users' credentials and personal data, which can be changed and erased. Calls block. Each raises
    StoreUnavailable."""

    def people(self) -> dict[str, Person]: ...

    def set_person(self, person: Person) -> None: ...

    def erase(self, user: str) -> None: ...

    def password(self, user: str) -> str: ...

    def set_password(self, user: str, hash_: str, now: int) -> None: ...

    def add_token(self, token: Token, digest: bytes) -> None: ...

    def token(self, digest: bytes) -> Token | None: ...

    def tokens(self, user: str = "") -> list[Token]: ...

    def use_token(self, id_: str, now: int) -> None: ...

    def revoke_token(self, id_: str, now: int) -> None: ...

    def add_session(self, session: Session, digest: bytes) -> None: ...

    def session(self, digest: bytes) -> Session | None: ...

    def end_session(self, digest: bytes) -> None: ...

    def end_sessions(self, user: str) -> None: ...

    def user_of(self, issuer: str, subject: str) -> str: ...

    def link(self, issuer: str, subject: str, user: str) -> None: ...


class BlobReader(Protocol):
    """Large payloads by SHA-256."""

    def get(self, digest: str) -> bytes:
        """Raises NotFound if there is no such blob, LogDamaged if its bytes changed."""


class BlobStore(BlobReader, Protocol):
    """A store for large payloads; ``put`` returns after the bytes are synced."""

    def put(self, data: bytes) -> str: ...


Handler = Callable[[bytes], Awaitable[bytes]]
Listener = Callable[[str, bytes], None]
AliveListener = Callable[[str, bool], None]


class Handle(Protocol):
    """A declaration on the bus; ``close`` withdraws it. Keep a reference to it."""

    def close(self) -> None: ...


class Bus(Protocol):
    """Queries, publications and liveliness. Keys are slash-separated; ``*`` stands for one
    part and ``**`` for any number."""

    async def query(self, key: str, payload: bytes, timeout_s: float) -> bytes:
        """Ask the process that serves ``key``. Raises NoAnswer if there is no answer in time; the request may
        have been carried out."""

    async def serve(self, key: str, handler: Handler) -> Handle: ...

    async def publish(self, key: str, payload: bytes) -> None: ...

    async def subscribe(self, keys: str, listener: Listener) -> Handle: ...

    async def declare_alive(self, key: str) -> Handle:
        """Show this key to watchers as long as the process is running."""

    async def watch_alive(self, keys: str, listener: AliveListener) -> Handle:
        """Call ``listener(key, True)`` for each key that is alive now or later, and ``(key, False)`` when one
        is gone."""

    async def close(self) -> None: ...

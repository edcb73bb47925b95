"""The tables as the present version knows them; ``migrations/`` brings a database here."""

from __future__ import annotations

from sqlalchemy import (
    BigInteger,
    CheckConstraint,
    Column,
    Index,
    Integer,
    LargeBinary,
    MetaData,
    Table,
    Text,
    UniqueConstraint,
)

# Byte order, so that ranges of types mean the same on every server.
Name = Text().with_variant(Text(collation="C"), "postgresql")
# SQLite takes exactly INTEGER PRIMARY KEY as its row id.
Position = BigInteger().with_variant(Integer, "sqlite")

metadata = MetaData()

event = Table(
    "event",
    metadata,
    Column("position", Position, primary_key=True, autoincrement=False),
    Column("id", Name, nullable=False),
    Column("stream", Name, nullable=False),
    Column("version", Integer, nullable=False),
    Column("type", Name, nullable=False),
    Column("schema", Integer, nullable=False),
    Column("recorded_at", BigInteger, nullable=False),
    Column("actor", Name, nullable=False),
    Column("correlation", Name, nullable=False),
    Column("causation", Name, nullable=False),
    Column("digest", Name, nullable=False),
    Column("envelope", LargeBinary, nullable=False),
    Column("payload", LargeBinary, nullable=False),
    Column("hash", LargeBinary, nullable=False),
    UniqueConstraint("id", name="event_id"),
    UniqueConstraint("stream", "version", name="event_stream_version"),
    Index("event_type", "type", "position"),
    Index("event_correlation", "correlation", "position"),
    Index("event_recorded_at", "recorded_at"),
)
"""One row a record. The lab's id stands in ``head`` and in the envelope's bytes."""

head = Table(
    "head",
    metadata,
    Column("id", Integer, primary_key=True, autoincrement=False),
    Column("lab", Name, nullable=False),
    Column("position", BigInteger, nullable=False),
    Column("hash", LargeBinary, nullable=False),
    Column("epoch", BigInteger, nullable=False),
    Column("recorded_at", BigInteger, nullable=False),
    Column("lease_owner", Name, nullable=False),
    Column("lease_until", BigInteger, nullable=False),
    CheckConstraint("id = 1", name="head_is_one_row"),
)
"""One row. ``lease_until`` is in milliseconds since 1970 by the database's clock."""

snapshot = Table(
    "snapshot",
    metadata,
    Column("id", Integer, primary_key=True, autoincrement=False),
    Column("position", BigInteger, nullable=False),
    Column("hash", LargeBinary, nullable=False),
    Column("fingerprint", Name, nullable=False),
    Column("digest", Name, nullable=False),
    Column("data", LargeBinary, nullable=False),
    CheckConstraint("id = 1", name="snapshot_is_one_row"),
)
"""At most one row: the newest picture of the state."""

VERSION_TABLE = "labos_version"
"""Where Alembic keeps the revision; a name of our own, so that other programs may share the database."""

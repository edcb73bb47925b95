"""The tables in the present version; ``migrations/`` bring a database to it."""

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
# SQLite uses exactly INTEGER PRIMARY KEY as its row id.
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
"""One row per record. The lab's id is in ``head`` and in the bytes of the envelope."""

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
"""At most one row: the newest snapshot of the state."""

# The following tables are not part of the log: they can be changed and erased. No event contains their data.

words = Table(
    "words",
    metadata,
    Column("reference", Name, primary_key=True),
    Column("position", BigInteger, nullable=False),
    Column("salt", LargeBinary, nullable=False),
    Column("text", Name, nullable=False),
    Column("erased_at", BigInteger, nullable=False),
    Index("words_position", "position"),
)
"""Words that people wrote into events. The event contains the ``reference`` instead; ``position`` is the
first such event. An erased row has neither salt nor text, but the position of the event that erased it."""

account_person = Table(
    "account_person",
    metadata,
    Column("user_id", Name, primary_key=True),
    Column("name", Name, nullable=False),
    Column("mail", Name, nullable=False),
)
"""The person of a user id."""

account_password = Table(
    "account_password",
    metadata,
    Column("user_id", Name, primary_key=True),
    Column("hash", Name, nullable=False),
    Column("changed_at", BigInteger, nullable=False),
)
"""The hash (argon2id, with its salt and its parameters) of each user's password."""

account_token = Table(
    "account_token",
    metadata,
    Column("id", Name, primary_key=True),
    Column("digest", LargeBinary, nullable=False),
    Column("user_id", Name, nullable=False),
    Column("label", Name, nullable=False),
    Column("scope", Name, nullable=False),
    Column("created_at", BigInteger, nullable=False),
    Column("expires_at", BigInteger, nullable=False),
    Column("used_at", BigInteger, nullable=False),
    Column("revoked_at", BigInteger, nullable=False),
    UniqueConstraint("digest", name="account_token_digest"),
    Index("account_token_user", "user_id"),
)
"""Tokens of programs: the SHA-256 of each, never the token. Times are UTC nanoseconds, 0 for not yet."""

account_session = Table(
    "account_session",
    metadata,
    Column("digest", LargeBinary, primary_key=True),
    Column("user_id", Name, nullable=False),
    Column("how", Name, nullable=False),
    Column("created_at", BigInteger, nullable=False),
    Column("expires_at", BigInteger, nullable=False),
    Index("account_session_user", "user_id"),
)
"""Sessions of browsers: the SHA-256 of the cookie's value. An ended session has no row."""

account_identity = Table(
    "account_identity",
    metadata,
    Column("issuer", Name, primary_key=True),
    Column("subject", Name, primary_key=True),
    Column("user_id", Name, nullable=False),
    Index("account_identity_user", "user_id"),
)
"""The user for a name at an identity provider."""

VERSION_TABLE = "labos_version"
"""The table of Alembic's revision; it has its own name, so that other programs may use the same database."""

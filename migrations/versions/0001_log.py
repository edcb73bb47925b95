"""The log, its head and the snapshot.

Revision ID: 0001
Revises:
"""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0001"
down_revision = None
branch_labels = None
depends_on = None

SQLITE_TRIGGERS = (
    # UPDATE and DELETE triggers do not see INSERT OR REPLACE (it deletes silently), so an
    # insert is refused before it can replace anything.
    """CREATE TRIGGER event_insert BEFORE INSERT ON event
       WHEN NEW.position IS NOT (SELECT coalesce(max(position), 0) + 1 FROM event)
         OR EXISTS (SELECT 1 FROM event WHERE id = NEW.id)
         OR EXISTS (SELECT 1 FROM event WHERE stream = NEW.stream AND version = NEW.version)
       BEGIN SELECT RAISE(ABORT, 'the log only grows at its end, one position at a time'); END""",
    """CREATE TRIGGER event_update BEFORE UPDATE ON event
       BEGIN SELECT RAISE(ABORT, 'the log cannot be changed'); END""",
    """CREATE TRIGGER event_delete BEFORE DELETE ON event
       BEGIN SELECT RAISE(ABORT, 'the log cannot be deleted'); END""",
    """CREATE TRIGGER head_insert BEFORE INSERT ON head WHEN EXISTS (SELECT 1 FROM head)
       BEGIN SELECT RAISE(ABORT, 'the log has one head'); END""",
    """CREATE TRIGGER head_update BEFORE UPDATE ON head
       WHEN NEW.position < OLD.position OR NEW.epoch < OLD.epoch
       BEGIN SELECT RAISE(ABORT, 'the head never goes back'); END""",
    """CREATE TRIGGER head_delete BEFORE DELETE ON head
       BEGIN SELECT RAISE(ABORT, 'the head cannot be deleted'); END""",
)

POSTGRES_TRIGGERS = (
    """CREATE FUNCTION labos_refuse() RETURNS trigger LANGUAGE plpgsql AS $$
       BEGIN
         RAISE EXCEPTION 'the log cannot be changed: % on % is refused', TG_OP, TG_TABLE_NAME
           USING ERRCODE = 'integrity_constraint_violation';
       END $$""",
    """CREATE FUNCTION labos_gapless() RETURNS trigger LANGUAGE plpgsql AS $$
       DECLARE low bigint; high bigint; n bigint; before bigint;
       BEGIN
         SELECT min(position), max(position), count(*) INTO low, high, n FROM fresh;
         IF n = 0 THEN RETURN NULL; END IF;
         SELECT coalesce(max(position), 0) INTO before FROM event WHERE position < low;
         IF low <> before + 1 OR high - low + 1 <> n
            OR EXISTS (SELECT 1 FROM event WHERE position > high) THEN
           RAISE EXCEPTION 'the log only grows at its end, one position at a time'
             USING ERRCODE = 'integrity_constraint_violation';
         END IF;
         RETURN NULL;
       END $$""",
    """CREATE FUNCTION labos_head_grows() RETURNS trigger LANGUAGE plpgsql AS $$
       BEGIN
         IF NEW.position < OLD.position OR NEW.epoch < OLD.epoch THEN
           RAISE EXCEPTION 'the head never goes back'
             USING ERRCODE = 'integrity_constraint_violation';
         END IF;
         RETURN NEW;
       END $$""",
    """CREATE TRIGGER event_insert AFTER INSERT ON event REFERENCING NEW TABLE AS fresh
       FOR EACH STATEMENT EXECUTE FUNCTION labos_gapless()""",
    """CREATE TRIGGER event_update BEFORE UPDATE ON event
       FOR EACH STATEMENT EXECUTE FUNCTION labos_refuse()""",
    """CREATE TRIGGER event_delete BEFORE DELETE ON event
       FOR EACH STATEMENT EXECUTE FUNCTION labos_refuse()""",
    """CREATE TRIGGER event_truncate BEFORE TRUNCATE ON event
       FOR EACH STATEMENT EXECUTE FUNCTION labos_refuse()""",
    """CREATE TRIGGER head_update BEFORE UPDATE ON head
       FOR EACH ROW EXECUTE FUNCTION labos_head_grows()""",
    """CREATE TRIGGER head_delete BEFORE DELETE ON head
       FOR EACH STATEMENT EXECUTE FUNCTION labos_refuse()""",
    """CREATE TRIGGER head_truncate BEFORE TRUNCATE ON head
       FOR EACH STATEMENT EXECUTE FUNCTION labos_refuse()""",
)


def upgrade() -> None:
    # Byte order on PostgreSQL; the row id on SQLite.
    name = sa.Text().with_variant(sa.Text(collation="C"), "postgresql")
    position = sa.BigInteger().with_variant(sa.Integer, "sqlite")
    op.create_table(
        "event",
        sa.Column("position", position, primary_key=True, autoincrement=False),
        sa.Column("id", name, nullable=False),
        sa.Column("stream", name, nullable=False),
        sa.Column("version", sa.Integer, nullable=False),
        sa.Column("type", name, nullable=False),
        sa.Column("schema", sa.Integer, nullable=False),
        sa.Column("recorded_at", sa.BigInteger, nullable=False),
        sa.Column("actor", name, nullable=False),
        sa.Column("correlation", name, nullable=False),
        sa.Column("causation", name, nullable=False),
        sa.Column("digest", name, nullable=False),
        sa.Column("envelope", sa.LargeBinary, nullable=False),
        sa.Column("payload", sa.LargeBinary, nullable=False),
        sa.Column("hash", sa.LargeBinary, nullable=False),
        sa.UniqueConstraint("id", name="event_id"),
        sa.UniqueConstraint("stream", "version", name="event_stream_version"),
    )
    op.create_index("event_type", "event", ["type", "position"])
    op.create_index("event_correlation", "event", ["correlation", "position"])
    op.create_index("event_recorded_at", "event", ["recorded_at"])
    head = op.create_table(
        "head",
        sa.Column("id", sa.Integer, primary_key=True, autoincrement=False),
        sa.Column("lab", name, nullable=False),
        sa.Column("position", sa.BigInteger, nullable=False),
        sa.Column("hash", sa.LargeBinary, nullable=False),
        sa.Column("epoch", sa.BigInteger, nullable=False),
        sa.Column("recorded_at", sa.BigInteger, nullable=False),
        sa.Column("lease_owner", name, nullable=False),
        sa.Column("lease_until", sa.BigInteger, nullable=False),
        sa.CheckConstraint("id = 1", name="head_is_one_row"),
    )
    op.create_table(
        "snapshot",
        sa.Column("id", sa.Integer, primary_key=True, autoincrement=False),
        sa.Column("position", sa.BigInteger, nullable=False),
        sa.Column("hash", sa.LargeBinary, nullable=False),
        sa.Column("fingerprint", name, nullable=False),
        sa.Column("digest", name, nullable=False),
        sa.Column("data", sa.LargeBinary, nullable=False),
        sa.CheckConstraint("id = 1", name="snapshot_is_one_row"),
    )
    op.bulk_insert(
        head,
        [
            {
                "id": 1,
                "lab": "",
                "position": 0,
                "hash": bytes(32),
                "epoch": 0,
                "recorded_at": 0,
                "lease_owner": "",
                "lease_until": 0,
            }
        ],
    )
    dialect = op.get_bind().dialect.name
    for statement in SQLITE_TRIGGERS if dialect == "sqlite" else POSTGRES_TRIGGERS:
        op.execute(statement)


def downgrade() -> None:
    raise NotImplementedError(
        "The log cannot be downgraded: what it holds is the lab's only record. "
        "Restore the backup that was made before the upgrade, with the LabOS version that made it."
    )

"""Words of people beside the log, so that they can be erased.

Revision ID: 0003
Revises: 0002
"""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0003"
down_revision = "0002"
branch_labels = None
depends_on = None


# A role that kernels work as (`labos db writer`) goes on as before.
GRANT_TO_WRITERS = """DO $$
DECLARE who name;
BEGIN
  FOR who IN SELECT DISTINCT grantee FROM information_schema.role_table_grants
             WHERE table_name = 'event' AND table_schema = current_schema() AND privilege_type = 'INSERT'
               AND grantee NOT IN (current_user, 'PUBLIC')
  LOOP
    EXECUTE format('GRANT SELECT, INSERT, UPDATE ON words TO %I', who);
  END LOOP;
END $$"""


def upgrade() -> None:
    name = sa.Text().with_variant(sa.Text(collation="C"), "postgresql")
    op.create_table(
        "words",
        sa.Column("reference", name, primary_key=True),
        sa.Column("position", sa.BigInteger, nullable=False),
        sa.Column("salt", sa.LargeBinary, nullable=False),
        sa.Column("text", name, nullable=False),
        sa.Column("erased_at", sa.BigInteger, nullable=False),
    )
    op.create_index("words_position", "words", ["position"])
    if op.get_bind().dialect.name == "postgresql":
        op.execute(GRANT_TO_WRITERS)
        # The planner's samples would be copies of texts.
        op.execute("ALTER TABLE words ALTER COLUMN text SET STATISTICS 0")


def downgrade() -> None:
    raise NotImplementedError(
        "Words that stand beside the log have no place in an older database. "
        "Restore the backup that was made before the upgrade, with the LabOS version that made it."
    )

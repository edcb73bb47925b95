"""What people and programs sign in with, and who a user is: tables that can be changed and erased.

Revision ID: 0002
Revises: 0001
"""

from __future__ import annotations

import sqlalchemy as sa
from alembic import op

revision = "0002"
down_revision = "0001"
branch_labels = None
depends_on = None


def upgrade() -> None:
    name = sa.Text().with_variant(sa.Text(collation="C"), "postgresql")
    op.create_table(
        "account_person",
        sa.Column("user_id", name, primary_key=True),
        sa.Column("name", name, nullable=False),
        sa.Column("mail", name, nullable=False),
    )
    op.create_table(
        "account_password",
        sa.Column("user_id", name, primary_key=True),
        sa.Column("hash", name, nullable=False),
        sa.Column("changed_at", sa.BigInteger, nullable=False),
    )
    op.create_table(
        "account_token",
        sa.Column("id", name, primary_key=True),
        sa.Column("digest", sa.LargeBinary, nullable=False),
        sa.Column("user_id", name, nullable=False),
        sa.Column("label", name, nullable=False),
        sa.Column("scope", name, nullable=False),
        sa.Column("created_at", sa.BigInteger, nullable=False),
        sa.Column("expires_at", sa.BigInteger, nullable=False),
        sa.Column("used_at", sa.BigInteger, nullable=False),
        sa.Column("revoked_at", sa.BigInteger, nullable=False),
        sa.UniqueConstraint("digest", name="account_token_digest"),
    )
    op.create_index("account_token_user", "account_token", ["user_id"])
    op.create_table(
        "account_session",
        sa.Column("digest", sa.LargeBinary, primary_key=True),
        sa.Column("user_id", name, nullable=False),
        sa.Column("how", name, nullable=False),
        sa.Column("created_at", sa.BigInteger, nullable=False),
        sa.Column("expires_at", sa.BigInteger, nullable=False),
    )
    op.create_index("account_session_user", "account_session", ["user_id"])
    op.create_table(
        "account_identity",
        sa.Column("issuer", name, primary_key=True),
        sa.Column("subject", name, primary_key=True),
        sa.Column("user_id", name, nullable=False),
    )
    op.create_index("account_identity_user", "account_identity", ["user_id"])


def downgrade() -> None:
    for table in ("identity", "session", "token", "password", "person"):
        op.drop_table(f"account_{table}")

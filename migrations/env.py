"""Runs the migrations, for `labos.store.migrate` and for the `alembic` command alike."""

from __future__ import annotations

import os

from alembic import context
from sqlalchemy import Connection

from labos.store._migrate import migration_connection
from labos.store._tables import VERSION_TABLE, metadata
from labos.store._url import parse_url


def run(connection: Connection) -> None:
    context.configure(
        connection=connection,
        target_metadata=metadata,
        version_table=VERSION_TABLE,
        transactional_ddl=True,
    )
    # The caller holds the transaction, so that reading the revision, changing the tables and
    # writing the new revision are one step.
    context.run_migrations()


given = context.config.attributes.get("connection")
if given is not None:
    run(given)
else:
    url = context.config.get_main_option("sqlalchemy.url") or os.environ.get("LABOS_DATABASE_URL", "")
    with migration_connection(parse_url(url)) as connection:
        run(connection)

"""Two roles on PostgreSQL: the owner makes and upgrades the tables; the writer is the role of kernels.

The writer may add records to the log and move its head. It may not change, delete or truncate records, or
remove the triggers that refuse this to all roles. These belong to the owner, whose password no running lab
needs. The writer may have the table of people's words rewritten, by a function of the owner.
"""

from __future__ import annotations

from sqlalchemy import text

from labos.errors import BadInput, NotFound, Refused
from labos.store._backend import REWRITE_WORDS, REWRITING
from labos.store._migrate import find_schema_of_log, read_database_status, refuse_newer
from labos.store._open import use_backend
from labos.store._tables import VERSION_TABLE, metadata
from labos.store._url import display_name, parse_url

_ACCOUNTS = tuple(name for name in metadata.tables if name.startswith("account_"))
_TABLES = ("event", "head", "snapshot", "words", *_ACCOUNTS, VERSION_TABLE)
_RIGHTS = (
    "GRANT SELECT, INSERT ON event TO {role}",
    "GRANT SELECT, UPDATE ON head TO {role}",
    "GRANT SELECT, INSERT, DELETE ON snapshot TO {role}",
    "GRANT SELECT, INSERT, UPDATE ON words TO {role}",
    f"GRANT SELECT, INSERT, UPDATE, DELETE ON {', '.join(_ACCOUNTS)} TO {{role}}",
    f"GRANT SELECT ON {VERSION_TABLE} TO {{role}}",
)

_REWRITING = (
    f"CREATE OR REPLACE FUNCTION {{schema}}.{REWRITING}() RETURNS void LANGUAGE plpgsql SECURITY DEFINER "
    "SET search_path = pg_catalog, {schema}, pg_temp AS $$ BEGIN "
    f"{REWRITE_WORDS.replace('TABLE words', 'TABLE {schema}.words')}; END $$",
    f"REVOKE ALL ON FUNCTION {{schema}}.{REWRITING}() FROM PUBLIC",
    f"GRANT EXECUTE ON FUNCTION {{schema}}.{REWRITING}() TO {{role}}",
)
"""Functions that need the owner's rights, but that a kernel may call: they remove erased rows from the
table's file."""

_ROLE = text(
    "SELECT rolsuper, pg_has_role(rolname, (SELECT relowner FROM pg_class WHERE oid = to_regclass('event')), "
    "'MEMBER') AS owns FROM pg_roles WHERE rolname = :role"
)


def grant_writer(url: str, role: str) -> None:
    """Let an existing role write the log in a PostgreSQL database, with no other rights. ``url`` is the
    owner's. Raises BadInput for another kind of database, NotFound for an unknown role, Refused for a role
    that may do everything anyway, StoreUnavailable."""
    parsed = parse_url(url)
    if parsed.get_backend_name() == "sqlite":
        raise BadInput(
            "SQLite has no roles: a user who may write the file may write all of it.",
            remedy="Keep the lab's folder private, and checkpoints elsewhere (labos verify --checkpoint).",
        )
    status = read_database_status(url)
    refuse_newer(status)
    if status.state != "current":
        raise Refused(f"The {status.name} is not ready.", remedy="Run first: labos db upgrade")
    with use_backend(parsed) as backend, backend.writing.connect() as connection, connection.begin():
        found = connection.execute(_ROLE, {"role": role}).first()
        if found is None:
            raise NotFound(
                f"The {display_name(parsed)} has no role {role!r}.",
                remedy="Create it first: CREATE ROLE name LOGIN PASSWORD '…'",
            )
        if found.rolsuper or found.owns:
            what = (
                "is a superuser" if found.rolsuper else "owns the tables, or belongs to a role that owns them"
            )
            raise Refused(
                f"The role {role!r} {what}, so it can change every record without a grant.",
                remedy="Use a separate role for the kernel.",
            )
        quoted = connection.dialect.identifier_preparer.quote_identifier(role)
        schema = find_schema_of_log(connection)
        connection.execute(text(f"REVOKE ALL ON {', '.join(_TABLES)} FROM {quoted}, PUBLIC"))
        connection.execute(text(f"GRANT USAGE ON SCHEMA {schema} TO {quoted}"))
        for right in _RIGHTS:
            connection.execute(text(right.format(role=quoted)))
        for part in _REWRITING:
            connection.execute(text(part.format(role=quoted, schema=schema)))

"""The tables of accounts (persons, passwords, tokens, sessions), on SQLite or PostgreSQL. They are stored
beside the log, and can be erased."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Any

import msgspec
import structlog
from sqlalchemy import Connection, Delete, Engine, Executable, Insert, Table, delete, insert, select, update
from sqlalchemy.engine import URL
from sqlalchemy.exc import SQLAlchemyError

from labos.core.structs import make_from
from labos.ports import Person, Session, Token
from labos.store._errors import TranslatedErrors
from labos.store._tables import account_identity as identity_table
from labos.store._tables import account_password as password_table
from labos.store._tables import account_person as person_table
from labos.store._tables import account_session as session_table
from labos.store._tables import account_token as token_table
from labos.store._url import find_sqlite_path, parse_url

_OF_A_USER = (person_table, password_table, token_table, session_table, identity_table)
_log = structlog.get_logger(__name__)


class SqlAccounts:
    """Accounts in the database of the log. Calls block, and may come from any thread."""

    def __init__(self, url: URL, reading: Engine, writing: Engine) -> None:
        self._url, self._reading, self._writing = url, reading, writing

    def close(self) -> None:
        self._reading.dispose()
        self._writing.dispose()

    @contextmanager
    def read(self) -> Iterator[Connection]:
        with TranslatedErrors(self._url), self._reading.connect() as connection:
            yield connection

    @contextmanager
    def change(self) -> Iterator[Connection]:
        with TranslatedErrors(self._url), self._writing.connect() as connection, connection.begin():
            yield connection

    # -- people --------------------------------------------------------------------------------

    def people(self) -> dict[str, Person]:
        """The users with a known name or address."""
        with self.read() as connection:
            rows = connection.execute(select(person_table)).all()
        return {row.user_id: Person(row.user_id, row.name, row.mail) for row in rows}

    def set_person(self, person: Person) -> None:
        self._change(*_replace(person_table, person.user, name=person.name, mail=person.mail))

    def erase(self, user: str) -> None:
        """Erase the personal data of a user, and all passwords, tokens and sessions."""
        self._change(*(delete(table).where(table.c.user_id == user) for table in _OF_A_USER))
        if self._writing.dialect.name == "sqlite":
            # Deleted bytes are overwritten (secure_delete), but the write-ahead log still has older pages.
            with suppress(SQLAlchemyError), self._writing.connect() as connection:
                connection.connection.driver_connection.execute(  # type: ignore[union-attr]
                    "PRAGMA wal_checkpoint(TRUNCATE)"
                )

    # -- passwords -----------------------------------------------------------------------------

    def password(self, user: str) -> str:
        """The hash of a user's password; empty if there is none."""
        return str(self._value(select(password_table.c.hash).where(password_table.c.user_id == user)) or "")

    def set_password(self, user: str, hash_: str, now: int) -> None:
        self._change(*_replace(password_table, user, hash=hash_, changed_at=now))

    # -- tokens --------------------------------------------------------------------------------

    def add_token(self, token: Token, digest: bytes) -> None:
        self._change(_insert(token_table, token, digest))

    def token(self, digest: bytes) -> Token | None:
        return next(iter(self._tokens(token_table.c.digest == digest)), None)

    def tokens(self, user: str = "") -> list[Token]:
        """The tokens of a user, or of all users; the oldest first."""
        return self._tokens(token_table.c.user_id == user if user else None)

    def _tokens(self, condition: Any) -> list[Token]:
        statement = select(token_table).order_by(token_table.c.created_at)
        with self.read() as connection:
            rows = connection.execute(statement if condition is None else statement.where(condition)).all()
        return [make_from(Token, row, user=row.user_id) for row in rows]

    def use_token(self, id_: str, now: int) -> None:
        self._change(update(token_table).where(token_table.c.id == id_).values(used_at=now))

    def revoke_token(self, id_: str, now: int) -> None:
        valid = (token_table.c.id == id_, token_table.c.revoked_at == 0)
        self._change(update(token_table).where(*valid).values(revoked_at=now))

    # -- sessions ------------------------------------------------------------------------------

    def add_session(self, session: Session, digest: bytes) -> None:
        """Sessions that have ended are deleted here too."""
        ended = session_table.c.expires_at <= session.created_at
        self._change(delete(session_table).where(ended), _insert(session_table, session, digest))

    def session(self, digest: bytes) -> Session | None:
        with self.read() as connection:
            row = connection.execute(select(session_table).where(session_table.c.digest == digest)).first()
        return None if row is None else make_from(Session, row, user=row.user_id)

    def end_session(self, digest: bytes) -> None:
        self._change(delete(session_table).where(session_table.c.digest == digest))

    def end_sessions(self, user: str) -> None:
        self._change(delete(session_table).where(session_table.c.user_id == user))

    # -- who an identity provider means ----------------------------------------------------------

    def user_of(self, issuer: str, subject: str) -> str:
        """The user with this name at an identity provider; empty if there is none."""
        table = identity_table.c
        found = self._value(select(table.user_id).where(table.issuer == issuer, table.subject == subject))
        return str(found or "")

    def link(self, issuer: str, subject: str, user: str) -> None:
        table = identity_table.c
        self._change(
            delete(identity_table).where(table.issuer == issuer, table.subject == subject),
            insert(identity_table).values(issuer=issuer, subject=subject, user_id=user),
        )

    def _change(self, *statements: Executable) -> None:
        """Carry out statements, all or none."""
        with self.change() as connection:
            for statement in statements:
                connection.execute(statement)

    def _value(self, statement: Any) -> Any:
        with self.read() as connection:
            return connection.execute(statement).scalar()


def _insert(table: Table, of_a_user: Token | Session, digest: bytes) -> Insert:
    fields = msgspec.structs.asdict(of_a_user)
    return insert(table).values(digest=digest, user_id=fields.pop("user"), **fields)


def _replace(table: Table, user: str, **values: Any) -> tuple[Delete, Insert]:
    """The statements that replace the row of a user."""
    return delete(table).where(table.c.user_id == user), insert(table).values(user_id=user, **values)


def open_accounts(url: str) -> SqlAccounts:
    """The accounts beside the log, in a database that has its tables. Close them before the log: SQLite
    merges its files into one when the last connection is closed."""
    parsed = parse_url(url)
    if parsed.get_backend_name() != "sqlite":
        from labos.store._postgres import make_small_engine

        engine = make_small_engine(parsed)
        return SqlAccounts(parsed, engine, engine)
    from labos.store._sqlite import make_reading_engine, make_writing_engine

    path = find_sqlite_path(parsed)
    return SqlAccounts(parsed, make_reading_engine(path), make_writing_engine(path))

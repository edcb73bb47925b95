"""The tables of who may sign in, on both databases: made for older labs too, changed, and erased."""

from __future__ import annotations

from collections.abc import Iterator

import pytest
from alembic import command

from labos.ports import Person, Session, Token
from labos.store import SqlAccounts, migrate, open_accounts, read_database_status
from labos.store._migrate import REVISION, alembic_config
from tests.integration.store.records import raw

TOKEN = Token("t1", "ada", "picker", "submitter", created_at=1, expires_at=100)


@pytest.fixture
def accounts(store_url: str) -> Iterator[SqlAccounts]:
    migrate(store_url)
    found = open_accounts(store_url)
    yield found
    found.close()


def test_a_lab_of_before_gets_them(store_url: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("LABOS_DATABASE_URL", store_url)
    command.upgrade(alembic_config(), "0001")
    assert read_database_status(store_url).state == "older"
    assert migrate(store_url) == REVISION
    with raw(store_url) as database:
        assert database.run("SELECT count(*) FROM account_token") == [(0,)]


def test_what_is_kept_is_found_again(accounts: SqlAccounts) -> None:
    accounts.set_person(Person("ada", "Ada", "ada@example.org"))
    accounts.set_person(Person("ada", "Ada Byron"))
    assert accounts.people() == {"ada": Person("ada", "Ada Byron")}
    accounts.set_password("ada", "first", 1)
    accounts.set_password("ada", "second", 2)
    assert (accounts.password("ada"), accounts.password("bob")) == ("second", "")
    accounts.add_token(TOKEN, b"d1")
    accounts.use_token("t1", 5)
    accounts.revoke_token("t1", 6)
    accounts.revoke_token("t1", 7)
    found = accounts.token(b"d1")
    assert found is not None
    assert (found.used_at, found.revoked_at, accounts.token(b"d2")) == (5, 6, None)
    assert accounts.tokens("ada") == accounts.tokens() == [found]
    accounts.link("https://a", "1", "ada")
    accounts.link("https://a", "1", "bob")
    assert (accounts.user_of("https://a", "1"), accounts.user_of("https://b", "1")) == ("bob", "")


def test_sessions_end(accounts: SqlAccounts) -> None:
    accounts.add_session(Session("ada", "password", 1, 10), b"s1")
    accounts.add_session(Session("ada", "oidc", 5, 20), b"s2")
    assert accounts.session(b"s1") == Session("ada", "password", 1, 10)
    accounts.add_session(Session("bob", "password", 11, 20), b"s3")
    assert accounts.session(b"s1") is None, "it was over, and went on this occasion"
    accounts.end_session(b"s3")
    accounts.end_sessions("ada")
    assert [accounts.session(name) for name in (b"s2", b"s3")] == [None, None]


def test_whoever_is_erased_leaves_nothing(accounts: SqlAccounts) -> None:
    for user in ("ada", "bob"):
        accounts.set_person(Person(user, f"Person {user}"))
        accounts.set_password(user, "hash", 1)
        accounts.add_session(Session(user, "password", 1, 10), user.encode())
        accounts.link("https://a", user, user)
    accounts.add_token(TOKEN, b"d1")
    accounts.erase("ada")
    assert list(accounts.people()) == ["bob"]
    assert (accounts.password("ada"), accounts.tokens(), accounts.session(b"ada")) == ("", [], None)
    assert (accounts.user_of("https://a", "ada"), accounts.user_of("https://a", "bob")) == ("", "bob")

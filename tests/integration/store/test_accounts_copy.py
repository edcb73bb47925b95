"""The accounts in a backup: the same people are let in after a restore, and who was erased is gone with the
next backup."""

from __future__ import annotations

import json
import stat
from pathlib import Path

import pytest

from labos.errors import BadInput, Refused
from labos.ports import Person, Token
from labos.store import copy_accounts, migrate, open_accounts, put_accounts_back, read_accounts_copy
from labos.store._accounts_copy import FILE
from tests.integration.trust.conftest import Lab
from tests.unit.services.logbook import two_users

KEY = b"0123456789abcdef0123456789abcdef"


def fill(url: str) -> None:
    accounts = open_accounts(url)
    accounts.set_person(Person("ada", "Ada Byron", "ada@example.org"))
    accounts.set_password("ada", "$argon2id$x", 1)
    accounts.add_token(Token("t1", "bob", "picker", "submitter", created_at=1, expires_at=100), b"\x00\xff1")
    accounts.link("https://idp", "4711", "ada")
    accounts.close()


def test_all_but_sessions_comes_back(store_url: str, tmp_path: Path) -> None:
    migrate(store_url)
    fill(store_url)
    accounts = open_accounts(store_url)
    made = copy_accounts(accounts, "lab1", tmp_path, 7, KEY)
    accounts.close()
    assert (made.users, stat.S_IMODE((tmp_path / FILE).stat().st_mode)) == (2, 0o600)
    copied = read_accounts_copy(tmp_path, "lab1", KEY)
    assert copied == made
    other = f"sqlite:///{tmp_path / 'other.db'}"
    migrate(other)
    there = open_accounts(other)
    put_accounts_back(there, copied)
    assert there.people() == {"ada": Person("ada", "Ada Byron", "ada@example.org")}
    assert there.password("ada") == "$argon2id$x"
    token = there.token(b"\x00\xff1")
    assert token is not None
    assert (token.user, token.scope, token.expires_at) == ("bob", "submitter", 100)
    assert there.user_of("https://idp", "4711") == "ada"
    there.close()


def test_a_copy_that_was_changed_or_is_of_another_lab_is_refused(tmp_path: Path) -> None:
    url = f"sqlite:///{tmp_path / 'labos.db'}"
    migrate(url)
    fill(url)
    accounts = open_accounts(url)
    copy_accounts(accounts, "lab1", tmp_path, 7, KEY)
    accounts.close()
    with pytest.raises(Refused, match="of the lab lab1"):
        read_accounts_copy(tmp_path, "lab2")
    text = (tmp_path / FILE).read_text()
    (tmp_path / FILE).write_text(text.replace('"bob"', '"ada"'))
    with pytest.raises(Refused, match="seal was not made with this key"):
        read_accounts_copy(tmp_path, "lab1", KEY)
    (tmp_path / FILE).write_text(text[:-40])
    with pytest.raises(BadInput, match="holds no accounts"):
        read_accounts_copy(tmp_path, "lab1")
    (tmp_path / FILE).unlink()
    assert read_accounts_copy(tmp_path, "lab1", KEY) is None


def test_who_was_erased_is_gone_with_the_next_backup(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("LABOS_DATABASE_URL", raising=False)
    lab, safe = Lab(tmp_path / "lab"), tmp_path / "safe"
    lab.home.mkdir(mode=0o700)
    lab.write(two_users().records)
    url = f"sqlite:///{lab.home / 'labos.db'}"
    fill(url)
    assert "The accounts of 2 users" in lab.ask("backup", str(safe))
    assert "Byron" in (safe / FILE).read_text()
    accounts = open_accounts(url)
    accounts.erase("ada")
    accounts.close()
    assert json.loads(lab.ask("backup", str(safe), "--json"))["users"] == 1
    left = [path for path in safe.rglob("*") if path.is_file() and b"Byron" in path.read_bytes()]
    assert left == []
    lab.ask("restore", str(safe), "--rehearse")
    (lab.home / "labos.db").rename(tmp_path / "broken.db")
    said = lab.ask("restore", str(safe))
    assert "The accounts of 1 users are as they were then" in said
    accounts = open_accounts(url)
    assert ([token.user for token in accounts.tokens()], accounts.people()) == (["bob"], {})
    accounts.close()


@pytest.mark.parametrize("attack", ["seal", "lab", "text", "row"])
def test_a_backup_is_verified_with_its_accounts(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, attack: str
) -> None:
    """What `labos restore` would refuse, `labos verify --backup` finds before."""
    monkeypatch.delenv("LABOS_DATABASE_URL", raising=False)
    lab, safe, key = Lab(tmp_path / "lab"), tmp_path / "safe", tmp_path / "key"
    lab.home.mkdir(mode=0o700)
    lab.write(two_users().records)
    key.write_text("k" * 64)
    key.chmod(0o600)
    sealing = ("--key", str(key)) if attack == "seal" else ()
    fill(f"sqlite:///{lab.home / 'labos.db'}")
    lab.ask("backup", str(safe), *sealing)
    assert "The accounts of 2 users are intact" in lab.ask("verify", "--backup", str(safe), *sealing)
    told = json.loads(lab.ask("verify", "--backup", str(safe), *sealing, "--json"))
    assert (told["whole"], told["accounts"]["users"]) == (True, 2)
    text = (safe / FILE).read_text()
    changed = {
        "seal": text.replace('"bob"', '"ada"'),
        "lab": text.replace(json.loads(text)["lab"], "another"),
        "text": text[:-40],
        "row": text.replace("00ff31", "no hex"),
    }[attack]
    assert changed != text
    (safe / FILE).write_text(changed)
    said = lab.ask("verify", "--backup", str(safe), *sealing, code=1)
    assert "The backup is damaged" in said
    assert "accounts.json" in said
    told = json.loads(lab.ask("verify", "--backup", str(safe), *sealing, "--json", code=1))
    assert told["whole"] is False
    (safe / FILE).unlink()
    assert "It contains no accounts" in lab.ask("verify", "--backup", str(safe), *sealing)

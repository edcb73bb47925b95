"""``labos pki``: what each command prints and leaves behind."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from labos.pki import Authority
from tests.integration.trust.conftest import Lab
from tests.unit.services.logbook import two_users


@pytest.fixture
def lab(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Lab:
    monkeypatch.delenv("LABOS_DATABASE_URL", raising=False)
    found = Lab(tmp_path / "lab")
    found.home.mkdir(mode=0o700)
    return found


def test_the_life_of_a_certificate(lab: Lab) -> None:
    assert "LabOS issues the certificates" in lab.ask("pki", "init")
    assert "No certificate was issued yet" in lab.ask("pki", "list")
    assert "There is no log yet" in lab.ask("pki", "issue", "node", "rpl/sealer", code=1)
    lab.write(two_users().records)
    folder = Path(lab.ask("pki", "issue", "node", "rpl/sealer").strip())
    assert sorted(path.name for path in folder.iterdir()) == ["ca.pem", "cert.pem", "key.pem"]
    (shown,) = json.loads(lab.ask("pki", "list", "--json"))
    assert (shown["kind"], shown["name"], shown["folder"]) == ("node", "rpl/sealer", str(folder))
    assert shown["lab"]
    assert lab.ask("pki", "renew", "rpl/sealer", "--days", "30").strip() == str(folder)
    assert "can no longer connect" in lab.ask("pki", "revoke", "rpl.sealer", "--why", "lost")
    assert "revoked" in lab.ask("pki", "list")
    assert lab.ask("pki", "issue", "node", "rpl/sealer").strip() == str(folder)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("node",), "A node needs a name"),
        (("node", "sealer"), "WORKCELL/MODULE"),
        (("kernel", "me"), "A kernel has no name"),
    ],
)
def test_who_cannot_have_a_certificate(lab: Lab, words: tuple[str, ...], said: str) -> None:
    lab.ask("pki", "init")
    assert said in lab.ask("pki", "issue", *words, code=2)


def test_the_site_issues(lab: Lab, tmp_path: Path) -> None:
    site = Lab(tmp_path / "site")
    site.home.mkdir()
    site.ask("pki", "init")
    theirs = Path(site.ask("pki", "issue", "viewer", "sealer", "--lab-id", "site").strip())
    assert "the site issues" in lab.ask("pki", "init", "--ca", str(site.home / "pki" / "ca.pem"))
    files = ("--certificate", str(theirs / "cert.pem"), "--key", str(theirs / "key.pem"), "--lab-id", "lab-1")
    folder = Path(lab.ask("pki", "admit", "node", "rpl/sealer", *files).strip())
    assert (folder / "key.pem").read_bytes() == (theirs / "key.pem").read_bytes()
    assert not Authority(lab.home / "pki").issues
    assert "Ask the site" in lab.ask("pki", "issue", "node", "rpl/other", "--lab-id", "lab-1", code=1)

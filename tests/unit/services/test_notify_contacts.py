"""The contacts file: what is accepted, and where its faults are said to be."""

from __future__ import annotations

from pathlib import Path

import pytest

from labos.errors import Undelivered
from labos.services.notify import load_contacts
from labos.services.notify.contacts import Book, Contact, EscalationLevel, Smtp
from labos.spec import SpecErrors, parse_source
from tests.docs.markdown import REFERENCE, blocks, first_codes, section

GOOD = """\
labos: 1
timezone: Europe/Zurich
smtp:
  host: mail.example.org
  user: labos
  password: {env: LABOS_TEST_SMTP}
  sender: labos@example.org
contacts:
  anna:
    email: anna@example.org
    quiet: {start: "22:00", end: "07:00", urgent: pass}
  duty:
    webhook: https://hooks.example.org/labos
    about: [interventions, kernel]
escalation:
  - notify: [anna]
  - notify: [duty]
    after: 15 min
"""


def faults(text: str) -> list[str]:
    with pytest.raises(SpecErrors) as found:
        load_contacts(parse_source(text, "contacts.yaml"))
    return [str(error) for error in found.value.errors]


def test_a_good_file() -> None:
    book = load_contacts(parse_source(GOOD))
    assert book.contacts["anna"].quiet is not None
    assert book.contacts["anna"].quiet.start == 22 * 60
    assert [(level.notify, level.after) for level in book.levels] == [(["anna"], 0.0), (["duty"], 900.0)]
    assert book.contacts["anna"].about == ["interventions", "windows", "modules", "kernel", "runs"]


def test_without_escalation_everybody_is_told_at_once() -> None:
    book = load_contacts(parse_source(GOOD.partition("escalation")[0]))
    assert [level.notify for level in book.levels] == [["anna", "duty"]]


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ("notify: [duty]", "notify: [dutty]", "contacts.yaml:17:14: escalation[1].notify[0]: There is no"),
        ('"22:00"', '"25:00"', "contacts.yaml:11:20: contacts.anna.quiet.start: A time of day is written"),
        ("email: anna@example.org", "email: anna", "contacts.yaml:10:12: contacts.anna.email:"),
        ("email: anna@", "emial: anna@", "contacts.yaml:10:5: contacts.anna.emial: The key 'emial'"),
        ("Europe/Zurich", "Europe/Zuerich", "contacts.yaml:2:11: timezone: There is no time zone"),
        ("    webhook: https", "    webhook: ftp", "contacts.yaml:13:14: contacts.duty.webhook: A webhook"),
        ("{env: LABOS_TEST_SMTP}", "secret", "contacts.yaml:6:13: smtp.password:"),
        ("  user: labos\n", "", "contacts.yaml:4:3: smtp: `user:` and `password:` are needed together."),
        ("  user: labos", "  user: labos\n  security: none", "smtp.security: The password would be sent"),
        (
            "    about: [",
            "    email: d@example.org\n    about: [",
            "contacts.duty: 'duty' needs exactly one of",
        ),
    ],
)
def test_faults_are_found_where_they_are(old: str, new: str, told: str) -> None:
    assert old in GOOD
    found = faults(GOOD.replace(old, new))
    assert any(told in fault for fault in found), found


def test_mail_needs_a_server() -> None:
    text = "contacts:\n  anna:\n    email: anna@example.org\n"
    assert faults(text) == [
        "contacts.yaml:3:12: contacts.anna.email: There is no mail server to send this through. "
        "Add `smtp:` to the file."
    ]


def test_secrets_are_somewhere_else(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    book = load_contacts(parse_source(GOOD))
    assert book.smtp is not None
    assert book.smtp.password is not None
    with pytest.raises(Undelivered, match="LABOS_TEST_SMTP is empty"):
        book.smtp.password.value()
    monkeypatch.setenv("LABOS_TEST_SMTP", "geheim")
    assert book.smtp.password.value() == "geheim"
    file = tmp_path / "secret"
    kept = load_contacts(parse_source(GOOD.replace("env: LABOS_TEST_SMTP", f"file: {file}"))).smtp
    assert kept is not None
    assert kept.password is not None
    with pytest.raises(Undelivered, match="cannot be read"):
        kept.password.value()
    file.write_text("geheim\n")
    assert kept.password.value() == "geheim"


def test_the_reference_is_right() -> None:
    page = (REFERENCE / "contacts.md").read_text()
    (example,) = (block for block in blocks(page) if block.language == "yaml")
    assert list(load_contacts(parse_source(example.text)).contacts) == ["anna", "ben", "duty"]
    parts = {"Top level": Book, "smtp": Smtp, "contacts": Contact, "escalation": EscalationLevel}
    for heading, model in parts.items():
        assert first_codes(section(page, heading)) == list(model.model_fields), heading

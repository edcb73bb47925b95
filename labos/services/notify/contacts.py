"""The contacts file: who is notified of what, when, and by which channel.

Names and addresses stay in this file. It never contains passwords: it names the environment variable or file
in which they are.
"""

from __future__ import annotations

import os
import re
from datetime import tzinfo
from pathlib import Path
from typing import Annotated, Literal
from zoneinfo import ZoneInfo

from pydantic import AfterValidator, BeforeValidator, Field, model_validator

from labos.errors import Undelivered
from labos.spec.findings import FindingList, SpecErrors, suggest_name
from labos.spec.parts import Part, Seconds
from labos.spec.source import Path_, Source, read
from labos.spec.validation import validate

Topic = Literal["interventions", "windows", "modules", "kernel", "runs"]
TOPICS: tuple[Topic, ...] = ("interventions", "windows", "modules", "kernel", "runs")
LOOPBACK = ("localhost", "127.0.0.1", "::1")

_CLOCK = re.compile(r"([01]?\d|2[0-3]):([0-5]\d)")


def _parse_minutes(value: object) -> int:
    match = _CLOCK.fullmatch(value) if isinstance(value, str) else None
    if match is None:
        raise ValueError("a time of day is written as '22:00'")
    return int(match[1]) * 60 + int(match[2])


def _check_zone(name: str) -> str:
    try:
        ZoneInfo(name)
    except (ValueError, OSError, LookupError):
        raise ValueError(f"there is no time zone {name!r}; write one such as 'Europe/Zurich'") from None
    return name


def _check_address(text: str) -> str:
    if not re.fullmatch(r"[^\s@<>,]+@[^\s@<>,]+", text):
        raise ValueError(f"{text!r} is not an e-mail address")
    return text


def _check_web_address(text: str) -> str:
    if not re.match(r"https?://[^/\s]+", text):
        raise ValueError("a webhook begins with https:// or http://")
    return text


TimeOfDay = Annotated[int, BeforeValidator(_parse_minutes)]
ContactName = Annotated[str, Field(pattern=r"^[A-Za-z0-9_][A-Za-z0-9_\-]*$", max_length=64)]


class Secret(Part):
    """Where a password is: in an environment variable, or as the only content of a file."""

    env: str = ""
    file: str = ""

    @model_validator(mode="after")
    def _check_one(self) -> Secret:
        if bool(self.env) == bool(self.file):
            raise ValueError("a secret needs either `env:` or `file:`")
        return self

    def value(self) -> str:
        """The secret itself. Raises Undelivered if it does not exist."""
        if self.env:
            found = os.environ.get(self.env, "")
        else:
            try:
                found = Path(self.file).read_text(encoding="utf-8").strip()
            except (OSError, ValueError) as error:
                raise Undelivered(f"The secret in {self.file} cannot be read: {error}.") from None
        if not found:
            raise Undelivered(
                f"The secret in {self.env or self.file} is empty.", remedy="Set it and start LabOS again."
            )
        return found


class Smtp(Part):
    """The mail server. ``security`` none is for a server on this computer, or one without a password."""

    host: str
    port: int = Field(default=587, ge=1, le=65535)
    security: Literal["starttls", "tls", "none"] = "starttls"
    user: str = ""
    password: Secret | None = None
    sender: Annotated[str, AfterValidator(_check_address)]


class Quiet(Part):
    """Hours in which messages that are not urgent are held until the hours end. ``urgent`` says whether
    urgent ones are sent or held too."""

    start: TimeOfDay
    end: TimeOfDay
    urgent: Literal["pass", "hold"] = "hold"


class Contact(Part):
    """A person or group to notify: by e-mail or by a webhook. ``about`` are the topics they want."""

    email: Annotated[str, AfterValidator(_check_address)] = ""
    webhook: Annotated[str, AfterValidator(_check_web_address)] = ""
    token: Secret | None = None
    about: list[Topic] = list(TOPICS)
    quiet: Quiet | None = None
    timezone: Annotated[str, AfterValidator(_check_zone)] | None = None

    @property
    def channel(self) -> str:
        return "email" if self.email else "webhook"


class EscalationLevel(Part):
    """The contacts that are notified next if nobody has answered for a given time."""

    notify: list[str] = Field(min_length=1)
    after: Annotated[Seconds, Field(ge=0)] = 0.0


class Book(Part):
    """The contacts file. Without ``escalation`` all contacts are notified at once. ``module_grace`` is how
    long a module may be away before anybody is notified."""

    labos: Literal[1] = 1
    timezone: Annotated[str, AfterValidator(_check_zone)] | None = None
    module_grace: Annotated[Seconds, Field(ge=0)] = 60.0
    smtp: Smtp | None = None
    contacts: dict[ContactName, Contact] = Field(min_length=1)
    escalation: list[EscalationLevel] = []

    @property
    def levels(self) -> list[EscalationLevel]:
        return self.escalation or [EscalationLevel(notify=list(self.contacts))]

    def find_zone(self, contact: Contact) -> tzinfo | None:
        """The contact's time zone, else the lab's; None for the time zone of this computer."""
        name = contact.timezone or self.timezone
        return ZoneInfo(name) if name else None


def load_contacts(source: Source | str | Path) -> Book:
    """Read a contacts file. Raises SpecError or SpecErrors with line and column."""
    source = source if isinstance(source, Source) else read(source)
    report = FindingList(source.file)
    book = validate(Book, source, report)
    if book is not None:
        _check(book, source, report)
    if book is None or report.errors:
        raise SpecErrors(report.sort_findings())
    return book


def _check(book: Book, source: Source, report: FindingList) -> None:
    """Checks that concern several values together."""

    def error(message: str, path: Path_, remedy: str) -> None:
        report.error(message, source.place(path), field=source.name_field(path), remedy=remedy)

    for name, contact in book.contacts.items():
        path: Path_ = ("contacts", name)
        if bool(contact.email) == bool(contact.webhook):
            error(
                f"{name!r} needs exactly one of `email:` and `webhook:`.",
                path,
                "Give `email:` or `webhook:`.",
            )
        if contact.email and book.smtp is None:
            error(
                "There is no mail server to send this through.", (*path, "email"), "Add `smtp:` to the file."
            )
        if contact.token is not None and not contact.webhook:
            error("A token is only for a webhook.", (*path, "token"), "Remove it.")
        if contact.quiet is not None and contact.quiet.start == contact.quiet.end:
            error(
                "The start and the end of these hours are equal.",
                (*path, "quiet"),
                "Change `start:` or `end:`.",
            )
    for number, level in enumerate(book.escalation):
        for index, name in enumerate(level.notify):
            if name not in book.contacts:
                at = ("escalation", number, "notify", index)
                error(f"There is no contact {name!r}.", at, suggest_name(name, book.contacts, "contact"))
    smtp = book.smtp
    if smtp is not None:
        if bool(smtp.user) != (smtp.password is not None):
            error("`user:` and `password:` are needed together.", ("smtp",), "Give both or neither.")
        if smtp.security == "none" and smtp.password is not None and smtp.host not in LOOPBACK:
            error(
                "The password would be sent over the network unencrypted.",
                ("smtp", "security"),
                "Write `starttls` or `tls`.",
            )

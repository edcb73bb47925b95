"""Sends messages: by SMTP or as a webhook. Calls block and raise Undelivered."""

from __future__ import annotations

import smtplib
import ssl
from datetime import UTC, datetime
from email.message import EmailMessage
from email.utils import format_datetime
from typing import Any

import msgspec

from labos.errors import Undelivered
from labos.services.notify.contacts import Book, Contact, Smtp
from labos.services.notify.notices import Notice

TIMEOUT_S = 10.0


class Notification(msgspec.Struct, frozen=True):
    """``id`` is the same at every attempt: by it a receiver recognises a second copy."""

    id: str
    lab: str
    lab_name: str
    notice: Notice
    level: int

    @property
    def subject(self) -> str:
        again = " (nobody has answered)" if self.level else ""
        return " ".join(f"[{self.lab_name}] {self.notice.title}{again}".split())


def send(book: Book, contact: Contact, message: Notification) -> None:
    """Send a message to a contact. Raises Undelivered."""
    if contact.email:
        assert book.smtp is not None
        _mail(book.smtp, contact.email, message)
    else:
        _post(contact, message)


def make_way_key(contact: Contact) -> str:
    """The name of the server, which is the same for all messages that cannot be sent if this server is
    unreachable."""
    return contact.webhook or "smtp"


def mail(smtp: Smtp, address: str, message: Notification) -> EmailMessage:
    """The message as e-mail (RFC 5322), with a Message-ID that stays the same."""
    letter = EmailMessage()
    letter["From"] = smtp.sender
    letter["To"] = address
    letter["Subject"] = message.subject
    letter["Date"] = format_datetime(datetime.fromtimestamp(message.notice.at // 10**9, UTC))
    letter["Message-ID"] = f"<{message.id}@{message.lab or 'labos'}.labos>"
    # RFC 3834: automatic replies, such as those during holidays, are not wanted.
    letter["Auto-Submitted"] = "auto-generated"
    if message.notice.urgent:
        letter["Importance"] = "high"
    where = f"\n\n-- \nlab {message.lab_name}, event {message.notice.position}\n"
    letter.set_content(message.notice.text + where)
    return letter


def make_body(message: Notification) -> dict[str, Any]:
    """The message as the JSON of a webhook."""
    notice = message.notice
    return {
        "id": message.id,
        "lab": message.lab,
        "lab_name": message.lab_name,
        "topic": notice.topic,
        "about": notice.key,
        "urgent": notice.urgent,
        "level": message.level,
        "title": notice.title,
        "text": notice.text,
        "event": notice.event,
        "position": notice.position,
        "time": datetime.fromtimestamp(notice.at / 1e9, UTC).isoformat(timespec="milliseconds"),
    }


def _mail(smtp: Smtp, address: str, message: Notification) -> None:
    letter = mail(smtp, address, message)
    name = f"The mail server {smtp.host}:{smtp.port}"
    try:
        with _connect(smtp) as server:
            if smtp.security == "starttls":
                server.starttls(context=ssl.create_default_context())
            if smtp.password is not None:
                server.login(smtp.user, smtp.password.value())
            server.send_message(letter)
    except (smtplib.SMTPRecipientsRefused, smtplib.SMTPDataError) as error:
        raise Undelivered(f"{name} refused the message: {_describe_error(error, address)}.") from None
    except (smtplib.SMTPException, OSError, ValueError) as error:
        why = f"{name} cannot be used: {_describe_error(error, address)}."
        raise Undelivered(why, unreachable=True, remedy="Check `smtp:` in the contacts file.") from None


def _connect(smtp: Smtp) -> smtplib.SMTP:
    if smtp.security == "tls":
        context = ssl.create_default_context()
        return smtplib.SMTP_SSL(smtp.host, smtp.port, timeout=TIMEOUT_S, context=context)
    return smtplib.SMTP(smtp.host, smtp.port, timeout=TIMEOUT_S)


def _describe_error(error: Exception, address: str) -> str:
    """A description of the error, without the address of the contact."""
    return _describe_server_error(error).replace(address, "the address").rstrip(".")


def _describe_server_error(error: Exception) -> str:
    if isinstance(error, smtplib.SMTPRecipientsRefused):
        code, text = next(iter(error.recipients.values()))
        return f"{code} {text.decode(errors='replace')}"
    if isinstance(error, smtplib.SMTPResponseException):
        reply = error.smtp_error
        return f"{error.smtp_code} {reply.decode(errors='replace') if isinstance(reply, bytes) else reply}"
    return str(error) or type(error).__name__


def _post(contact: Contact, message: Notification) -> None:
    import httpx

    headers = {"Idempotency-Key": message.id, "User-Agent": "labos"}
    if contact.token is not None:
        headers["Authorization"] = f"Bearer {contact.token.value()}"
    # Only the host is named in errors: the path of a webhook often contains its password.
    host = httpx.URL(contact.webhook).host
    try:
        answer = httpx.post(contact.webhook, json=make_body(message), headers=headers, timeout=TIMEOUT_S)
    except (httpx.HTTPError, httpx.InvalidURL) as error:
        why = f"The webhook at {host} cannot be reached: {str(error) or type(error).__name__}."
        raise Undelivered(why, unreachable=True) from None
    if not answer.is_success:
        raise Undelivered(f"The webhook at {host} answered {answer.status_code}.")

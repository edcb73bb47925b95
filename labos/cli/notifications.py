"""``labos notifications``: the notifications of contacts."""

from __future__ import annotations

import time
from contextlib import suppress
from typing import TYPE_CHECKING, Any

import click

from labos.cli._group import Suggesting
from labos.cli._lab import end_in_order
from labos.cli._liveness import open_current_log
from labos.cli._out import end_with_json, report_done, show_table
from labos.cli._query import Where, find_lab_id, folder_and_json, folder_options
from labos.clock import SystemClock
from labos.errors import LabosError, NotFound, StoreError
from labos.services.shown import show_struct
from labos.services.times import iso_time, show_time
from labos.spec.findings import suggest_name
from labos.store import find_lease_holder, find_silent_holder

if TYPE_CHECKING:
    from labos.services.notify import Delivery, Notifier

LOOK_EVERY_S = 2.0


@click.group(
    "notifications",
    cls=Suggesting,
    short_help="List sent and unsent notifications.",
    invoke_without_command=True,
)
@click.option("--contact", metavar="NAME", default="", help="Show only notifications to this contact.")
@click.option("--waiting", is_flag=True, help="Show only notifications that were not delivered yet.")
@click.option(
    "--last", type=click.IntRange(min=1), default=50, show_default=True, help="The maximum number of entries."
)
@folder_and_json
@click.pass_context
def command(ctx: click.Context, where: Where, contact: str, waiting: bool, last: int) -> None:
    """List sent and unsent notifications. LabOS notifies contacts of questions, missed windows, unavailable
    modules, failed runs, and a stopped kernel.

    The contacts are in the file that LABOS_CONTACTS names, or in contacts.yaml in the lab's home. The file
    lists whom to notify, whom to notify next if nobody answers, and the quiet hours. LabOS tries a failed
    delivery again for up to three days. The last column shows the reason of the failure.

    \b
    labos notifications --waiting
    labos notifications test anna
    labos notifications watch
    """
    if ctx.invoked_subcommand is not None:
        return
    from labos.services.notify import Outbox

    path = where.settings.notifications
    found = []
    if path.is_file():
        outbox = Outbox(path, create=False)
        found = outbox.list_deliveries(contact, waiting=waiting, last=last)
        outbox.close()
    with suppress(LabosError), open_current_log(where, last_known=False) as store:  # there may be no lab yet
        found = [show_struct(store, delivery) for delivery in found]
    end_with_json([_list_facts(delivery) for delivery in found])
    rows = [
        (
            delivery.contact,
            str(delivery.level),
            delivery.notice.title,
            delivery.state.replace("_", " "),
            show_time(delivery.done_at or delivery.try_at),
            str(delivery.attempts or ""),
            delivery.error,
        )
        for delivery in found
    ]
    show_table(("to", "level", "what", "state", "when", "tries", "why not"), rows)


@command.command("test")
@click.argument("contact")
@folder_and_json
def test(where: Where, contact: str) -> None:
    """Send a test message to CONTACT now, also in quiet hours, and report whether it was accepted.

    \b
    labos notifications test anna
    """
    from labos.services.notify import Book, load_contacts
    from labos.services.notify.channels import send
    from labos.services.notify.notifier import test_message

    book: Book = load_contacts(where.settings.contacts)
    if contact not in book.contacts:
        remedy = suggest_name(contact, book.contacts, "contact")
        raise NotFound(f"The contacts file has no contact {contact!r}.", remedy=remedy)
    # A contact can be tested before there is a lab.
    message = test_message(find_lab_id(where), contact, SystemClock())
    send(book, book.contacts[contact], message)
    channel = book.contacts[contact].channel
    text = f"A test message was sent to {contact} by {channel}: {message.id}"
    report_done(text, {"contact": contact, "channel": channel, "message": message.id})


@command.command("watch")
@folder_options
def watch(where: Where) -> None:
    """Send notifications from a separate process, until Ctrl-C. It also notifies you if the kernel is dead.

    `labos up` sends notifications itself, unless this command already runs. Only one of the two sends. If
    the kernel ends or is killed, this process takes over. To be notified of a failed computer, run this
    command on another computer, with its own --home and the lab's --database.

    \b
    labos notifications watch --home lab
    """
    from labos.bootstrap import find_contacts, make_notifier

    settings = where.settings
    book = find_contacts(settings)
    if book is None:
        raise NotFound(
            f"There is no contacts file {settings.contacts}.", remedy="Write one, or set LABOS_CONTACTS."
        )
    click.echo("Watching. Ctrl-C ends it.")
    try:
        with end_in_order():
            while True:
                with make_notifier(settings, book, SystemClock()) as notifier:
                    while notifier is not None:
                        _look(where, notifier)
                        time.sleep(LOOK_EVERY_S)
                time.sleep(LOOK_EVERY_S)
    except KeyboardInterrupt:
        pass


def _look(where: Where, notifier: Notifier) -> None:
    """Check the lab and its kernel once."""
    try:
        notifier.read()
        owner = find_silent_holder(where.url)
        if owner:
            notifier.on_kernel_stopped(
                f"its lease ({owner}) has expired; it was killed, or its computer has failed"
            )
        elif find_lease_holder(where.url):
            notifier.on_kernel_lives()
        else:
            notifier.on_kernel_closed()
        notifier.turn()
    except StoreError as error:
        click.echo(f"labos: {error}", err=True)


def _list_facts(delivery: Delivery) -> dict[str, Any]:
    notice = delivery.notice
    return {
        "id": delivery.id,
        "contact": delivery.contact,
        "level": delivery.level,
        "topic": notice.topic,
        "about": notice.key,
        "title": notice.title,
        "urgent": notice.urgent,
        "event": notice.event,
        "position": notice.position,
        "state": delivery.state,
        "attempts": delivery.attempts,
        "error": delivery.error,
        "due": iso_time(delivery.due_at),
        "next_try": iso_time(delivery.try_at) if delivery.state == "waiting" else "",
        "done": iso_time(delivery.done_at) if delivery.done_at else "",
    }

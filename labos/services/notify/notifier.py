"""Follows the log, fills the outbox and sends the messages that are due, in its own thread."""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from itertools import islice

import structlog

from labos.clock import Clock
from labos.core.envelope import Envelope
from labos.core.ids import ModuleName, module_key
from labos.core.lab import KernelStarted, LabCreated
from labos.core.registry import Event
from labos.errors import StoreError, Undelivered
from labos.ports import LogQuery
from labos.services.log import Log, decode_event
from labos.services.notify import channels
from labos.services.notify.contacts import Book
from labos.services.notify.notices import (
    KERNEL,
    TYPES,
    Notice,
    SettledNotice,
    read_event,
    report_kernel_death,
    report_kernel_gone,
)
from labos.services.notify.outbox import Delivery, Outbox
from labos.services.notify.schedule import SECOND, Due, plan
from labos.services.shown import show_struct

PAGE = 500
FIRST_PAUSE_S = 30
LONGEST_PAUSE_S = 1800
GIVEN_UP_S = 3 * 86_400
IDLE_S = 60.0
"""The log is read at least every so many seconds, also without a signal."""

EVERY_MODULE = module_key(ModuleName(""))

OutboxItem = tuple[Notice, Sequence[Due]] | SettledNotice

_log = structlog.get_logger(__name__)


class Notifier:
    """``turn`` does everything that is due now; ``start`` repeats it in a thread until ``close``.

    ``log`` is a reader of its own, so the kernel never waits. ``hang_up`` interrupts the reader's pending
    request.
    """

    def __init__(
        self,
        log: Log,
        outbox: Outbox,
        book: Book,
        clock: Clock,
        *,
        simulated: bool = False,
        hang_up: Callable[[], None] = lambda: None,
    ) -> None:
        self.log, self.outbox, self.book, self.clock = log, outbox, book, clock
        self._hang_up = hang_up
        self.simulated = simulated
        self.closing = False
        self._dead = ""
        self._sent: set[str] = set()
        self._names = ("", "lab")
        self._started = ("kernel", 0)
        self._awake = threading.Event()
        self._ended = False
        self._thread: threading.Thread | None = None

    # -- start and end -----------------------------------------------------------------------

    def start(self) -> None:
        self._thread = threading.Thread(target=self._send_until_closed, name="labos-notifier", daemon=True)
        self._thread.start()

    def wake(self) -> None:
        """There are new events. May be called from any thread, and never waits."""
        self._awake.set()

    def on_kernel_stopped(self, why: str) -> None:
        """The kernel has failed. Its database may be unreachable, so the notice is sent without waiting for
        it."""
        self._dead = why or "without a reason"
        self._hang_up()
        self._awake.set()

    def on_kernel_closed(self) -> None:
        """The kernel has shut down properly, and its nodes too."""
        self._dead = ""
        now = self.clock.now_ns()
        self.outbox.take_in([SettledNotice(EVERY_MODULE, "the lab was closed", all=True, quietly=True)], now)
        self._note_closed()

    def on_kernel_lives(self) -> None:
        self._dead = ""

    def begin_close(self) -> None:
        """The lab is being shut down: nodes that leave now are expected to."""
        self.closing = True

    def close(self, patience_s: float = 5.0) -> None:
        """Send the messages that are due, for at most ``patience_s``; the others are sent when the lab runs
        again."""
        if not self._dead:
            self._note_closed()
        self.closing = self._ended = True
        self._awake.set()
        if self._thread is not None:
            self._thread.join(patience_s)  # it may wait for a server; the process does not have to

    @property
    def busy(self) -> bool:
        """Whether the thread has not ended, because it waits for a server."""
        return self._thread is not None and self._thread.is_alive()

    def _note_closed(self) -> None:
        epoch = self.outbox.note("epoch")
        if epoch:
            self.outbox.keep(closed=epoch)

    def _send_until_closed(self) -> None:
        failures = 0
        while True:
            self._awake.clear()
            ended = self._ended
            try:
                next_at = self.turn()
                failures = 0
            except Exception as error:
                if ended:
                    return
                failures += 1
                _log.error("notifier_failed", error=str(error), kind=type(error).__name__)
                next_at = self.clock.now_ns() + pause_ns(failures)
            if ended:
                return
            wait_s = IDLE_S if next_at is None else (next_at - self.clock.now_ns()) / SECOND
            self._awake.wait(min(max(wait_s, 0.01), IDLE_S))

    # -- a turn ------------------------------------------------------------------------------

    def turn(self) -> int | None:
        """Read the new events and send the messages that are due; returns when the next message is due (UTC
        ns)."""
        try:
            self.read()
        except StoreError as error:
            # Notices in the outbox are sent all the same: this error may be why the kernel stopped.
            _log.warning("log_not_read", why=str(error))
        if self._dead:
            self._notify_of_death()
        self.send_due()
        return self.outbox.find_next_time()

    def read(self) -> None:
        """Put the notices of new events into the outbox. Raises StoreError."""
        head = self.log.head()
        if head.lab != self._names[0] and head.position:
            self._names = (head.lab, self._find_lab_name())
            started = next(iter(self.log.select(LogQuery(types=(KernelStarted.TYPE,), last=1))), None)
            if started is not None:
                self._started = (started.head.id, started.head.position)
        position = self.outbox.note("position")
        if position is None:
            self._read_first(head.position)
            return
        while position < head.position:
            query = LogQuery(after=position, upto=head.position, types=TYPES)
            page = list(islice(self.log.select(query), PAGE))
            position = page[-1].head.position if len(page) == PAGE else head.position
            for record in page:
                self._take_in(decode_event(record), record.head)
            self.outbox.keep(position=position)

    def _read_first(self, upto: int) -> None:
        """The first reading of a log: there are no notifications about questions that were settled long
        ago."""
        waiting: dict[str, Notice] = {}
        epoch = 0
        for record in self.log.select(LogQuery(upto=upto, types=TYPES)):
            event = decode_event(record)
            if isinstance(event, KernelStarted):
                epoch = event.epoch
            item = read_event(event, record.head)
            if isinstance(item, SettledNotice):
                waiting.pop(item.key, None)
            elif item is not None and item.key:
                waiting.setdefault(item.key, item)
        now = self.clock.now_ns()
        self.outbox.take_in(
            [(notice, plan(self.book, notice, now)) for notice in waiting.values()],
            now,
            position=upto,
            epoch=epoch,
        )

    def _take_in(self, event: Event, head: Envelope) -> None:
        now = self.clock.now_ns()
        if isinstance(event, KernelStarted):
            items = self._make_restart_items(event, head, now)
            self._started = (head.id, head.position)
            self.outbox.take_in(items, now, position=head.position, epoch=event.epoch)
            return
        item = read_event(event, head)
        if isinstance(item, SettledNotice) and self.outbox.is_open(item.key):
            self.outbox.take_in([item], now, position=head.position)
        elif isinstance(item, Notice) and not self._is_known(item):
            self.outbox.take_in([(item, plan(self.book, item, now))], now, position=head.position)

    def _is_known(self, notice: Notice) -> bool:
        """Whether people have been notified already, or the event only shows that the lab is being shut
        down."""
        if notice.topic == "modules" and self.closing:
            return True
        return bool(notice.key) and self.outbox.is_open(notice.key)

    def _make_restart_items(self, event: KernelStarted, head: Envelope, now: int) -> list[OutboxItem]:
        """A new kernel finds out by itself which nodes are alive; and it shows that a kernel runs again."""
        items: list[OutboxItem] = [
            SettledNotice(EVERY_MODULE, "a new kernel is connecting to its nodes", all=True, quietly=True)
        ]
        before = self.outbox.note("epoch") or 0
        if before and self.outbox.note("closed") != before and not self.outbox.is_open(KERNEL):
            notice = report_kernel_gone(head, before, event.epoch)
            items.append((notice, plan(self.book, notice, now)))
        return [*items, SettledNotice(KERNEL, "the kernel runs again")]

    def _notify_of_death(self) -> None:
        """The kernel has stopped. People are notified once for each start of a kernel, also if the outbox
        cannot be written: a full disk may be why the kernel stopped."""
        now = self.clock.now_ns()
        notice = report_kernel_death(*self._started, now, self._dead)
        dues = plan(self.book, notice, now)
        try:
            self.outbox.take_in([(notice, dues)], now)
        except StoreError as error:
            _log.warning("outbox_not_written", why=str(error))
            for due in dues:
                waiting = Delivery(notice, due.contact, due.level, due.at, due.at, "waiting", 0, 0, "")
                if due.at <= now and waiting.id not in self._sent:
                    self._send(waiting, {})

    def _find_lab_name(self) -> str:
        created = next(iter(self.log.select(LogQuery(types=(LabCreated.TYPE,)))), None)
        event = decode_event(created) if created is not None else None
        name = event.name if isinstance(event, LabCreated) else "lab"
        return f"{name}, simulated" if self.simulated else name

    # -- sending -----------------------------------------------------------------------------

    def send_due(self) -> None:
        """Try to send every message that is due; if a server cannot be reached, it is tried only once."""
        unreachable: dict[str, str] = {}
        for delivery in self.outbox.list_due(self.clock.now_ns()):
            if delivery.contact not in self.book.contacts:
                why = "the contact is no longer in the contacts file"
                self.outbox.mark_failed(delivery, why, self.clock.now_ns(), None, tried=False)
            elif delivery.id in self._sent:
                self._note_sent(delivery)  # the delivery could not be recorded before
            else:
                why = self._send(delivery, unreachable)
                if why:
                    self._put_off(delivery, why)
                else:
                    self._note_sent(delivery)

    def _send(self, delivery: Delivery, unreachable: dict[str, str]) -> str:
        """Send one message; returns the reason if it was not accepted."""
        contact = self.book.contacts[delivery.contact]
        way = channels.make_way_key(contact)
        if way in unreachable:
            return unreachable[way]
        try:
            channels.send(self.book, contact, self._make_message(delivery))
        except Undelivered as error:
            if error.unreachable:
                unreachable[way] = str(error)
            _log.warning("not_delivered", to=delivery.contact, id=delivery.id, why=str(error))
            return str(error)
        self._sent.add(delivery.id)
        return ""

    def _note_sent(self, delivery: Delivery) -> None:
        self.outbox.mark_sent(delivery, self.clock.now_ns())
        self._sent.discard(delivery.id)

    def _make_message(self, delivery: Delivery) -> channels.Notification:
        """The message with the texts of people's words. The outbox has only references, as words may be
        erased."""
        notice = delivery.notice
        try:
            notice = show_struct(self.log, notice)
        except StoreError as error:
            _log.warning("words_not_read", why=str(error))
        return channels.Notification(delivery.id, *self._names, notice, delivery.level)

    def _put_off(self, delivery: Delivery, why: str) -> None:
        now = self.clock.now_ns()
        late = now - delivery.due_at > GIVEN_UP_S * SECOND
        try_at = None if late else now + pause_ns(delivery.attempts + 1)
        self.outbox.mark_failed(delivery, why, now, try_at)


def pause_ns(failures: int) -> int:
    """The pause after so many failures: 30 s, twice as long each time, half an hour at most."""
    doubled: int = FIRST_PAUSE_S << min(max(failures - 1, 0), 10)
    return min(doubled, LONGEST_PAUSE_S) * SECOND


def test_message(lab: str, contact: str, clock: Clock) -> channels.Notification:
    """A message with which a contact is tested."""
    now = clock.now_ns()
    text = "This is a test of LabOS' notifications. You need not do anything."
    notice = Notice(f"test-{now}", 0, now, "test", "", "a test message", text)
    return channels.Notification(f"test-{now}.{contact}.0", lab, "lab", notice, 0)

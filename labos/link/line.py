"""A link: questions and answers over a wire for bytes."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from labos.errors import Garbled, HalfReply, LinkError, NoReply, NotConnected, StrayReply
from labos.link.framing import BadFrame, Framing
from labos.link.life import Life
from labos.link.transcript import note
from labos.link.wire import Wire

Answers = Callable[[bytes, bytes], bool]
"""Whether a message (second) is the answer to a question (first)."""


class Link(Life):
    """One device at the other end of a wire. May be used from several threads.

    ``answers`` distinguishes the answer to a question from other messages, if the protocol allows it. Without
    it, a late answer could be mistaken for the next one. So after a missing answer, the link waits for
    ``late_s`` of silence before the next question (or connects again, if the wire then discards old bytes).
    ``unasked`` is called with each message, and returns true for one that the device sends without a
    question. ``identify`` asks the device for its identity each time the link is opened. An answer other than
    ``expected`` (empty: other than the first time) raises WrongDevice.
    """

    def __init__(
        self,
        wire: Wire,
        framing: Framing,
        *,
        name: str = "",
        answers: Answers | None = None,
        unasked: Callable[[bytes], bool] | None = None,
        identify: Callable[[Link], str] | None = None,
        expected: str = "",
        late_s: float = 1.0,
    ) -> None:
        super().__init__(name or wire.name, identify, expected)
        self._wire, self._framing = wire, framing
        self._answers, self._unasked = answers, unasked
        self._late_s = late_s
        self._buffer = bytearray()
        self._in_step = True

    def exchange(self, question: bytes, timeout_s: float = 5.0, *, answers: Answers | None = None) -> bytes:
        """Send a message and wait for its answer; connects first if necessary. Nothing is sent twice. Raises
        NotConnected (nothing was sent), LinkLost, NoReply, HalfReply, Garbled, StrayReply: in these cases, it
        is unknown whether the device has carried out the message.
        """
        answers = answers or self._answers
        with self._lock:
            self._make_ready(answers)
            deadline = time.monotonic() + timeout_s
            with self._judge():
                self._write(question, timeout_s)
                try:
                    return self._await(question, answers, deadline)
                except NoReply as error:
                    self._in_step = False
                    error.message = f"{self.name} does not answer {question[:80]!r} within {timeout_s:g} s."
                    raise
                except LinkError:
                    self._in_step = False
                    raise

    def send(self, message: bytes, timeout_s: float = 5.0) -> None:
        """Send a message that has no answer; connects first if necessary. Raises NotConnected, LinkLost."""
        with self._lock:
            self._make_ready(self._answers)
            with self._judge():
                self._write(message, timeout_s)

    def receive(self, timeout_s: float) -> bytes:
        """The next message of the device, with or without a question. Raises the errors of ``exchange``; they
        say that nothing was sent."""
        with self._in_turn(), _report_nothing_sent():
            return self._next(time.monotonic() + timeout_s)

    def drain(self) -> None:
        """Discard the received bytes, but pass on messages that came without a question. Raises LinkLost."""
        with self._lock, self._judge(), _report_nothing_sent():
            self._discard(keep_partial=False)

    # -- inside ------------------------------------------------------------------------------

    def _connect(self) -> None:
        self._wire.open()
        self._in_step = True
        self._buffer.clear()

    def _disconnect(self) -> None:
        self._buffer.clear()
        self._wire.close()

    def _make_ready(self, answers: Answers | None) -> None:
        """Connect, synchronise, and discard old bytes."""
        if not self._is_open:
            self.open()
        with self._judge(), _report_nothing_sent():
            if not self._in_step and answers is None:
                self._resynchronise()
            self._in_step = True
            self._discard(keep_partial=answers is not None)

    def _resynchronise(self) -> None:
        if self._wire.forgets:
            self.close()
            self.open()
            return
        limit = time.monotonic() + 10 * self._late_s + 1.0
        self._buffer.clear()
        while self._read(self._late_s):
            if time.monotonic() > limit:
                raise NotConnected(
                    f"{self.name} sends without a pause, so its answers cannot be separated.",
                    remedy="Switch it off and on.",
                )

    def _discard(self, *, keep_partial: bool) -> None:
        while data := self._read(0.0):
            self._buffer += data
        while True:
            try:
                message = self._framing.take(self._buffer)
            except BadFrame as error:
                note(self.name, "!", f"dropped: {error}".encode("ascii", "replace"))
                continue
            if message is None:
                break
            if self._unasked is not None:
                self._unasked(message)
        if not keep_partial:
            self._buffer.clear()

    def _await(self, question: bytes, answers: Answers | None, deadline: float) -> bytes:
        failure: LinkError | None = None
        while True:
            try:
                message = self._next(deadline)
            except Garbled as error:
                if answers is None:
                    raise
                failure = error
                continue
            except (NoReply, HalfReply):
                if failure is not None:
                    raise failure from None
                raise
            if self._unasked is not None and self._unasked(message):
                continue
            if answers is None or answers(question, message):
                return message
            failure = StrayReply(
                f"{self.name}: {message[:80]!r} is no answer to {question[:80]!r}.",
                remedy="The device may be slow, or another program may be using it.",
            )

    def _next(self, deadline: float) -> bytes:
        while True:
            try:
                message = self._framing.take(self._buffer)
            except BadFrame as error:
                raise Garbled(
                    f"{self.name} sent data that is not a message: {error}.",
                    remedy="Check the cable, the speed and the parity.",
                ) from error
            if message is not None:
                return message
            data = self._read(max(deadline - time.monotonic(), 0.0))
            self._buffer += data
            if data:
                continue
            if self._buffer:
                raise HalfReply(
                    f"{self.name} did not finish a message: {bytes(self._buffer[:80])!r}.",
                    remedy="Check the cable, and that the device is not switched off.",
                )
            raise NoReply(f"{self.name} does not answer.", remedy="Check that the device is switched on.")

    def _read(self, timeout_s: float) -> bytes:
        data = self._wire.read(timeout_s)
        if data:
            note(self.name, "<", data)
        return data

    def _write(self, message: bytes, timeout_s: float) -> None:
        data = self._framing.pack(message)
        note(self.name, ">", data)
        self._wire.write(data, timeout_s)


@contextmanager
def _report_nothing_sent() -> Iterator[None]:
    """Report errors as ones before which no question was sent."""
    try:
        yield
    except LinkError as error:
        error.effects = "none"
        raise

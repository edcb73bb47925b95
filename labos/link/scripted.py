"""A wire that replays a transcript, so that recorded answers of a device become a test."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from labos.errors import LinkLost
from labos.link.transcript import TranscriptLine, read_exchanges


class OffScript(AssertionError):
    """The sent bytes are not the next ones in the transcript."""


class ScriptedWire:
    """Gives the recorded answer of the device as soon as the bytes before it have been sent again. No time
    passes: if the transcript has no answer before the next question, the read times out at once."""

    name = "scripted"
    forgets = True

    def __init__(self, script: str | Path | Iterable[TranscriptLine]) -> None:
        self._records = read_exchanges(script)
        self._at = 0
        self._sent = b""
        self._open = False

    @property
    def is_over(self) -> bool:
        """Whether everything in the transcript has been sent again."""
        return not any(record.mark == ">" for record in self._records[self._at :])

    def open(self) -> None:
        self._open = True

    def write(self, data: bytes, timeout_s: float = 0.0) -> None:
        self._needs_open()
        self._sent += data
        while self._sent:
            # The caller has received, or did not wait for, the device's messages before this point.
            turn = next(
                (n for n in range(self._at, len(self._records)) if self._records[n].mark == ">"), None
            )
            wanted = self._records[turn].data if turn is not None else b""
            if turn is None or not (wanted.startswith(self._sent) or self._sent.startswith(wanted)):
                raise OffScript(
                    f"{self._sent!r} was sent; the transcript has {wanted!r} (its end, if empty)."
                )
            if len(self._sent) < len(wanted):
                return
            self._sent = self._sent[len(wanted) :]
            self._records.pop(turn)

    def read(self, timeout_s: float = 0.0) -> bytes:
        self._needs_open()
        if self._at < len(self._records) and self._records[self._at].mark == "<":
            self._at += 1
            return self._records[self._at - 1].data
        return b""

    def close(self) -> None:
        self._open = False

    def _needs_open(self) -> None:
        if not self._open:
            raise LinkLost("The scripted wire is not open.", effects="none")


class ScriptedHttp:
    """Answers HTTP requests from the transcript, in its order."""

    def __init__(self, script: str | Path | Iterable[TranscriptLine]) -> None:
        self._records = read_exchanges(script)

    @property
    def is_over(self) -> bool:
        return not self._records

    def answer(self, question: bytes) -> bytes | None:
        """The recorded answer; None if there was none. Raises OffScript."""
        wanted = self._records.pop(0) if self._records else TranscriptLine(0.0, "", ">")
        if wanted.mark != ">" or wanted.data != question:
            raise OffScript(f"{question!r} was sent; the transcript has {wanted.data!r}.")
        if self._records and self._records[0].mark == "<":
            return self._records.pop(0).data
        return None

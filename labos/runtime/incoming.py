"""Reads messages from the bus with checks, because anybody may have written them.

A message can be read, or it is Unreadable, which counts like NoAnswer: no other error is raised here. Texts
and results are cut to the size that the log can hold before a command is made of them.
"""

from __future__ import annotations

import msgspec

from labos.clock import Clock
from labos.core.decide.outcomes import limit_result
from labos.core.ids import ModuleName
from labos.core.texts import LONGEST_NAME, cut
from labos.errors import Unreadable
from labos.node.limits import read
from labos.node.protocol import AboutReport, ActionReply, Outcome, ResultPublished, StateReport

LARGEST_NEWS = 1024 * 1024
"""The largest number of bytes of a publication: a result has at most 48 KB."""

LARGEST_ANSWER = 16 * 1024 * 1024
"""The largest number of bytes of an answer: a description may contain tables."""


_reply = msgspec.json.Decoder(ActionReply)
_result = msgspec.json.Decoder(ResultPublished)
_about = msgspec.json.Decoder(AboutReport)
_state = msgspec.json.Decoder(StateReport)


def read_reply(payload: bytes, whose: str) -> ActionReply:
    """A node's answer about an attempt. Raises Unreadable."""
    reply = read(payload, _reply, whose=whose, limit=LARGEST_ANSWER)
    outcome = make_writable(reply.outcome) if reply.outcome is not None else None
    return msgspec.structs.replace(reply, why=cut(reply.why), outcome=outcome)


def read_result(payload: bytes, whose: str) -> ResultPublished:
    """A published result. Raises Unreadable."""
    result = read(payload, _result, whose=whose, limit=LARGEST_NEWS)
    return msgspec.structs.replace(result, outcome=make_writable(result.outcome))


def read_state(payload: bytes, whose: str) -> StateReport:
    """A heartbeat, or the answer to ``state``. Raises Unreadable."""
    report = read(payload, _state, whose=whose, limit=LARGEST_NEWS)
    _check_names(whose, report.journal, report.instance)
    _check_numbers(whose, report.stopped_at)
    by = cut(report.stopped_by, LONGEST_NAME)
    return msgspec.structs.replace(report, error=cut(report.error), stopped_by=by)


def read_about(payload: bytes, whose: str) -> AboutReport:
    """A node's description of itself. Raises Unreadable."""
    report = read(payload, _about, whose=whose, limit=LARGEST_ANSWER)
    _check_names(whose, report.journal, report.instance, report.digest)
    _check_numbers(whose, report.epoch, report.acknowledged, report.acknowledged_by, report.now_ns)
    return report


def make_writable(outcome: Outcome) -> Outcome:
    """The outcome of an attempt, in a form that the log can hold."""
    error = cut(outcome.error)
    return msgspec.structs.replace(outcome, error=error, result=limit_result(outcome.result))


def find_module(key: str, form: str) -> ModuleName | None:
    """``workcell/module`` from a key of a form such as ``labos/lab/*/*/state``: the two parts at the first
    two stars of the form. None if the key has another form: messages can be sent to keys with wildcards."""
    parts, wanted = key.split("/"), form.split("/")
    if len(parts) != len(wanted) or len(key) > LONGEST_NAME * 3:
        return None
    for part, want in zip(parts, wanted, strict=True):
        if not _is_plain(part) if want == "*" else part != want:
            return None
    first = wanted.index("*")
    return ModuleName(f"{parts[first]}/{parts[first + 1]}")


def _is_plain(part: str) -> bool:
    return part.isprintable() and part[:1] != "@" and not set(part) & set("*$?#")


def _check_names(whose: str, *names: str) -> None:
    for name in names:
        if len(name) > LONGEST_NAME:
            raise Unreadable(f"{whose} has an id of {len(name)} characters; {LONGEST_NAME} are allowed.")


def _check_numbers(whose: str, *numbers: int) -> None:
    for number in numbers:
        if not 0 <= number < 2**63:
            raise Unreadable(f"{whose} sent a number that is out of range: {cut(str(number), 30)}.")


class RateLimiter:
    """Allows something ``burst`` times for each module of the lab, and after that once every ``every_s``: a
    flood of messages must not cause a flood of reactions."""

    def __init__(self, clock: Clock, every_s: float, burst: int = 1) -> None:
        self._clock, self._every_s, self._burst = clock, every_s, burst
        self._left: dict[str, tuple[float, float]] = {}

    def spend(self, module: str) -> bool:
        """Whether it is allowed once more now; counts it."""
        now = self._clock.monotonic()
        left, since = self._left.get(module, (float(self._burst), now))
        left = min(left + (now - since) / self._every_s, float(self._burst))
        may = left >= 1.0
        self._left[module] = (left - 1.0 if may else left, now)
        return may

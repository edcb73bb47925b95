"""What is heard on the bus is read with care: anybody may have written it.

Whatever it is, it is read, or it is Unreadable, which is as good as NoAnswer: nothing here raises anything
else. Texts and results are cut to what the log can hold before a command is made of them.
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
"""Bytes of a publication that is read: a result has 48 KB at the most."""

LARGEST_ANSWER = 16 * 1024 * 1024
"""Bytes of an answer that is read: a description may bear tables."""


_reply = msgspec.json.Decoder(ActionReply)
_result = msgspec.json.Decoder(ResultPublished)
_about = msgspec.json.Decoder(AboutReport)
_state = msgspec.json.Decoder(StateReport)


def read_reply(payload: bytes, whose: str) -> ActionReply:
    """A node's word about an attempt. Raises Unreadable."""
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
    """What a node says of itself. Raises Unreadable."""
    report = read(payload, _about, whose=whose, limit=LARGEST_ANSWER)
    _check_names(whose, report.journal, report.instance, report.digest)
    _check_numbers(whose, report.epoch, report.acknowledged, report.acknowledged_by, report.now_ns)
    return report


def make_writable(outcome: Outcome) -> Outcome:
    """How an attempt ended, in a form that the log can hold."""
    error = cut(outcome.error)
    return msgspec.structs.replace(outcome, error=error, result=limit_result(outcome.result))


def find_module(key: str, form: str) -> ModuleName | None:
    """``workcell/module`` of a key of the form ``labos/lab/*/*/state``, say: the two parts where the form has
    its first two stars. None if the key is of another form: messages can be sent to keys with wildcards."""
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
            raise Unreadable(f"{whose} bears an id of {len(name)} characters; {LONGEST_NAME} are read.")


def _check_numbers(whose: str, *numbers: int) -> None:
    for number in numbers:
        if not 0 <= number < 2**63:
            raise Unreadable(f"{whose} told a number that cannot be: {cut(str(number), 30)}.")


class RateLimiter:
    """Lets something happen ``burst`` times for each module of the lab, and again once every ``every_s``:
    what comes in a flood must not go on as one."""

    def __init__(self, clock: Clock, every_s: float, burst: int = 1) -> None:
        self._clock, self._every_s, self._burst = clock, every_s, burst
        self._left: dict[str, tuple[float, float]] = {}

    def spend(self, module: str) -> bool:
        """Whether it may happen once more now."""
        now = self._clock.monotonic()
        left, since = self._left.get(module, (float(self._burst), now))
        left = min(left + (now - since) / self._every_s, float(self._burst))
        may = left >= 1.0
        self._left[module] = (left - 1.0 if may else left, now)
        return may

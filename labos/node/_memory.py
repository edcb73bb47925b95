"""The memory of a node: the fold of its journal's records.

Only ``apply`` changes it, both for new records and for records that are read from a file. So a journal that
is opened again has the same memory as before.
"""

from __future__ import annotations

from typing import Literal

import msgspec

from labos.core.effects import AnyEffect
from labos.errors import JournalDamaged
from labos.node._records import (
    FORMAT,
    REMEDY,
    Accepted,
    Bound,
    Corrected,
    Ended,
    EpochRaised,
    GivenUp,
    Handled,
    Opened,
    Pruned,
    Record,
    Restarted,
    Rewound,
    TakenUp,
    Voided,
    Withdrawn,
)
from labos.node.protocol import Outcome, Unacknowledged

_Status = Literal["running", "finished", "interrupted"]


class Attempt(msgspec.Struct):
    """An attempt that was accepted. ``why`` describes an interruption, if there was one."""

    action: str
    attempt: int
    position: int
    name: str
    status: _Status = "running"
    outcome: Outcome | None = None
    handle: str = ""
    why: str = ""
    effects: tuple[AnyEffect, ...] | None = None


class Known(msgspec.Struct):
    """The remembered data of one action. No attempt up to ``void`` may start."""

    attempts: dict[int, Attempt] = {}
    void: int = 0
    void_position: int = 0


class Memory(msgspec.Struct):
    """``lab`` is the lab to which the node belongs; empty before the first message of a lab. ``epoch`` is
    that of the newest kernel that the node obeys. ``pruned`` is the position that a kernel of the epoch
    ``pruned_by`` acknowledged (0: not noted). ``seen`` is the greatest position of a request, including
    forgotten requests. ``corrections`` are the corrections by people."""

    id: str = ""
    lab: str = ""
    epoch: int = 0
    pruned: int = 0
    pruned_by: int = 0
    seen: int = 0
    actions: dict[str, Known] = {}
    corrections: list[Corrected] = []

    def list_attempts(self) -> list[Attempt]:
        """All remembered attempts, in the order in which they were accepted."""
        return [attempt for known in self.actions.values() for attempt in known.attempts.values()]

    def list_spent(self, position: int) -> list[Attempt]:
        """The attempts that the node may forget after an acknowledgement of ``position``."""
        return [attempt for attempt in self.list_attempts() if _is_spent(attempt, position)]

    def is_spent(self, position: int) -> bool:
        """Whether the node may forget something after an acknowledgement of ``position``."""
        return any(self._keep_remainder(known, position) is not known for known in self.actions.values())

    def find(self, action: str, attempt: int) -> Attempt | None:
        """This attempt, if it was accepted and not forgotten."""
        entry = self.actions.get(action)
        return entry.attempts.get(attempt) if entry else None

    def find_earlier(self, action: str, attempt: int) -> Attempt | None:
        """The latest accepted attempt below ``attempt``."""
        entry = self.actions.get(action)
        numbers = [n for n in entry.attempts if n < attempt] if entry else []
        return entry.attempts[max(numbers)] if entry and numbers else None

    def find_last_attempt(self, action: str) -> int:
        """The greatest remembered number of an attempt, accepted or void; 0 if there is none."""
        entry = self.actions.get(action)
        return max(entry.void, *entry.attempts, 0) if entry else 0

    def is_void(self, action: str, attempt: int) -> bool:
        """Whether this attempt never ran and can never run."""
        entry = self.actions.get(action)
        if entry is None or attempt in entry.attempts:
            return False
        return attempt <= entry.void or any(n > attempt for n in entry.attempts)

    def is_forgotten(self, position: int) -> bool:
        """Whether requests with this position are so old that they are refused unread."""
        return position <= self.pruned

    def list_unacknowledged(self) -> list[Unacknowledged]:
        """``list_attempts`` in the form for reports."""
        return [
            Unacknowledged(a.action, a.attempt, a.name, a.status, a.handle, a.position, a.effects)
            for a in self.list_attempts()
        ]

    # -- the fold ----------------------------------------------------------------------------

    def apply(self, record: Record) -> None:
        """Raises KeyError for a record about an unknown attempt, JournalDamaged."""
        match record:
            case Opened():
                if record.format != FORMAT:
                    raise JournalDamaged(
                        f"The node's journal has format {record.format}; this LabOS reads {FORMAT}.",
                        remedy="Install the LabOS that wrote it.",
                    )
                self.id = record.id
            case Bound():
                self.lab = record.lab
            case EpochRaised():
                self.epoch = record.epoch
            case Restarted():
                for attempt in self.list_attempts():
                    if attempt.status == "running":
                        attempt.status = "interrupted"
            case Pruned():
                if record.position > self.pruned:
                    self.pruned, self.pruned_by = record.position, record.epoch
                self.seen = max(self.seen, record.seen)
                self._forget(record.position)
            case Rewound():
                self.pruned, self.pruned_by = record.position, record.epoch
                self.seen = max(self.seen, record.seen)
            case Corrected():
                if record.position < self.pruned:
                    self.pruned, self.pruned_by = record.position, record.epoch
                self.epoch = record.epoch
                self.corrections.append(record)
            case _:
                self._apply_to_an_action(record)

    def _apply_to_an_action(self, record: Record) -> None:
        match record:
            case Accepted(action, number, position, name, interrupted, effects):
                known = self.actions.setdefault(action, Known())
                status: _Status = "interrupted" if interrupted else "running"
                known.attempts[number] = Attempt(action, number, position, name, status, effects=effects)
                self.seen = max(self.seen, position)
            case Handled(action, number, handle):
                self.actions[action].attempts[number].handle = handle
            case Ended(action, number, outcome):
                ended = self.actions[action].attempts[number]
                ended.status, ended.outcome, ended.why = "finished", outcome, ""
            case TakenUp(action, number):
                taken_up = self.actions[action].attempts[number]
                taken_up.status, taken_up.why = "running", ""
            case GivenUp(action, number, why):
                given_up = self.actions[action].attempts[number]
                given_up.status, given_up.why = "interrupted", why
            case Voided():
                self._note_void(record.action, record.attempt, record.position)
            case Withdrawn():
                withdrawn = self.actions[record.action].attempts.pop(record.attempt)
                self._note_void(record.action, record.attempt, withdrawn.position)
            case _:
                raise TypeError(f"{type(record).__name__} is not a record of a journal")

    def _note_void(self, action: str, number: int, position: int) -> None:
        known = self.actions.setdefault(action, Known())
        known.void = max(known.void, number)
        known.void_position = max(known.void_position, position)
        self.seen = max(self.seen, position)

    def _forget(self, position: int) -> None:
        for action, known in list(self.actions.items()):
            left = self._keep_remainder(known, position)
            if left is None:
                del self.actions[action]
            else:
                self.actions[action] = left

    @staticmethod
    def _keep_remainder(known: Known, position: int) -> Known | None:
        """The part of an action that must still be remembered; the same object if that is all of it."""
        attempts = {n: a for n, a in known.attempts.items() if not _is_spent(a, position)}
        if not attempts and known.void_position <= position:
            return None
        if len(attempts) == len(known.attempts):
            return known
        return Known(attempts, known.void, known.void_position)

    # -- reading -----------------------------------------------------------------------------

    def replay(self, records: list[Record]) -> None:
        """Apply the records of a file. Raises JournalDamaged."""
        if records and not isinstance(records[0], Opened):
            raise JournalDamaged("The node's journal has lost its beginning.", remedy=REMEDY)
        forgotten: dict[tuple[str, int], Attempt] = {}
        for record in records:
            match record:
                case Pruned():
                    forgotten |= {(a.action, a.attempt): a for a in self.list_spent(record.position)}
                case Handled() | Ended():
                    self._restore_forgotten(record.action, record.attempt, forgotten)
                case _:
                    pass
            try:
                self.apply(record)
            except KeyError as error:
                raise JournalDamaged(
                    f"The node's journal has the end of an action without its start ({error}).",
                    remedy=REMEDY,
                ) from error

    def _restore_forgotten(self, action: str, number: int, forgotten: dict[tuple[str, int], Attempt]) -> None:
        """Restore an action that was resumed after a restart. In journals from before there was a record for
        this, such an action looks as if it had been forgotten while it ran, but it was still running."""
        known = self.actions.get(action)
        if (known is None or number not in known.attempts) and (action, number) in forgotten:
            attempt = forgotten.pop((action, number))
            attempt.status, attempt.why = "running", ""
            self.actions.setdefault(action, Known()).attempts[number] = attempt

    # -- writing anew ------------------------------------------------------------------------

    def list_records(self) -> list[Record]:
        """The shortest list of records that gives the same memory."""
        records: list[Record] = [Opened(self.id, FORMAT), *self.corrections]
        if self.lab:
            records.append(Bound(self.lab))
        if self.epoch:
            records.append(EpochRaised(self.epoch))
        if self.pruned or self.pruned_by or self.seen:
            up_to = Pruned if self.pruned else Rewound
            records.append(up_to(self.pruned, self.pruned_by, self.seen))
        for action, known in self.actions.items():
            if known.void:
                records.append(Voided(action, known.void, known.void_position))
            for a in known.attempts.values():
                given_up = bool(a.why)
                interrupted = a.status == "interrupted" and not given_up
                records.append(Accepted(action, a.attempt, a.position, a.name, interrupted, a.effects))
                if a.handle:
                    records.append(Handled(action, a.attempt, a.handle))
                if a.outcome is not None:
                    records.append(Ended(action, a.attempt, a.outcome))
                elif given_up:
                    records.append(GivenUp(action, a.attempt, a.why))
        return records


def _is_spent(attempt: Attempt, position: int) -> bool:
    return attempt.position <= position and attempt.status != "running"

"""Every error LabOS raises, in one tree. Each docstring is the message's first sentence.

LabosError
├── BadInput                 what a person or program handed in cannot be used
│   ├── SpecError            a file: names file, line, column, field and remedy
│   ├── Refused              a command that the rules forbid here and now
│   │   ├── KeyReused        an idempotency key that belongs to another request
│   │   ├── AlreadyDone      a request that was carried out, whose answer is not known any more
│   │   └── Forbidden        the user may not do this
│   └── NotFound             a name that nobody in this lab bears
├── NotSignedIn              nobody knows who asks
├── TooManyTries             somebody has tried to sign in too often
├── StoreError               the event store
│   ├── StoreUnavailable     cannot be reached or written
│   ├── LogTooNew            written by a newer LabOS
│   ├── LogDamaged           a record, its hash or its position is wrong
│   └── Fenced               another kernel has taken over
├── KernelAway               the kernel gave no answer (says nothing about whether it was done)
├── BusError                 the message bus
│   ├── NoAnswer             nobody answered (says nothing about whether it was done)
│   │   └── Unreadable       what was said cannot be read: as good as no answer
│   └── NameTaken            another node already answers to this name
├── NodeError                a node or its device
│   ├── ActionInvalid        unknown action or bad arguments: nothing moved
│   ├── DeviceError          the device reported a failure
│   │   └── LinkError        the wire to a device: no answer that can be believed
│   │       ├── NotConnected nobody is there; nothing was sent
│   │       ├── WrongDevice  another device than the one expected answers; nothing was asked of it
│   │       ├── LinkLost     unplugged in mid-exchange
│   │       ├── NoReply      nothing came before the deadline
│   │       ├── HalfReply    a reply began and did not end before the deadline
│   │       ├── Garbled      what came is no message: noise, wrong checksum, wrong form
│   │       └── StrayReply   what came answers another question
│   └── OutcomeUnknown       nobody can say whether the device did it
├── JournalDamaged           a node's journal cannot be trusted
├── Undelivered              a message to a person was not taken
├── InternalFault            LabOS itself failed on a command; nothing of it was done
└── InvariantBroken          a batch of events that must never be written
"""

from __future__ import annotations


class LabosError(Exception):
    """Something in LabOS went wrong."""

    def __init__(self, message: str, *, remedy: str = "") -> None:
        super().__init__(message)
        self.message = message
        self.remedy = remedy

    def __str__(self) -> str:
        return f"{self.message} {self.remedy}".rstrip()


class BadInput(LabosError):
    """What was handed in cannot be used."""


class SystemFailed(LabosError):
    """The computer refused something: a file, a folder, a socket."""


class SpecError(BadInput):
    """A file cannot be used as it is."""

    def __init__(
        self,
        message: str,
        *,
        file: str = "",
        line: int = 0,
        column: int = 0,
        field: str = "",
        remedy: str = "",
    ) -> None:
        super().__init__(message, remedy=remedy)
        self.file, self.line, self.column, self.field = file, line, column, field

    def __str__(self) -> str:
        place = ":".join(str(part) for part in (self.file, self.line, self.column) if part)
        field = f"{self.field}: " if self.field else ""
        return f"{place}: {field}{super().__str__()}" if place else f"{field}{super().__str__()}"


class Refused(BadInput):
    """The rules forbid this command here and now."""


class KeyReused(Refused):
    """The idempotency key belongs to another request."""


class AlreadyDone(Refused):
    """The request with this idempotency key was carried out; what it was answered is not known any more."""


class Forbidden(Refused):
    """The user may not do this; the remedy says who may."""


class NotFound(BadInput):
    """Nobody in this lab bears that name."""


class NotSignedIn(LabosError):
    """Nobody knows who asks: nothing was shown, or what was shown is not valid."""


class TooManyTries(LabosError):
    """Somebody has tried to sign in too often; ``wait_s`` is how long to wait."""

    def __init__(self, message: str, *, wait_s: float = 60.0, remedy: str = "") -> None:
        super().__init__(message, remedy=remedy or f"Wait {wait_s:.0f} s, then try again.")
        self.wait_s = wait_s


class StoreError(LabosError):
    """The event store failed."""


class StoreUnavailable(StoreError):
    """The event store cannot be reached or written."""


class CommitInDoubt(StoreUnavailable):
    """What was to be written may be on disk, or not: asking for it once more may do it twice."""


class KernelAway(LabosError):
    """The kernel, in another process, gave no answer; whether it was done is not known."""


class LogTooNew(StoreError):
    """The log was written by a newer LabOS."""


class LogDamaged(StoreError):
    """A record of the log is wrong."""

    def __init__(self, message: str, *, position: int, remedy: str = "") -> None:
        super().__init__(message, remedy=remedy)
        self.position = position


class Fenced(StoreError):
    """Another kernel has taken over this lab."""


class BusError(LabosError):
    """The message bus failed."""


class NoAnswer(BusError):
    """Nobody answered; whether it was done is not known."""


class Unreadable(NoAnswer):
    """What was said cannot be read."""


class NameTaken(BusError):
    """Another node already answers to this name."""


class NodeError(LabosError):
    """A node or its device failed."""


class ActionInvalid(NodeError):
    """The action or its arguments are not valid; nothing moved."""


class DeviceError(NodeError):
    """The device reported a failure.

    ``effects`` says what is known of the motion: ``none``, ``all``, ``partial`` or ``unknown``.
    """

    def __init__(self, message: str, *, effects: str = "unknown", remedy: str = "") -> None:
        super().__init__(message, remedy=remedy)
        self.effects = effects


class Collision(DeviceError):
    """The device has hit, dropped or jammed something: an operational error. The motion was asked for as it
    should be, and the bench was not as it should be."""


class LinkError(DeviceError):
    """The wire to a device gave no answer that can be believed.

    What the device did is unknown, unless nothing was sent.
    """


class NotConnected(LinkError):
    """Nobody is there; nothing was sent."""

    def __init__(self, message: str, *, effects: str = "none", remedy: str = "") -> None:
        super().__init__(message, effects=effects, remedy=remedy)


class WrongDevice(NotConnected):
    """Another device than the one expected answers; nothing was asked of it."""


class LinkLost(LinkError):
    """The wire was unplugged in mid-exchange."""


class NoReply(LinkError):
    """Nothing came before the deadline."""


class HalfReply(LinkError):
    """A reply began and did not end before the deadline."""


class Garbled(LinkError):
    """What came is no message: noise, a wrong checksum, a wrong form."""


class StrayReply(LinkError):
    """What came answers another question."""


class OutcomeUnknown(NodeError):
    """Nobody can say whether the device carried the action out: neither done nor failed."""


class JournalDamaged(LabosError):
    """A node's journal cannot be trusted."""


class Undelivered(LabosError):
    """A message to a person was not taken.

    ``unreachable``: by nobody's fault but the server's, which would take no other message either.
    """

    def __init__(self, message: str, *, unreachable: bool = False, remedy: str = "") -> None:
        super().__init__(message, remedy=remedy)
        self.unreachable = unreachable


class InternalFault(LabosError):
    """LabOS itself failed on a command; nothing of it was done, and the lab goes on."""


class InvariantBroken(LabosError):
    """A batch of events would break what must always hold; nothing of it was written."""

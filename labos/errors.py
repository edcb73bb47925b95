"""Every error LabOS raises, in one tree. Each docstring is the message's first sentence.

LabosError
├── BadInput                 the input of a person or program cannot be used
│   ├── SpecError            a file: names file, line, column, field and remedy
│   ├── Refused              a command that the rules forbid here and now
│   │   ├── KeyReused        an idempotency key that belongs to another request
│   │   ├── AlreadyDone      a request that was carried out, but whose answer is not known any more
│   │   └── Forbidden        the user may not do this
│   └── NotFound             nothing in this lab has that name
├── NotSignedIn              the user is not known
├── TooManyTries             too many attempts to sign in
├── StoreError               the event store
│   ├── StoreUnavailable     cannot be reached or written
│   ├── LogTooNew            written by a newer LabOS
│   ├── LogDamaged           a record, its hash or its position is wrong
│   └── Fenced               another kernel has taken over
├── KernelAway               the kernel gave no answer; the request may have been carried out
├── BusError                 the message bus
│   ├── NoAnswer             no process answered; the request may have been carried out
│   │   └── Unreadable       a message cannot be read: counts like no answer
│   └── NameTaken            another node already answers to this name
├── NodeError                a node or its device
│   ├── ActionInvalid        unknown action or bad arguments: nothing moved
│   ├── DeviceError          the device reported a failure
│   │   └── LinkError        no valid answer on the wire to a device
│   │       ├── NotConnected there is no device; nothing was sent
│   │       ├── WrongDevice  a different device answers than the expected one; nothing was requested from it
│   │       ├── LinkLost     unplugged during an exchange
│   │       ├── NoReply      nothing came before the deadline
│   │       ├── HalfReply    a reply began and did not end before the deadline
│   │       ├── Garbled      the received bytes are not a message: noise, wrong checksum, wrong form
│   │       └── StrayReply   the received message answers another question
│   └── OutcomeUnknown       it is not known whether the device carried out the action
├── JournalDamaged           a node's journal cannot be trusted
├── Undelivered              a message to a person was not accepted
├── InternalFault            LabOS itself failed on a command; no part of it was carried out
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
    """The input cannot be used."""


class SystemFailed(LabosError):
    """The computer refused an operation: on a file, a folder, a socket."""


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
    """The request with this idempotency key was carried out; its answer is not known any more."""


class Forbidden(Refused):
    """The user may not do this; the remedy names the users who may."""


class NotFound(BadInput):
    """Nothing in this lab has that name."""


class NotSignedIn(LabosError):
    """The user is not known: the request has no credentials, or they are not valid."""


class TooManyTries(LabosError):
    """There were too many attempts to sign in; ``wait_s`` is how long to wait."""

    def __init__(self, message: str, *, wait_s: float = 60.0, remedy: str = "") -> None:
        super().__init__(message, remedy=remedy or f"Wait {wait_s:.0f} s, then try again.")
        self.wait_s = wait_s


class StoreError(LabosError):
    """The event store failed."""


class StoreUnavailable(StoreError):
    """The event store cannot be reached or written."""


class CommitInDoubt(StoreUnavailable):
    """The data may be on disk, or not: a repeated request may be carried out twice."""


class KernelAway(LabosError):
    """The kernel, in another process, gave no answer; it is not known whether the request was carried out."""


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
    """No process answered; it is not known whether the request was carried out."""


class Unreadable(NoAnswer):
    """A message cannot be read."""


class NameTaken(BusError):
    """Another node already answers to this name."""


class NodeError(LabosError):
    """A node or its device failed."""


class ActionInvalid(NodeError):
    """The action or its arguments are not valid; nothing moved."""


class DeviceError(NodeError):
    """The device reported a failure.

    ``effects`` says how much of the motion was carried out: ``none``, ``all``, ``partial`` or ``unknown``.
    """

    def __init__(self, message: str, *, effects: str = "unknown", remedy: str = "") -> None:
        super().__init__(message, remedy=remedy)
        self.effects = effects


class Collision(DeviceError):
    """The device has hit, dropped or jammed something: an operational error. The requested motion was
    correct, but the bench was not as expected."""


class LinkError(DeviceError):
    """There is no valid answer on the wire to a device.

    It is unknown what the device has done, unless nothing was sent.
    """


class NotConnected(LinkError):
    """There is no device; nothing was sent."""

    def __init__(self, message: str, *, effects: str = "none", remedy: str = "") -> None:
        super().__init__(message, effects=effects, remedy=remedy)


class WrongDevice(NotConnected):
    """A different device answers than the expected one; nothing was requested from it."""


class LinkLost(LinkError):
    """The wire was unplugged during an exchange."""


class NoReply(LinkError):
    """Nothing came before the deadline."""


class HalfReply(LinkError):
    """A reply began and did not end before the deadline."""


class Garbled(LinkError):
    """The received bytes are not a message: noise, a wrong checksum, a wrong form."""


class StrayReply(LinkError):
    """The received message answers another question."""


class OutcomeUnknown(NodeError):
    """It is not known whether the device carried out the action: it counts neither as done nor as failed."""


class JournalDamaged(LabosError):
    """A node's journal cannot be trusted."""


class Undelivered(LabosError):
    """A message to a person was not accepted.

    ``unreachable``: the cause is the server, which would accept no other message either.
    """

    def __init__(self, message: str, *, unreachable: bool = False, remedy: str = "") -> None:
        super().__init__(message, remedy=remedy)
        self.unreachable = unreachable


class InternalFault(LabosError):
    """LabOS itself failed on a command; no part of it was carried out, and the lab continues."""


class InvariantBroken(LabosError):
    """A batch of events would break an invariant; no event of it was written."""

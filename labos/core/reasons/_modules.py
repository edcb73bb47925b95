"""Reasons that concern modules."""

from __future__ import annotations

from labos.core.ids import ModuleName, local, workcell_of
from labos.core.reasons._base import NeedsPerson, Reason


class NoModule(NeedsPerson, frozen=True):
    SENTENCE = "there is no module {module}"
    REMEDY = "Set up a workcell that has it: labos up WORKCELL"
    WAKES = ("module",)
    module: str


class Access(NeedsPerson, frozen=True):
    SENTENCE = "{by} reaches into the workcell {workcell}"
    REMEDY = "It continues when everybody has ended the access: labos access {workcell} --done"
    WAKES = ("access",)
    workcell: str
    by: str


class OutOfService(NeedsPerson, frozen=True):
    SENTENCE = "{module} is out of service ({why})"
    REMEDY = "Check it, then answer the open question (labos resolve) or: labos in-service {module}"
    WAKES = ("module",)
    module: str
    why: str


class ModuleDown(NeedsPerson, frozen=True):
    SENTENCE = "{module} is {status} ({error})"
    WAKES = ("module",)
    module: str
    status: str
    error: str = ""

    @property
    def remedy(self) -> str:
        name, workcell = local(self.module), workcell_of(ModuleName(self.module))
        if self.status == "GONE":
            return f"Start its node again: labos node start --name {name} --workcell {workcell}"
        return f"Check it, then: labos reset {name}"


class Unwatched(NeedsPerson, frozen=True):
    SENTENCE = "{observer}, which observes {place} after every motion, is {how}"
    REMEDY = "Bring {observer} back, or write `verify: on_doubt` for {place} in the workcell file."
    WAKES = ("module",)
    place: str
    observer: str
    how: str


class ModuleBusy(Reason, frozen=True):
    SENTENCE = "{module} is busy"
    WAKES = ("module",)
    module: str


class Unsettled(NeedsPerson, frozen=True):
    SENTENCE = "it is not known how the last action of {module} ended"
    REMEDY = "Look there and answer the open question: labos resolve {question}"
    WAKES = ("module",)
    module: str
    question: str


class Held(Reason, frozen=True):
    SENTENCE = "{module} is held by {holder}"
    WAKES = ("module",)
    module: str
    holder: str


class Setpoint(Reason, frozen=True):
    SENTENCE = "{setpoint} of {module} is set to {value} for {holder}"
    WAKES = ("module",)
    module: str
    setpoint: str
    value: str
    holder: str


class ZoneBusy(Reason, frozen=True):
    SENTENCE = "{module} is working in the zone {zone}"
    WAKES = ("zone", "module")
    module: str
    zone: str


class ZoneBarred(NeedsPerson, frozen=True):
    SENTENCE = "{module} has stopped in the zone {zone}"
    REMEDY = "Check it, then: labos reset {module}"
    WAKES = ("zone", "module")
    module: str
    zone: str


class Booked(Reason, frozen=True):
    SENTENCE = "{module} is booked for {whom} until {until} ({booking})"
    REMEDY = "It continues by itself then. To cancel the booking: labos book cancel {booking}"
    WAKES = ("booking", "module")
    module: str
    whom: str
    until: str
    booking: str


class BookedSoon(Reason, frozen=True):
    SENTENCE = (
        "{module} is booked for {whom} from {begins} until {until} ({booking}), and {step!r} would "
        "not end before that"
    )
    REMEDY = "It continues by itself after that. To cancel the booking: labos book cancel {booking}"
    WAKES = ("booking", "module")
    module: str
    whom: str
    begins: str
    until: str
    booking: str
    step: str


class NoGap(NeedsPerson, frozen=True):
    SENTENCE = "the bookings of {module} ({bookings}) leave no free time of {length} in the next {days} days"
    REMEDY = "Change or cancel one of them: labos bookings {module}"
    WAKES = ("booking", "module")
    module: str
    length: str
    days: str
    bookings: str


class InsideToo(Reason, frozen=True):
    SENTENCE = "{labware} of {owner} is also at {place}, and {action!r} acts on everything in it"
    REMEDY = (
        "It continues when that has left, or is ready for the same action. If no run moves it away, "
        "remove it and report that: labos unload {place}"
    )
    WAKES = ("station", "module", "run")
    labware: str
    place: str
    owner: str
    action: str


class HandFull(Reason, frozen=True):
    SENTENCE = "the hand of {module} holds {what}"
    REMEDY = "It continues when a run puts that down."
    WAKES = ("station", "module")
    module: str
    what: str


ModuleReason = (
    NoModule
    | Access
    | OutOfService
    | ModuleDown
    | Unwatched
    | ModuleBusy
    | Unsettled
    | Held
    | Setpoint
    | ZoneBusy
    | ZoneBarred
    | Booked
    | BookedSoon
    | NoGap
    | InsideToo
    | HandFull
)

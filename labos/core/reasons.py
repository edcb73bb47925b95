"""Reasons why a step does not start: a type for each, with its fields, its sentence and its remedy.

``WAKES`` are the kinds of keys whose change may end the wait (``labos.core.waits``); ``URGENCY`` says who
ends it. A reason's ``code`` is its name in tables, metrics and answers.
"""

from __future__ import annotations

import re
from enum import StrEnum
from typing import Any, ClassVar, Literal

import msgspec

from labos.core.ids import local


class Urgency(StrEnum):
    """Who ends a wait."""

    PASSES = "it passes by itself"
    PERSON = "somebody has to do something"


PASSES, PERSON = Urgency.PASSES, Urgency.PERSON

Key = Literal["run", "module", "station", "zone", "access", "quota", "cell", "near", "window"]
"""The kinds of keys whose change may end a wait."""


def code_of(name: str) -> str:
    """The code of a reason's type: ``ModuleBusy`` is ``module_busy``."""
    return re.sub(r"(?<!^)(?=[A-Z])", "_", name).lower()


class Reason(msgspec.Struct, frozen=True, tag_field="code", tag=code_of):
    """Why a step does not start. In ``SENTENCE`` and ``REMEDY`` stand names of fields."""

    SENTENCE: ClassVar[str]
    REMEDY: ClassVar[str] = ""
    WAKES: ClassVar[tuple[Key, ...]] = ()
    URGENCY: ClassVar[Urgency] = PASSES

    @property
    def code(self) -> str:
        return str(self.__struct_config__.tag)

    @property
    def names(self) -> tuple[str, ...]:
        """What it names, in order."""
        found: list[str] = []
        for value in msgspec.structs.astuple(self):
            found += value if isinstance(value, tuple) else [value]
        return tuple(found)

    @property
    def sentence(self) -> str:
        """What the step waits for, in words a scientist uses."""
        return self.SENTENCE.format(**self._in_words()).replace(" ()", "")

    @property
    def remedy(self) -> str:
        """What a person can do about it; empty if there is nothing to do but wait."""
        return self.REMEDY.format(**self._in_words())

    def _in_words(self) -> dict[str, Any]:
        values = msgspec.structs.asdict(self)
        return {name: in_words(v) if isinstance(v, str) else v for name, v in values.items()}


def in_words(name: str) -> str:
    """A module, station or labware without its workcell; an owner in words."""
    kind, colon, which = name.partition(":")
    return f"{kind} {which}" if colon and kind in ("run", "experiment", "user") else local(name)


# -- the run ---------------------------------------------------------------------------------------


class Paused(Reason, frozen=True):
    SENTENCE = "run {run} is paused"
    REMEDY = "Let it go on: labos resume {run}"
    WAKES = ("run",)
    URGENCY = PERSON
    run: str


class Unapproved(Reason, frozen=True):
    SENTENCE = "it does what is dangerous, and nobody but {user} has looked at it yet"
    REMEDY = "Ask another operator to look at it and to answer: labos resolve"
    WAKES = ("run",)
    URGENCY = PERSON
    user: str


class Halted(Reason, frozen=True):
    SENTENCE = "{by} has paused {target}"
    REMEDY = "Let it go on: labos resume {target}"
    URGENCY = PERSON
    target: str
    by: str


class LogShorter(Reason, frozen=True):
    SENTENCE = (
        "this log ends at {ended} and {evidence} knows more: nothing starts before the bench was compared"
    )
    REMEDY = "Go round the bench and say what stands where: labos bench round"
    URGENCY = PERSON
    evidence: str
    ended: str


class Cancelling(Reason, frozen=True):
    SENTENCE = "run {run} is being cancelled"
    WAKES = ("run",)
    run: str


class Gone(Reason, frozen=True):
    SENTENCE = "the run has ended"


class NotPending(Reason, frozen=True):
    SENTENCE = "step {step!r} is already under way"
    WAKES = ("run",)
    step: str


class After(Reason, frozen=True):
    SENTENCE = "an earlier step has not ended"
    WAKES = ("run",)
    step: str = ""


class RetryLater(Reason, frozen=True):
    SENTENCE = "step {step!r} failed and is tried again in a while"
    step: str


class Asked(Reason, frozen=True):
    SENTENCE = "step {step!r} failed, and a person has to say what follows"
    REMEDY = "Answer what is asked: labos resolve {question}"
    URGENCY = PERSON
    step: str
    question: str


class TooEarly(Reason, frozen=True):
    SENTENCE = "step {step!r} has to wait a set time"
    step: str


class Outcome(Reason, frozen=True):
    SENTENCE = "it is not known how step {step!r} ended"
    REMEDY = "Look there and answer what is asked: labos resolve"
    WAKES = ("run",)
    URGENCY = PERSON
    step: str


class Quota(Reason, frozen=True):
    SENTENCE = "the quota of {whose} is {limit}"
    WAKES = ("quota",)
    URGENCY = PERSON
    whose: str
    limit: str


# -- modules ---------------------------------------------------------------------------------------


class NoModule(Reason, frozen=True):
    SENTENCE = "there is no module {module}"
    REMEDY = "Set up a workcell that has it: labos up WORKCELL"
    WAKES = ("module",)
    URGENCY = PERSON
    module: str


class Access(Reason, frozen=True):
    SENTENCE = "{by} reaches into the workcell {workcell}"
    REMEDY = "It goes on when everybody is out: labos access {workcell} --done"
    WAKES = ("access",)
    URGENCY = PERSON
    workcell: str
    by: str


class OutOfService(Reason, frozen=True):
    SENTENCE = "{module} is out of service ({why})"
    REMEDY = "Look at it, then answer what is asked (labos resolve) or: labos in-service {module}"
    WAKES = ("module",)
    URGENCY = PERSON
    module: str
    why: str


class ModuleDown(Reason, frozen=True):
    SENTENCE = "{module} is {status} ({error})"
    WAKES = ("module",)
    URGENCY = PERSON
    module: str
    status: str
    error: str = ""

    @property
    def remedy(self) -> str:
        name, workcell = local(self.module), self.module.partition("/")[0]
        if self.status == "GONE":
            return f"Start its node again: labos node start --name {name} --workcell {workcell}"
        return f"Look at it, then: labos reset {name}"


class Unwatched(Reason, frozen=True):
    SENTENCE = "{observer}, which looks at {place} after every motion, is {how}"
    REMEDY = "Bring {observer} back, or write `verify: on_doubt` for {place} in the workcell file."
    WAKES = ("module",)
    URGENCY = PERSON
    place: str
    observer: str
    how: str


class ModuleBusy(Reason, frozen=True):
    SENTENCE = "{module} is busy"
    WAKES = ("module",)
    module: str


class Unsettled(Reason, frozen=True):
    SENTENCE = "nobody knows how {module} ended what it did last"
    REMEDY = "Look there and answer what is asked: labos resolve {question}"
    WAKES = ("module",)
    URGENCY = PERSON
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
    SENTENCE = "{module} is at work in the zone {zone}"
    WAKES = ("zone", "module")
    module: str
    zone: str


class ZoneBarred(Reason, frozen=True):
    SENTENCE = "{module} stands still in the zone {zone}"
    REMEDY = "Look at it, then: labos reset {module}"
    WAKES = ("zone", "module")
    URGENCY = PERSON
    module: str
    zone: str


class HandFull(Reason, frozen=True):
    SENTENCE = "the hand of {module} holds {what}"
    REMEDY = "It goes on when a run puts that down."
    WAKES = ("station", "module")
    module: str
    what: str


# -- stations, labware and supplies ----------------------------------------------------------------


class ReachedInto(Reason, frozen=True):
    SENTENCE = "an arm is reaching into {place}"
    WAKES = ("station", "module")
    place: str


class Requires(Reason, frozen=True):
    SENTENCE = "{what} needs {variable} = {value}"
    WAKES = ("module", "station")
    what: str
    variable: str
    value: str


class Unfit(Reason, frozen=True):
    SENTENCE = "{labware} is not as the step needs it: {variable} = {value}"
    REMEDY = "Let a run of its owner change that, or take it away and say so: labos unload"
    WAKES = ("station",)
    URGENCY = PERSON
    labware: str
    variable: str
    value: str


class UsedUp(Reason, frozen=True):
    SENTENCE = "{module} has too little {resource} left"
    REMEDY = "Refill it and say so: labos replenish {module} {resource} --lot LOT"
    WAKES = ("module",)
    URGENCY = PERSON
    module: str
    resource: str


class Expired(Reason, frozen=True):
    SENTENCE = "{resource} of {module} is past its date (lot {lot} was good until {until})"
    REMEDY = "Take the old pack out and say so: labos replenish {module} {resource} --lot LOT --instead"
    WAKES = ("module",)
    URGENCY = PERSON
    module: str
    resource: str
    lot: str
    until: str


class StackEmpty(Reason, frozen=True):
    SENTENCE = "the stack {place} is empty"
    REMEDY = "Fill it and say so: labos load {place} --type TYPE --count N --lot LOT"
    WAKES = ("station",)
    URGENCY = PERSON
    place: str


class Buried(Reason, frozen=True):
    SENTENCE = "{labware} stands on top of the stack {place}"
    REMEDY = "It goes on when a run moves that away."
    WAKES = ("station",)
    place: str
    labware: str


class Uncertain(Reason, frozen=True):
    SENTENCE = "it is not known what stands at {place}"
    REMEDY = "Look there and answer what is asked: labos resolve"
    WAKES = ("station",)
    URGENCY = PERSON
    place: str


class Lost(Reason, frozen=True):
    SENTENCE = "it is not known where {labware} is"
    REMEDY = "Look for it and answer what is asked: labos resolve"
    WAKES = ("station",)
    URGENCY = PERSON
    labware: str


class InMotion(Reason, frozen=True):
    SENTENCE = "{labware} is in motion at {place}"
    WAKES = ("station", "module")
    labware: str
    place: str


class InUse(Reason, frozen=True):
    SENTENCE = "{owner} works on {labware} at {place} until it ends"
    WAKES = ("station",)
    labware: str
    place: str
    owner: str


class NotYours(Reason, frozen=True):
    SENTENCE = "{labware} at {place} belongs to {owner}"
    REMEDY = "Let a run of its owner move it away."
    WAKES = ("station",)
    URGENCY = PERSON
    labware: str
    place: str
    owner: str


class Undeclared(Reason, frozen=True):
    SENTENCE = "nobody has said what stands at {place}"
    REMEDY = "Say what stands there: labos bench declare {place}=TYPE, or {place}= if nothing does"
    WAKES = ("station",)
    URGENCY = PERSON
    place: str


class NothingThere(Reason, frozen=True):
    SENTENCE = "nothing stands at {place}"
    REMEDY = "Put some there and say so: labos place {place} TYPE"
    WAKES = ("station",)
    URGENCY = PERSON
    place: str


class StillToCome(Reason, frozen=True):
    SENTENCE = "nothing stands at {place} yet"
    WAKES = ("station",)
    place: str


class NoAccess(Reason, frozen=True):
    SENTENCE = "{place} can be reached only with {variable} = {value}"
    WAKES = ("module",)
    place: str
    variable: str
    value: str


class NotAccepted(Reason, frozen=True):
    SENTENCE = "{place} does not accept {labware_type}"
    REMEDY = "Put labware there that it accepts, or change `accepts:` in the workcell file."
    WAKES = ("station",)
    URGENCY = PERSON
    place: str
    labware_type: str


class WrongWay(Reason, frozen=True):
    SENTENCE = "{labware} would lie turned by {turned} degrees at {place}, which takes it turned by {wanted}"
    REMEDY = "Grip it otherwise in the workflow (narrow here, wide there), or turn it by hand."
    WAKES = ("station",)
    URGENCY = PERSON
    labware: str
    place: str
    turned: str
    wanted: str


class NoGrip(Reason, frozen=True):
    SENTENCE = "{module} cannot hold {labware_type} {grip} at {place}, only {known}"
    REMEDY = "Grip it otherwise in the workflow, or teach the arm and say so under `reach:`."
    WAKES = ("station",)
    URGENCY = PERSON
    module: str
    place: str
    labware_type: str
    grip: str
    known: str


class WasteFull(Reason, frozen=True):
    SENTENCE = "the waste {place} is full"
    REMEDY = "Empty it and say so: labos unload {place} --all"
    WAKES = ("station",)
    URGENCY = PERSON
    place: str


class Occupied(Reason, frozen=True):
    SENTENCE = "{place} is occupied by {what}"
    REMEDY = (
        "It goes on when a run moves that away; what no run moves any more, take away and say so: "
        "labos unload {place}"
    )
    WAKES = ("station", "module")
    place: str
    what: str


# -- planning --------------------------------------------------------------------------------------


class Reserved(Reason, frozen=True):
    SENTENCE = "{what} is reserved for run {run}, whose step {step!r} has to start in time"
    WAKES = ("cell", "window", "module", "station", "zone")
    what: str
    run: str
    step: str


class NotInTime(Reason, frozen=True):
    SENTENCE = "{what} would not be free in time for {step!r}"
    WAKES = ("module", "station", "zone", "cell")
    what: str
    step: str


class WouldDelay(Reason, frozen=True):
    SENTENCE = "starting {step!r} now would make run {run} late for {late!r}"
    WAKES = ("cell", "window", "module")
    step: str
    run: str
    late: str


class FollowsLate(Reason, frozen=True):
    SENTENCE = "if {step!r} started now, {late!r} could not start in time"
    WAKES = ("cell", "window", "module")
    step: str
    run: str
    late: str


class AfterElder(Reason, frozen=True):
    SENTENCE = "run {run} has waited longer and goes first"
    WAKES = ("cell", "near")
    run: str


class BetterHere(Reason, frozen=True):
    SENTENCE = "{first} is down, and beyond {step!r} it would stand in others' way"
    WAKES = ("cell", "near", "module")
    URGENCY = PERSON
    step: str
    dead: tuple[str, ...]

    def _in_words(self) -> dict[str, Any]:
        return {"step": in_words(self.step), "first": local(self.dead[0])}


class NoWayOut(Reason, frozen=True):
    SENTENCE = "once started with {step!r} it could not reach its end now"
    REMEDY = "It is let in when its way is free; what nobody moves needs a run that takes it away."
    WAKES = ("cell",)
    step: str
    run: str


class Unsafe(Reason, frozen=True):
    SENTENCE = "starting {step!r} now would trap {who}"
    WAKES = ("cell",)
    step: str
    trapped: tuple[str, ...]

    def _in_words(self) -> dict[str, Any]:
        return {"step": in_words(self.step), "who": ", ".join(_who(name) for name in self.trapped)}


def _who(name: str) -> str:
    kind, _, which = name.rpartition(":")
    return f"experiment {which}" if kind == "experiment" else f"run {which}"


AnyReason = (
    Paused
    | Unapproved
    | Halted
    | LogShorter
    | Cancelling
    | Gone
    | NotPending
    | After
    | RetryLater
    | Asked
    | TooEarly
    | Outcome
    | Quota
    | NoModule
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
    | HandFull
    | ReachedInto
    | Requires
    | Unfit
    | UsedUp
    | Expired
    | StackEmpty
    | Buried
    | Uncertain
    | Lost
    | InMotion
    | InUse
    | NotYours
    | Undeclared
    | NothingThere
    | StillToCome
    | NoAccess
    | NotAccepted
    | WrongWay
    | NoGrip
    | WasteFull
    | Occupied
    | Reserved
    | NotInTime
    | WouldDelay
    | FollowsLate
    | AfterElder
    | BetterHere
    | NoWayOut
    | Unsafe
)

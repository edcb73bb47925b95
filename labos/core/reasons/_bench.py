"""Reasons that concern stations, labware and supplies."""

from __future__ import annotations

from labos.core.reasons._base import PERSON, Reason


class AtStation(Reason, frozen=True):
    """A reason that may end when a station changes."""

    WAKES = ("station",)


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


class Unfit(AtStation, frozen=True):
    SENTENCE = "{labware} is not as the step needs it: {variable} = {value}"
    REMEDY = "Let a run of its owner change that, or remove it and report that: labos unload"
    URGENCY = PERSON
    labware: str
    variable: str
    value: str


class UsedUp(Reason, frozen=True):
    SENTENCE = "{module} has too little {resource} left"
    REMEDY = "Refill it and report that: labos replenish {module} {resource} --lot LOT"
    WAKES = ("module",)
    URGENCY = PERSON
    module: str
    resource: str


class Expired(Reason, frozen=True):
    SENTENCE = "{resource} of {module} has expired (lot {lot}, on {until})"
    REMEDY = (
        "Remove the old pack and report the new one: labos replenish {module} {resource} --lot LOT --instead"
    )
    WAKES = ("module",)
    URGENCY = PERSON
    module: str
    resource: str
    lot: str
    until: str


class StackEmpty(AtStation, frozen=True):
    SENTENCE = "the stack {place} is empty"
    REMEDY = "Fill it and report that: labos load {place} --type TYPE --count N --lot LOT"
    URGENCY = PERSON
    place: str


class Buried(AtStation, frozen=True):
    SENTENCE = "{labware} stands on top of the stack {place}"
    REMEDY = "It continues when a run moves that away."
    place: str
    labware: str


class Uncertain(AtStation, frozen=True):
    SENTENCE = "it is not known what stands at {place}"
    REMEDY = "Look there and answer the open question: labos resolve"
    URGENCY = PERSON
    place: str


class Lost(AtStation, frozen=True):
    SENTENCE = "it is not known where {labware} is"
    REMEDY = "Look for it and answer the open question: labos resolve"
    URGENCY = PERSON
    labware: str


class InMotion(Reason, frozen=True):
    SENTENCE = "{labware} is in motion at {place}"
    WAKES = ("station", "module")
    labware: str
    place: str


class InUse(AtStation, frozen=True):
    SENTENCE = "{owner} works on {labware} at {place} until it ends"
    labware: str
    place: str
    owner: str


class NotYours(AtStation, frozen=True):
    SENTENCE = "{labware} at {place} belongs to {owner}"
    REMEDY = "Let a run of its owner move it away."
    URGENCY = PERSON
    labware: str
    place: str
    owner: str


class Undeclared(AtStation, frozen=True):
    SENTENCE = "it was never reported what stands at {place}"
    REMEDY = "Report what stands there: labos bench declare {place}=TYPE, or {place}= if nothing does"
    URGENCY = PERSON
    place: str


class NothingThere(AtStation, frozen=True):
    SENTENCE = "nothing stands at {place}"
    REMEDY = "Put some there and report that: labos place {place} TYPE"
    URGENCY = PERSON
    place: str


class StillToCome(AtStation, frozen=True):
    SENTENCE = "nothing stands at {place} yet"
    place: str


class NoAccess(Reason, frozen=True):
    SENTENCE = "{place} can be reached only with {variable} = {value}"
    WAKES = ("module",)
    place: str
    variable: str
    value: str


class NotAccepted(AtStation, frozen=True):
    SENTENCE = "{place} does not accept {labware_type}"
    REMEDY = "Put labware there that it accepts, or change `accepts:` in the workcell file."
    URGENCY = PERSON
    place: str
    labware_type: str


class WrongWay(AtStation, frozen=True):
    SENTENCE = "{labware} would lie turned by {turned} degrees at {place}, which takes it turned by {wanted}"
    REMEDY = "Use another grip in the workflow (narrow here, wide there), or turn it by hand."
    URGENCY = PERSON
    labware: str
    place: str
    turned: str
    wanted: str


class NoGrip(AtStation, frozen=True):
    SENTENCE = "{module} cannot hold {labware_type} {grip} at {place}, only {known}"
    REMEDY = "Use another grip in the workflow, or teach the arm and add it under `reach:`."
    URGENCY = PERSON
    module: str
    place: str
    labware_type: str
    grip: str
    known: str


class WasteFull(AtStation, frozen=True):
    SENTENCE = "the waste {place} is full"
    REMEDY = "Empty it and report that: labos unload {place} --all"
    URGENCY = PERSON
    place: str


class Occupied(Reason, frozen=True):
    SENTENCE = "{place} is occupied by {what}"
    REMEDY = (
        "It continues when a run moves that away. If no run does, remove it and report that: labos "
        "unload {place}"
    )
    WAKES = ("station", "module")
    place: str
    what: str


BenchReason = (
    ReachedInto
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
)

"""Reasons that concern stations, labware and supplies."""

from __future__ import annotations

from labos.core.reasons._base import NeedsPerson, Reason


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


class Unfit(NeedsPerson, frozen=True):
    SENTENCE = "{labware} is not as the step needs it: {variable} = {value}"
    REMEDY = "Let a run of its owner change that, or remove it and report that: labos unload"
    WAKES = ("station",)
    labware: str
    variable: str
    value: str


class UsedUp(NeedsPerson, frozen=True):
    SENTENCE = "{module} has too little {resource} left"
    REMEDY = "Refill it and report that: labos replenish {module} {resource} --lot LOT"
    WAKES = ("module",)
    module: str
    resource: str


class Expired(NeedsPerson, frozen=True):
    SENTENCE = "{resource} of {module} has expired (lot {lot}, on {until})"
    REMEDY = (
        "Remove the old pack and report the new one: labos replenish {module} {resource} --lot LOT --instead"
    )
    WAKES = ("module",)
    module: str
    resource: str
    lot: str
    until: str


class StackEmpty(NeedsPerson, frozen=True):
    SENTENCE = "the stack {place} is empty"
    REMEDY = "Fill it and report that: labos load {place} --type TYPE --count N --lot LOT"
    WAKES = ("station",)
    place: str


class Buried(Reason, frozen=True):
    SENTENCE = "{labware} stands on top of the stack {place}"
    REMEDY = "It continues when a run moves that away."
    WAKES = ("station",)
    place: str
    labware: str


class Uncertain(NeedsPerson, frozen=True):
    SENTENCE = "it is not known what stands at {place}"
    REMEDY = "Look there and answer the open question: labos resolve"
    WAKES = ("station",)
    place: str


class Lost(NeedsPerson, frozen=True):
    SENTENCE = "it is not known where {labware} is"
    REMEDY = "Look for it and answer the open question: labos resolve"
    WAKES = ("station",)
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


class NotYours(NeedsPerson, frozen=True):
    SENTENCE = "{labware} at {place} belongs to {owner}"
    REMEDY = "Let a run of its owner move it away."
    WAKES = ("station",)
    labware: str
    place: str
    owner: str


class Undeclared(NeedsPerson, frozen=True):
    SENTENCE = "it was never reported what stands at {place}"
    REMEDY = "Report what stands there: labos bench declare {place}=TYPE, or {place}= if nothing does"
    WAKES = ("station",)
    place: str


class NothingThere(NeedsPerson, frozen=True):
    SENTENCE = "nothing stands at {place}"
    REMEDY = "Put some there and report that: labos place {place} TYPE"
    WAKES = ("station",)
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


class NotAccepted(NeedsPerson, frozen=True):
    SENTENCE = "{place} does not accept {labware_type}"
    REMEDY = "Put labware there that it accepts, or change `accepts:` in the workcell file."
    WAKES = ("station",)
    place: str
    labware_type: str


class WrongWay(NeedsPerson, frozen=True):
    SENTENCE = "{labware} would lie turned by {turned} degrees at {place}, which takes it turned by {wanted}"
    REMEDY = "Use another grip in the workflow (narrow here, wide there), or turn it by hand."
    WAKES = ("station",)
    labware: str
    place: str
    turned: str
    wanted: str


class NoGrip(NeedsPerson, frozen=True):
    SENTENCE = "{module} cannot hold {labware_type} {grip} at {place}, only {known}"
    REMEDY = "Use another grip in the workflow, or teach the arm and add it under `reach:`."
    WAKES = ("station",)
    module: str
    place: str
    labware_type: str
    grip: str
    known: str


class WasteFull(NeedsPerson, frozen=True):
    SENTENCE = "the waste {place} is full"
    REMEDY = "Empty it and report that: labos unload {place} --all"
    WAKES = ("station",)
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

"""Reasons why a step does not start: a type for each, with its fields, its sentence and its remedy.

A reason of a new kind stands in one of the files beside this one and in ``AnyReason``; the type check then
names the matches that have to know it.
"""

from __future__ import annotations

from labos.core.reasons._base import Key, Reason, Urgency, code_of, in_words
from labos.core.reasons._bench import (
    Buried,
    Expired,
    InMotion,
    InUse,
    Lost,
    NoAccess,
    NoGrip,
    NotAccepted,
    NothingThere,
    NotYours,
    Occupied,
    ReachedInto,
    Requires,
    StackEmpty,
    StillToCome,
    Uncertain,
    Undeclared,
    Unfit,
    UsedUp,
    WasteFull,
    WrongWay,
)
from labos.core.reasons._modules import (
    Access,
    Booked,
    BookedSoon,
    HandFull,
    Held,
    ModuleBusy,
    ModuleDown,
    NoGap,
    NoModule,
    OutOfService,
    Setpoint,
    Unsettled,
    Unwatched,
    ZoneBarred,
    ZoneBusy,
)
from labos.core.reasons._planning import (
    AfterElder,
    AfterSuggested,
    BetterHere,
    ClockLater,
    FollowsLate,
    HoldsUp,
    LaterHere,
    NotInTime,
    NoWayOut,
    Reserved,
    SoonerAfter,
    SoonerLater,
    Unsafe,
    WouldBlock,
    WouldDelay,
)
from labos.core.reasons._run import (
    After,
    Asked,
    Cancelling,
    Gone,
    Halted,
    LogShorter,
    NotApproved,
    NotPending,
    Outcome,
    Paused,
    Quota,
    RetryLater,
    TooEarly,
    Unapproved,
)

AnyReason = (
    Paused
    | Unapproved
    | NotApproved
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
    | Booked
    | BookedSoon
    | NoGap
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
    | SoonerAfter
    | LaterHere
    | AfterSuggested
    | ClockLater
    | WouldBlock
    | HoldsUp
    | SoonerLater
    | BetterHere
    | NoWayOut
    | Unsafe
)

__all__ = [
    "Access",
    "After",
    "AfterElder",
    "AfterSuggested",
    "AnyReason",
    "Asked",
    "BetterHere",
    "Booked",
    "BookedSoon",
    "Buried",
    "Cancelling",
    "ClockLater",
    "Expired",
    "FollowsLate",
    "Gone",
    "Halted",
    "HandFull",
    "Held",
    "HoldsUp",
    "InMotion",
    "InUse",
    "Key",
    "LaterHere",
    "LogShorter",
    "Lost",
    "ModuleBusy",
    "ModuleDown",
    "NoAccess",
    "NoGap",
    "NoGrip",
    "NoModule",
    "NoWayOut",
    "NotAccepted",
    "NotApproved",
    "NotInTime",
    "NotPending",
    "NotYours",
    "NothingThere",
    "Occupied",
    "OutOfService",
    "Outcome",
    "Paused",
    "Quota",
    "ReachedInto",
    "Reason",
    "Requires",
    "Reserved",
    "RetryLater",
    "Setpoint",
    "SoonerAfter",
    "SoonerLater",
    "StackEmpty",
    "StillToCome",
    "TooEarly",
    "Unapproved",
    "Uncertain",
    "Undeclared",
    "Unfit",
    "Unsafe",
    "Unsettled",
    "Unwatched",
    "Urgency",
    "UsedUp",
    "WasteFull",
    "WouldBlock",
    "WouldDelay",
    "WrongWay",
    "ZoneBarred",
    "ZoneBusy",
    "code_of",
    "in_words",
]

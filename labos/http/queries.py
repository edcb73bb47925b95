"""The parameters in the paths and queries of the operations."""

from __future__ import annotations

from typing import Annotated

import msgspec

from labos.http.limits import MOST_FILTERS, Name, Time, says
from labos.http.tail import PAGE

LONGEST_WAIT_S = 60.0

Several = Annotated[list[Name], msgspec.Meta(max_length=MOST_FILTERS - 10)]
Wait = Annotated[float, msgspec.Meta(ge=0, le=LONGEST_WAIT_S)]
Page = Annotated[int, msgspec.Meta(ge=0, le=PAGE)]


class OfRun(msgspec.Struct, frozen=True):
    run: Annotated[Name, says("a run's id", "R1")]


class OfExperiment(msgspec.Struct, frozen=True):
    experiment: Annotated[Name, says("an experiment's id", "E1")]


class OfCampaign(msgspec.Struct, frozen=True):
    campaign: Annotated[Name, says("a campaign's id", "C1")]


class OfIntervention(msgspec.Struct, frozen=True):
    intervention: Annotated[Name, says("a question's id", "I1")]


class OfModule(msgspec.Struct, frozen=True):
    module: Annotated[
        Name,
        says("a module's name, with its workcell if several modules of the lab have this name", "rpl/sealer"),
    ]


class OfWorkcell(msgspec.Struct, frozen=True):
    workcell: Annotated[Name, says("a workcell's name", "rpl")]


class OfUser(msgspec.Struct, frozen=True):
    user: Annotated[Name, says("a user's id", "ada")]


class OfGroup(msgspec.Struct, frozen=True):
    group: Annotated[Name, says("a group's name", "chemistry")]


class OfLabware(msgspec.Struct, frozen=True):
    labware: Annotated[Name, says("labware, by its id or barcode", "P7")]


class OfFile(msgspec.Struct, frozen=True):
    sha256: Annotated[Name, says("the SHA-256 of its content", "ab" * 32)]


class StateQuery(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    waits: Annotated[
        bool, says("whether to give the reasons why runs wait, which takes time to compute; true if left out")
    ] = True


class NodesQuery(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    module: Annotated[Several, says("a module; may be repeated; left out: all modules")] = []
    check: Annotated[
        bool, says("each node also reports its identity and what its device observes; nothing moves")
    ] = False


class EventFilter(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    after: Annotated[Time, says("only events after this position")] = 0
    type: Annotated[Several, says("a type or family; may be repeated")] = []
    stream: Annotated[Several, says("a run or other subject; may be repeated")] = []
    correlation: Annotated[Name, says("only events of this run or experiment")] = ""
    actor: Annotated[Name, says("only events that this user or module caused")] = ""
    mentions: Annotated[Name, says("only events whose payload holds this name")] = ""
    stored: Annotated[
        bool, says("payloads as the log holds them: with references in place of people's words")
    ] = False


class EventsQuery(EventFilter, frozen=True, forbid_unknown_fields=True):
    upto: Annotated[Time, says("only events up to this position; 0: to the end")] = 0
    since: Annotated[Time, says("only events from this time on (UTC nanoseconds); 0: from the first")] = 0
    until: Annotated[Time, says("only events before this time (UTC nanoseconds); 0: to the last")] = 0
    last: Annotated[Page, says("only this number of the last events; 0: all")] = 0
    wait: Annotated[Wait, says("seconds to wait for an event if there is none yet")] = 0.0


class RunsQuery(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    after: Annotated[Time, says("only runs that have not ended and were submitted after this position")] = 0
    limit: Annotated[
        int,
        msgspec.Meta(ge=1, le=PAGE),
        says("the largest number of runs that have not ended; 100 if left out"),
    ] = 100
    ended: Annotated[Page, says("also answer this number of ended runs")] = 0
    before: Annotated[Time, says("only ended runs that ended before this position")] = 0


class RunQuery(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    wait: Annotated[Wait, says("seconds to wait for its end")] = 0.0

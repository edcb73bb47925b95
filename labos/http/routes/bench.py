"""Reports of people about the bench: labware that they placed, took away and saw; and the lab's questions to
them."""

from __future__ import annotations

from functools import partial

import msgspec

from labos.core.decide.handover import HandOver
from labos.core.decide.labware import NameBarcode
from labos.core.decide.observation import ObserveStation
from labos.core.ids import LabwareId, Owner, StationName, split_key
from labos.core.interventions import InterventionRequested, InterventionResolved
from labos.core.labware import LabwareObserved, LabwareRemoved, LabwareUncertain
from labos.core.structs import make_from
from labos.core.topics import Choice
from labos.errors import NotFound
from labos.http.bodies import (
    BarcodeLabel,
    BenchDeclaration,
    Handover,
    InterventionAnswer,
    Observation,
    SampleSheet,
)
from labos.http.limits import check_person
from labos.http.operation import Call, Method, Operation, change, operate, read, submit
from labos.http.queries import OfIntervention, OfLabware
from labos.http.round import Round, RoundReport, RoundResult, round_view, say
from labos.http.samples import register_samples
from labos.http.service import LabService
from labos.http.stock import LabwarePlacement, Load, Unload, declare_bench, load, unload

EMPTY = "empty"


class QuestionAsked(msgspec.Struct, frozen=True):
    id: str
    text: str
    choices: tuple[Choice, ...]


class ObservationResult(msgspec.Struct, frozen=True):
    """The consequences of an observation: labware that was ``found``, with its station; labware that is
    ``gone``; ``uncertain`` labware with its possible places; and the questions that are ``answered`` and
    ``asked``."""

    station: str
    found: dict[str, str]
    gone: list[str]
    uncertain: dict[str, tuple[str, ...]]
    answered: list[str]
    asked: list[QuestionAsked]


class Resolution(msgspec.Struct, frozen=True):
    intervention: str
    choice: str


class LabwareReference(msgspec.Struct, frozen=True):
    """The id of the labware. It is empty on a stack, where a piece gets its id when it is taken."""

    labware: str


class LoadResult(msgspec.Struct, frozen=True):
    """The ids of the labware; none on a stack."""

    labware: list[str]


class UnloadResult(msgspec.Struct, frozen=True):
    """The ids of the pieces that had one, and the number of pieces without."""

    labware: list[str]
    nameless: int


class DeclareResult(msgspec.Struct, frozen=True):
    """The types of labware by station."""

    declared: dict[str, list[str]]


class LabwareOwner(msgspec.Struct, frozen=True):
    labware: str
    owner: str


class SampleCounts(msgspec.Struct, frozen=True):
    """The number of samples in each plate."""

    plates: dict[str, int]


_report = partial(operate, problems=("not_found", "refused"))
"""What a person reports about a station."""


@change(
    route="POST /interventions/{intervention}",
    client=Method("resolve", "intervention, choice, by, note, result", take=None),
    summary="Answer a question",
    example={"choice": "done", "by": "ada", "note": "it stood askew"},
    example_answer={"intervention": "I1", "choice": "done"},
)
async def answer_intervention(call: Call, path: OfIntervention, body: InterventionAnswer) -> Resolution:
    await call.service.resolve(path.intervention, body.choice, body.by, body.note, body.result)
    return Resolution(path.intervention, body.choice)


@_report(
    route="POST /stations/place",
    client=Method("place", take="labware"),
    summary="Report that labware was put on an empty station",
    status=201,
    example={"station": "sealer.default", "labware": "plate96", "by": "ada"},
    example_answer={"labware": "P7"},
)
async def place_labware(call: Call, body: LabwarePlacement) -> LabwareReference:
    names = await load(call.service, make_from(Load, body), body.by)
    return LabwareReference(names[0] if names else "")


@_report(
    route="POST /stations/load",
    client=Method("load", take="labware"),
    summary="Report that labware was loaded",
    status=201,
    example={"station": "sciclops.tower1", "labware": "plate96", "by": "ada", "count": 20, "lot": "L7"},
    example_answer={"labware": []},
)
async def load_station(call: Call, body: Load) -> LoadResult:
    """The labware is on top of a stack, or in free slots. It is refused if the station does not accept it or
    has no room."""
    return LoadResult(await load(call.service, body, body.by))


@_report(
    route="POST /stations/unload",
    client=Method("unload"),
    summary="Report that labware was taken away",
    example={"station": "sciclops.tower1", "by": "ada", "count": 3},
    example_answer={"labware": ["P7"], "nameless": 2},
)
async def unload_station(call: Call, body: Unload) -> UnloadResult:
    """The labware has left the bench. It is refused for labware of a run or an experiment that has not
    ended."""
    names, nameless = await unload(call.service, body, body.by)
    return UnloadResult(names, nameless)


@_report(
    route="POST /stations/observe",
    client=Method("observe", "station, what, by"),
    summary="Report what stands at a station",
    status=201,
    example={"station": "sealer.default", "by": "ada", "what": "empty"},
)
async def observe_station(call: Call, body: Observation) -> ObservationResult:
    """The report narrows down uncertain places. If it contradicts the log, LabOS asks a question. It is
    refused while labware is being moved to or from the station."""
    place = call.service.station(body.station)
    events = await call.kernel.execute(_sight(call.service, place, body.what.strip(), body.by), body.by)
    return ObservationResult(
        station=place,
        found={e.labware: e.station for e in events if isinstance(e, LabwareObserved)},
        gone=[e.labware for e in events if isinstance(e, LabwareRemoved)],
        uncertain={e.labware: e.places for e in events if isinstance(e, LabwareUncertain)},
        answered=[e.intervention for e in events if isinstance(e, InterventionResolved)],
        asked=[
            QuestionAsked(e.intervention, e.text, e.choices)
            for e in events
            if isinstance(e, InterventionRequested)
        ],
    )


@_report(
    route="POST /stations/declare",
    client=Method("declare", "stations, by", take="declared"),
    summary="Declare what stands at stations",
    status=201,
    example={"by": "ada", "stations": {"sealer.default": ["plate96"]}},
    example_answer={"declared": {"sealer.default": ["plate96"]}},
)
async def declare_stations(call: Call, body: BenchDeclaration) -> DeclareResult:
    """The labware is listed from bottom to top. Either all stations are declared, or none."""
    found = await declare_bench(call.service, body.stations, body.workcell, body.by, empty=body.empty)
    return DeclareResult(found)


@read(
    route="GET /round",
    client=Method("round"),
    summary="Show what has to be reported of the bench after the log lost its end",
)
def get_round(call: Call) -> Round:
    """The evidence that the log has lost its end, and the stations that have to be reported before anything
    starts. If the log is complete, the answer is empty."""
    return round_view(call.kernel.state)


@Operation(
    route="POST /round",
    client=Method("say", "by, stations, as_recorded", repeat=True),
    summary="Report what stands at stations after the log lost its end",
    needs="operator",
    status=201,
    example={"by": "ada", "stations": {"sealer.default": []}, "as_recorded": ["ot2_pcr_alpha.deck1"]},
    example_answer={
        "said": ["sealer.default"],
        "refused": [{"station": "rpl/pf400.gripper", "why": "…", "remedy": "…"}],
        "left": [],
    },
)
async def report_round(call: Call, body: RoundReport) -> RoundResult:
    """Each station is accepted or refused by itself. Labware is named by its id, or by its type if the log
    does not have it, with its lid (`P7+P8`, `plate96+lid96`). For a waste station only the number matters.
    When no station is left, the intervention is answered with `checked`."""
    return await say(call.service, body, body.by)


@change(
    route="POST /labware/{labware}/barcode",
    client=Method("barcode", take=None, repeat=True),
    summary="Record the barcode of labware",
    status=201,
    example={"barcode": "4006381333931", "by": "ada"},
    example_answer={"labware": "P7"},
)
async def label_labware(call: Call, path: OfLabware, body: BarcodeLabel) -> LabwareReference:
    """It is refused if other labware on the bench has this barcode."""
    labware = LabwareId(path.labware)
    await call.kernel.execute(NameBarcode(labware, body.barcode, body.by, body.replace), body.by)
    return LabwareReference(labware)


@change(
    route="POST /labware/{labware}/owner",
    client=Method("give", take=None, repeat=True),
    summary="Give labware to another owner",
    status=201,
    example={"to": "user:bo", "by": "ada"},
    example_answer={"labware": "P7", "owner": "user:bo"},
)
async def hand_over_labware(call: Call, path: OfLabware, body: Handover) -> LabwareOwner:
    """It is refused while a run uses the labware, while it is being moved or processed, and if it does not
    belong to `by`."""
    kind, name = split_key(body.to)
    if kind == "user":
        check_person(name, "to")
    item = call.service.labware(path.labware).id
    await call.kernel.execute(HandOver(item, Owner(body.to), body.by, body.force, body.note), body.by)
    return LabwareOwner(path.labware, body.to)


@submit(
    route="POST /samples",
    client=Method("load_samples", by_hand=True),
    summary="Register the samples in the wells of plates",
    status=201,
    example={"text": "plate,well,sample\nP7,A1,serum 12\n", "by": "ada", "name": "sheet.csv"},
    example_answer={"plates": {"P7": 1}},
)
async def register_sheet(call: Call, body: SampleSheet) -> SampleCounts:
    """A sheet with faults is refused completely; the answer lists the places of all faults."""
    return SampleCounts(await register_samples(call.service, body, body.by))


def _sight(service: LabService, place: StationName, what: str, by: str) -> ObserveStation:
    """What a person saw at a station: ``empty``, a number, labware by its id or barcode, a labware type, or
    (no words) something. Raises NotFound."""
    known, types = service.kernel.state.bench, service.list_labware_types()
    labware = known.barcodes.get(what, LabwareId(what))
    if not what:
        return ObserveStation(place, by)
    if what == EMPTY or what.isdecimal():
        return ObserveStation(place, by, 0 if what == EMPTY else int(what))
    if labware in known.labware:
        return ObserveStation(place, by, labware=labware)
    if what in types:
        return ObserveStation(place, by, kind=what)
    raise NotFound(
        f"{what!r} is neither labware on the bench nor a labware type.",
        remedy=f"Give empty, a number, an id such as P7, a barcode, or one of {', '.join(types)}.",
    )

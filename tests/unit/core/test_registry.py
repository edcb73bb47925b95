"""Stored bytes and Python values: every event type there and back, and what is refused."""

from __future__ import annotations

import json
import typing
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgspec
import pytest

from labos.core import registry, upcast
from labos.core.actions import (
    ActionAccepted,
    ActionDiscovered,
    ActionEvidence,
    ActionFailed,
    ActionReconciled,
    ActionRejected,
    ActionReported,
    ActionRequested,
    ActionSucceeded,
    ActionUnknown,
)
from labos.core.approvals import (
    ApprovalGiven,
    ApprovalRefused,
    ApprovalRequested,
    Demand,
    RunApproved,
    Why,
)
from labos.core.bookings import (
    BookingBegan,
    BookingCancelled,
    BookingChanged,
    BookingEnded,
    BookingMade,
    BookingNeared,
    BookingSkipped,
)
from labos.core.campaigns import (
    Budget,
    CampaignAmended,
    CampaignArchived,
    CampaignCancelled,
    CampaignCompleted,
    CampaignPaused,
    CampaignResumed,
    CampaignRowRefused,
    CampaignStopped,
    CampaignSubmitted,
    CampaignUnarchived,
    Terms,
)
from labos.core.conditions import make_condition
from labos.core.effects import Consumes, Draws, Move, Needs, Replaces, Requires, Sets, Take, Transfers
from labos.core.erasure import ErasureAsked, ErasureRefused, WordsErased
from labos.core.experiments import (
    ExperimentCancelled,
    ExperimentClosing,
    ExperimentEnded,
    ExperimentNoted,
    ExperimentResumed,
    ExperimentStarted,
)
from labos.core.expressions import parse_expression
from labos.core.fold import TABLE
from labos.core.interventions import InterventionOverdue, InterventionRequested, InterventionResolved
from labos.core.lab import (
    AccessEnded,
    AccessGranted,
    AccessRequested,
    KernelStarted,
    LabCreated,
    StartsPaused,
    StartsResumed,
    StationsApplied,
    WorkcellApplied,
)
from labos.core.labware import (
    BarcodeRead,
    LabwareChanged,
    LabwareHandedOver,
    LabwareMoved,
    LabwareObserved,
    LabwarePlaced,
    LabwareRemoved,
    LabwareUncertain,
    LiquidDrawn,
    LiquidTransferred,
    Sample,
    SamplesRegistered,
    StationDeclared,
    StationLoaded,
    StationObserved,
    StationUnloaded,
    WasteEmptied,
)
from labos.core.model import MAIN, ON_CANCEL, LabwareSpec, PlanStep, TransferWay, WellGrid, Window
from labos.core.modules import (
    EmergencyStopped,
    LocationTaught,
    ModuleCalibrated,
    ModulePutBack,
    ModuleTakenOut,
    NodeJoined,
    NodeLeft,
    NodeStateChanged,
    SetpointClaimed,
    SetpointReleased,
    StopReported,
    VariableSet,
)
from labos.core.plans import PlanRecorded, PlanStepsRecorded
from labos.core.policy import Policy, PolicyApplied
from labos.core.registry import TYPES, Event, decode, encode, event
from labos.core.repeated import RequestRepeated
from labos.core.resources import LevelSet, ResourceConsumed, ResourceReplenished
from labos.core.runs import (
    Anchor,
    RunBound,
    RunCancelled,
    RunCancelling,
    RunCompleted,
    RunFailed,
    RunLeaving,
    RunPaused,
    RunResumed,
    RunStarted,
    RunSubmitted,
)
from labos.core.shares import Group, Member, Quota, SharesApplied
from labos.core.shorter import BenchCompared, LogFoundShorter, StationsChecked
from labos.core.signatures import RecordsSigned, RunSigned
from labos.core.steps import StepRecovering, StepRetried, StepSkipped, StepUnexpected, WindowBreached
from labos.core.suggestions import OrderSuggested, Suggested
from labos.core.topics import Choice, LostLabware
from labos.core.users import (
    GroupAdded,
    GroupRemoved,
    MemberAdded,
    MemberRemoved,
    RoleGranted,
    RoleRevoked,
    UserAdded,
    UserDisabled,
    UserEnabled,
    UserErased,
)
from labos.errors import LogTooNew
from tests.support.bench import small_cell

WELLS = WellGrid(8, 12, 9.0, 14.38, 11.24, 2000.0)
DEEP = LabwareSpec("deep", 127.76, 85.48, 44.0, WELLS, stackable=False, grips=("narrow",))
WAY = TransferWay("cell/arm", "carry", "from", "to", 2.0, {"slow": True}, ("cell/a",), ("cell/b",))  # type: ignore[arg-type]
CELL = small_cell()
EFFECTS = (
    Move("c/a", "c/b", "narrow", "wide", "c/v", "P1"),  # type: ignore[arg-type]
    Take("c/s", "c/b", "P2"),  # type: ignore[arg-type]
    Needs("c/b", "P1"),  # type: ignore[arg-type]
    Requires("labware", "sealed", False, "P1"),  # type: ignore[arg-type]
    Sets("module", "lid", None),
    Consumes("tips", 1.5),
    Replaces("c/m", "tips", "lot", "2027-05-31"),
    Transfers("ink", ["A1"], [50.0], "ink", "P1"),  # type: ignore[arg-type]
    Draws(["A1"], [50.0], "P1"),  # type: ignore[arg-type]
)
IDS = ("A1", "R1", 2, "c/m")
ANCHORS = (Anchor("w", "s", "R0", 5),)  # type: ignore[arg-type]
UNTIL = make_condition("steps.read.od > 1", parse_expression("steps.read.od > 1"))
MEMBER = Member(3.0, Quota(2, 20, 40.0, {"tips": 960.0}))
TERMS = Terms(2, 9, Budget(10, 3600.0, {"tips": 96.0}), ("assay",), UNTIL, 3)
STEP = PlanStep(
    "k",
    "c/m",
    "do",
    {"x": [1, {"$result": [0, "y"]}]},
    (0,),
    EFFECTS,
    windows=(Window(0, 1.0, 2.0), Window(None, 1.0, 2.0, "ask", "incubate", "put in")),
)  # type: ignore[arg-type]

EXAMPLES: list[Event] = [
    LabCreated("L", "name", 2.0),  # type: ignore[arg-type]
    KernelStarted(3, "0.1"),
    WorkcellApplied("cell", "d", CELL.modules, (DEEP,), (WAY,)),
    StationsApplied("cell", CELL.stations),
    NodeJoined("c/m", "j", "i", "d", "1", "about", "IDLE", True),  # type: ignore[arg-type]
    NodeLeft("c/m", "silence"),  # type: ignore[arg-type]
    NodeStateChanged("c/m", "ERROR", "jam"),  # type: ignore[arg-type]
    SetpointClaimed("c/m", "temperature", 37.0, "R1"),  # type: ignore[arg-type]
    SetpointReleased("c/m", "temperature", "R1"),  # type: ignore[arg-type]
    VariableSet("c/m", "lid", {"deep": [1.5, None]}, "R1"),  # type: ignore[arg-type]
    ModuleTakenOut("c/m", "service", 9, 5),  # type: ignore[arg-type]
    ModulePutBack("c/m"),  # type: ignore[arg-type]
    EmergencyStopped("c/m", "ada", 7),  # type: ignore[arg-type]
    StationDeclared("c/s", ("plate", "lid")),  # type: ignore[arg-type]
    WasteEmptied("c/t"),  # type: ignore[arg-type]
    LabwarePlaced("P1", "R1", "plate", "c/a", "run:R1", "c/s", "A1"),  # type: ignore[arg-type]
    LabwareMoved("P1", "R1", "c/a", "c/b", "A1"),  # type: ignore[arg-type]
    LabwareRemoved("P1", "", "c/t", "discarded"),  # type: ignore[arg-type]
    LabwareUncertain("P1", "R1", ("c/a", "c/b"), "jam", "A1"),  # type: ignore[arg-type]
    LabwareObserved("P1", "", "c/a", "ada"),  # type: ignore[arg-type]
    LabwareChanged("P1", "R1", "sealed", True, "A1"),  # type: ignore[arg-type]
    StationObserved("c/a", "cam", 1, "P1", "plate"),  # type: ignore[arg-type]
    LabwareHandedOver("P1", "", "user:bob", "ada", "he asked"),  # type: ignore[arg-type]
    BarcodeRead("P1", "R1", "LB1", "cam", "A1"),  # type: ignore[arg-type]
    LiquidDrawn("P1", "R1", "c/m", ("A1",), (50.0,), False, "A1"),  # type: ignore[arg-type]
    LiquidTransferred("P1", "R1", "c/m", "ink", ("A1",), (50.0,), ("L1",), False, "A1"),  # type: ignore[arg-type]
    SamplesRegistered("P1", "", "d", 1, (Sample("A1", "water", 50.0),), "d"),  # type: ignore[arg-type]
    ActionRequested(*IDS, 1, 4, "j", "do", {"x": 1}, EFFECTS, False, {"f": "d"}),  # type: ignore[arg-type]
    ActionAccepted(*IDS, 1),  # type: ignore[arg-type]
    ActionRejected(*IDS, 1, "no", False),  # type: ignore[arg-type]
    ActionReported(*IDS, 1, ("c/a",), {"value": 1}, 17),  # type: ignore[arg-type]
    ActionSucceeded(*IDS, 1, {"value": [1, 2.5, None]}, 17),  # type: ignore[arg-type]
    ActionFailed(*IDS, 1, "jam", "partial"),  # type: ignore[arg-type]
    ActionUnknown(*IDS, 1, "silence"),  # type: ignore[arg-type]
    ActionReconciled(*IDS, 1, "all", "ada"),  # type: ignore[arg-type]
    ActionEvidence("A1", "", 0, "c/m", 1, True, "all", "none", "e"),  # type: ignore[arg-type]
    ActionDiscovered("A9", "c/m", "do", "finished", 17, EFFECTS[:3]),  # type: ignore[arg-type]
    LogFoundShorter("c/m", "was told of more", 90, 70, "c"),
    StationsChecked(("c/a",), "ada"),  # type: ignore[arg-type]
    BenchCompared("ada", "all of it"),
    PlanRecorded("R1", "p", "s", "flow", "cell", 2, (0,), {"f": "d"}),
    PlanStepsRecorded("R1", "p", 0, (STEP,)),
    RunSubmitted(
        *("R1", "p", "flow", "ada", "E1", 3, {"x": 1}, {"about": "d"}, True, "key", ANCHORS),  # type: ignore[arg-type]
        campaign="C1",  # type: ignore[arg-type]
        row=4,
        reads={"k": 0},
        choices=("p", "q"),
    ),
    RunBound("R1", "q", {"k": "c/m"}, "R0", "why"),  # type: ignore[arg-type,dict-item]
    RunStarted("R1"),  # type: ignore[arg-type]
    RunPaused("R1"),  # type: ignore[arg-type]
    RunResumed("R1"),  # type: ignore[arg-type]
    RunCancelling("R1", "why"),  # type: ignore[arg-type]
    RunLeaving("R1", (3, 4)),  # type: ignore[arg-type]
    RunApproved("R1", "bo"),  # type: ignore[arg-type]
    RunSigned("R1", "bo", "reviewed", 37, "d", "password", "checked"),  # type: ignore[arg-type]
    OrderSuggested("rpl", "planner", 9, (Suggested("R1", 2, 5),)),  # type: ignore[arg-type]
    RecordsSigned("E3", "experiment", "bo", "reviewed", 4, 137, "d", "password", "checked"),
    PolicyApplied("d", Policy(trusted=("robot",), above=Budget(3, 60.0, {"tips": 8.0}), priority=2)),
    ApprovalRequested(
        *("C1", "amendment", "screen", "ada", "robot for ada", "d", (Why("program", "by a program"),)),  # type: ignore[arg-type]
        {"table": "d"},
        Demand(2, 60.0, {"dev": 60.0}, {"tips": 8.0}, ("burn on dev (laser)",), 5),
        "C0",
        ("table",),
        Terms(3),
    ),
    ApprovalGiven("R1", "run", "d", "olga", "fine", 2, Terms(3), True),
    ApprovalRefused("R1", "run", "d", "olga", "no"),
    RunCompleted("R1", 2),  # type: ignore[arg-type]
    RunFailed("R1", "why", "software"),  # type: ignore[arg-type]
    RunCancelled("R1"),  # type: ignore[arg-type]
    StepUnexpected("R1", 2, "jam"),  # type: ignore[arg-type]
    StepSkipped("R1", 2, "jam"),  # type: ignore[arg-type]
    StepRecovering("R1", 2, "jam"),  # type: ignore[arg-type]
    StepRetried("R1", 2, 1, 3, 30.0, "jam"),  # type: ignore[arg-type]
    WindowBreached("R1", 2, None, 60.0, "R0"),  # type: ignore[arg-type]
    LevelSet("c/m", "tips", 3.0, 96.0, "lot"),  # type: ignore[arg-type]
    ResourceReplenished("c/m", "tips", 8.0, "lot", "2027-05-31", ("R1",), True),  # type: ignore[arg-type]
    ResourceConsumed("c/m", "tips", 8.0, "R1", "A1", "lot"),  # type: ignore[arg-type]
    StationLoaded("c/s", "plate", 20, "lot", ("R1",)),  # type: ignore[arg-type]
    StationUnloaded("c/s", 2, ("R1",)),  # type: ignore[arg-type]
    InterventionRequested(
        "I1",
        "lost_labware",
        "A1",
        "?",
        (Choice("gone", "."),),
        "R1",
        "c/m",
        ("P1",),
        EFFECTS[:2],
        0,
        LostLabware(run="R1", module="c/m", action="A1", motions=EFFECTS[:2]),
    ),  # type: ignore[arg-type]
    LocationTaught("cell/arm", "cell/a", (1.5, 2.0), 2, "ada", "moved", "deep"),  # type: ignore[arg-type]
    ModuleCalibrated("cell/arm", "ada", "volume", "K-1", "d" * 64, "2027-01-01", "yearly"),  # type: ignore[arg-type]
    AccessRequested("cell", "ada", "oil", ("plan",)),
    AccessGranted("cell"),
    AccessEnded("cell", "ada", "oiled"),
    StartsPaused("cell", "ada", "listening"),
    RequestRepeated("R1", "cancel", "wrong plate"),
    StartsResumed("cell", "ada"),
    InterventionOverdue("I1", "R1", 7),  # type: ignore[arg-type]
    InterventionResolved("I1", "gone", "ada", "note"),  # type: ignore[arg-type]
    ExperimentStarted("E1", "app", "ada", "p", 2, "key", ("c/a",)),  # type: ignore[arg-type]
    ExperimentCancelled("E1", "cancelled by ada"),  # type: ignore[arg-type]
    ExperimentClosing("E1", "ended"),  # type: ignore[arg-type]
    ExperimentEnded("E1", "p", "ended"),  # type: ignore[arg-type]
    ExperimentResumed("E1"),  # type: ignore[arg-type]
    ExperimentNoted("E1", "decision", "stop", {"score": 0.5}, "decision stop#1"),  # type: ignore[arg-type]
    SharesApplied("d", (Group("chemistry", 2.0, {"ada": MEMBER}, MEMBER.quota),), {"eve": MEMBER}),
    CampaignSubmitted("C1", "screen", "ada", "flow", "cell", 3, "d", "e", TERMS, "key"),  # type: ignore[arg-type]
    CampaignPaused("C1", "tea"),  # type: ignore[arg-type]
    CampaignResumed("C1"),  # type: ignore[arg-type]
    CampaignAmended("C1", TERMS),  # type: ignore[arg-type]
    CampaignRowRefused("C1", 2, "no such well"),  # type: ignore[arg-type]
    CampaignStopped("C1", "enough", "R7"),  # type: ignore[arg-type]
    CampaignCancelled("C1", "wrong plate"),  # type: ignore[arg-type]
    CampaignArchived("C1"),  # type: ignore[arg-type]
    CampaignUnarchived("C1"),  # type: ignore[arg-type]
    StopReported("ada", "*", {"cell/m": 5}, {"cell/n": "no node answers for it"}),  # type: ignore[dict-item]
    CampaignCompleted("C1", 1, 2, 3, 4, 5, "enough"),  # type: ignore[arg-type]
    UserAdded("robot", "service"),
    UserDisabled("ada"),
    UserEnabled("ada"),
    UserErased("bo"),
    GroupAdded("chemistry"),
    GroupRemoved("chemistry"),
    MemberAdded("chemistry", "ada"),
    MemberRemoved("chemistry", "ada"),
    RoleGranted("group:chemistry", "operator", "rpl"),
    RoleRevoked("user:ada"),
    BookingMade("B1", "c/m", 5, 7, "ada", "", "chemistry", False, "demo", "UTC", "FREQ=DAILY", 9, ("B0",)),
    BookingChanged("B1", "c/m", 5, 8, "ada", "bo", "", False, "demo", "UTC", "", 0, ()),
    BookingSkipped("B1", 5, "ada", "holiday"),
    BookingCancelled("B1", "ada", "not needed"),
    BookingNeared("B1", 5, 7),
    BookingBegan("B1", 5, 7),
    BookingEnded("B1", 5, 7, True),
    ErasureAsked("X1", "personal", "ada", (3, 7)),
    ErasureRefused("X1", "bo"),
    WordsErased("X1", "personal", "ada", ("d",), (3,), "", "bo"),
]


def test_there_is_an_example_of_every_type_and_only_one() -> None:
    assert sorted(example.TYPE for example in EXAMPLES) == sorted(TYPES)


@pytest.mark.parametrize("example", EXAMPLES, ids=lambda example: example.TYPE)
def test_every_type_comes_back_as_it_went(example: Event) -> None:
    payload = encode(example)
    back = decode(example.TYPE, example.SCHEMA, payload)
    assert back == example
    assert type(back) is type(example)
    assert encode(back) == payload
    assert example.stream(), "an event without a stream"


@pytest.mark.parametrize("example", EXAMPLES, ids=lambda example: example.TYPE)
def test_a_field_that_nobody_knows_is_refused(example: Event) -> None:
    payload = encode(example)
    strange = payload[:-1] + (b"," if len(payload) > 2 else b"") + b'"zzz":1}'
    with pytest.raises(LogTooNew, match="zzz") as error:
        decode(example.TYPE, example.SCHEMA, strange)
    assert "newer LabOS" in error.value.remedy


def structs_of(kind: Any) -> set[type]:
    """Every struct that a stored event of a kind may hold, itself included."""
    found: set[type] = set()
    todo = [kind]
    while todo:
        item = todo.pop()
        if isinstance(item, type) and issubclass(item, msgspec.Struct) and item not in found:
            found.add(item)
            todo += typing.get_type_hints(item).values()
        todo += typing.get_args(item)
    return found


@pytest.mark.parametrize(
    "kind", sorted(TYPES.values(), key=lambda kind: kind.TYPE), ids=lambda kind: kind.TYPE
)
def test_no_struct_within_an_event_overlooks_what_it_does_not_know(kind: type[Event]) -> None:
    """An older LabOS must refuse a log with newer fields, also deep within, and never misread it."""
    lenient = [s.__name__ for s in structs_of(kind) if not s.__struct_config__.forbid_unknown_fields]  # type: ignore[attr-defined]
    assert lenient == []


def test_unknown_fields_and_effects_deep_within_are_too_new() -> None:
    known = encode(PlanStepsRecorded("R1", "p", 0, (STEP,)))
    for before, after in [
        (b'"within_s":2.0', b'"within_s":2.0,"zzz":1'),
        (b'"effect":"take"', b'"effect":"teleport"'),
        (b'"key":"k"', b'"key":"k","zzz":1'),
    ]:
        assert before in known
        with pytest.raises(LogTooNew):
            decode("plan.steps_recorded", 4, known.replace(before, after, 1))
    with pytest.raises(msgspec.ValidationError):
        decode("plan.steps_recorded", 4, known.replace(b'"first":0', b'"first":"x"'))


STORED = Path(__file__).with_name("payloads.jsonl")
"""Payloads as they were once written, one a line: never changed, only added to. A line for each
type and version that ever was, and one more whenever a field is added."""


def read_stored() -> list[tuple[str, int, bytes]]:
    lines = [json.loads(line) for line in STORED.read_text().splitlines()]
    return [(line["type"], line["schema"], json.dumps(line["payload"]).encode()) for line in lines]


def test_every_payload_that_was_ever_written_can_still_be_read() -> None:
    for type_, schema, payload in read_stored():
        assert type_ == decode(type_, schema, payload).TYPE


def test_what_was_written_as_minus_one_is_nothing() -> None:
    """No number stands for a step that is not there; in earlier versions it was -1."""
    breached = b'{"run":"R1","step":2,"anchor":-1,"within_s":60.0,"of":"R0"}'
    assert decode("window.breached", 1, breached) == WindowBreached("R1", 2, None, 60.0, "R0")  # type: ignore[arg-type]
    its_own = breached.replace(b"-1", b"0")
    assert decode("window.breached", 1, its_own) == WindowBreached("R1", 2, 0, 60.0, "R0")  # type: ignore[arg-type]
    steps = (
        b'{"key":"k","module":"m","action":"a","retry":{"times":2,"reset":-1},"windows":[{"anchor":-1},{"anchor":0}]},'
        b'{"key":"l","module":"m","action":"a","retry":{"times":2,"reset":0}}'
    )
    payload = b'{"by":"R1","plan":"p","first":0,"steps":[' + steps + b"]}"
    for schema in (1, 2):
        found = decode("plan.steps_recorded", schema, payload)
        assert isinstance(found, PlanStepsRecorded)
        first, second = found.steps
        assert [window.anchor for window in first.windows] == [None, 0]
        assert [step.retry.reset for step in (first, second) if step.retry is not None] == [None, 0]


def test_parts_of_a_plan_that_were_written_as_numbers_have_names() -> None:
    steps = b",".join(
        b'{"key":"k","module":"m","action":"a"%b}' % part
        for part in (b"", b',"part":-1', b',"part":-2', b',"part":0', b',"part":7')
    )
    payload = b'{"by":"R1","plan":"p","first":0,"steps":[%b]}' % steps
    for schema in (1, 2, 3):
        found = decode("plan.steps_recorded", schema, payload)
        assert isinstance(found, PlanStepsRecorded)
        assert [step.part for step in found.steps] == [MAIN, MAIN, ON_CANCEL, 0, 7]
        assert [step.serves for step in found.steps] == [None, None, None, 0, 7]
        assert b'"part":"on_cancel"' in encode(found)
        assert decode("plan.steps_recorded", 4, encode(found)) == found


def test_a_run_of_no_campaign_has_no_row() -> None:
    written = [payload for type_, schema, payload in read_stored() if (type_, schema) == ("run.submitted", 1)]
    assert written
    for payload in written:
        found = decode("run.submitted", 1, payload)
        assert isinstance(found, RunSubmitted)
        assert (found.row is None) == (json.loads(payload).get("row", -1) == -1)


def test_the_present_shape_of_every_type_is_among_the_stored_ones() -> None:
    """A new event, field or version: add a line (``canonical`` of its example) to the file."""
    shapes = {(type_, schema, *sorted(json.loads(payload))) for type_, schema, payload in read_stored()}
    missing = [
        f'{{"type":"{e.TYPE}","schema":{e.SCHEMA},"payload":{encode(e).decode()}}}'
        for e in EXAMPLES
        if (e.TYPE, e.SCHEMA, *sorted(json.loads(encode(e)))) not in shapes
    ]
    assert missing == [], "\n".join(missing)


def test_every_type_is_folded_somewhere_or_only_remembered() -> None:
    assert set(TABLE) == set(TYPES.values())
    silent = {kind.TYPE for kind, handlers in TABLE.items() if not handlers}
    assert silent == {
        *(
            "experiment.resumed",
            "lab.stop_reported",
            "records.signed",
            "request.repeated",
            "run.signed",
            "user.erased",
        ),
    }


def test_names_say_family_and_past() -> None:
    for name in TYPES:
        family, _, what = name.partition(".")
        assert family
        assert what


def test_unknown_types_and_newer_versions_are_refused_with_a_remedy() -> None:
    for name, schema in [("run.teleported", 1), ("run.started", 2)]:
        with pytest.raises(LogTooNew, match="does not know") as error:
            decode(name, schema, b'{"run":"R1"}')
        assert "newer LabOS" in error.value.remedy


def test_a_payload_above_64_kb_is_refused() -> None:
    fits = VariableSet("c/m", "x", "y" * (64 * 1024 - 100))  # type: ignore[arg-type]
    assert decode(fits.TYPE, 1, encode(fits)) == fits
    with pytest.raises(ValueError, match="store large data as a blob"):
        encode(VariableSet("c/m", "x", "y" * 64 * 1024))  # type: ignore[arg-type]


def test_nothing_that_is_not_finite_gets_into_a_payload() -> None:
    with pytest.raises(ValueError, match="not a finite number"):
        encode(ActionSucceeded(*IDS, 1, {"deep": [float("nan")]}))  # type: ignore[arg-type]


@pytest.fixture
def newcomer() -> Iterator[type[Event]]:
    @event("test.measured", schema=3)
    class Measured(Event, frozen=True):
        celsius: float
        place: str

    yield Measured
    del registry.TYPES["test.measured"]
    del registry._decoders["test.measured", 3]


def test_old_payloads_are_lifted_one_version_at_a_time(
    newcomer: type[Event], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(
        upcast.LIFTS, ("test.measured", 1), lambda old: {"celsius": (old["fahrenheit"] - 32) / 1.8}
    )
    monkeypatch.setitem(upcast.LIFTS, ("test.measured", 2), lambda old: {**old, "place": "unknown"})
    expected = newcomer(celsius=100.0, place="unknown")  # type: ignore[call-arg]
    assert decode("test.measured", 1, b'{"fahrenheit":212}') == expected
    assert decode("test.measured", 2, b'{"celsius":100}') == expected
    assert decode("test.measured", 3, b'{"celsius":100,"place":"unknown"}') == expected
    with pytest.raises(LogTooNew):
        decode("test.measured", 4, b"{}")


def test_a_lift_that_is_missing_is_a_key_error(newcomer: type[Event]) -> None:
    with pytest.raises(KeyError):
        decode(newcomer.TYPE, 2, b"{}")


def test_two_classes_cannot_claim_one_type() -> None:
    with pytest.raises(ValueError, match="two event classes claim the type"):

        @event("lab.created")
        class Again(Event, frozen=True):
            pass

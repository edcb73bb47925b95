"""Events stay small, however much labware, however many runs and stations they are about."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from labos.core.bookings import LEAD_NS
from labos.core.decide.bookings import MakeBooking, NewTerms
from labos.core.decide.cancelling import CancelRun
from labos.core.decide.lab import ApplyWorkcell
from labos.core.decide.observation import ObserveStation
from labos.core.decide.stock import Replenish
from labos.core.ids import SHARED, LabwareId, ModuleName, Owner, RunId, StationName, run_owner
from labos.core.labware import LabwarePlaced
from labos.core.topics import BookedPlace, LeftLabware, NotSeen, SeenElsewhere
from tests.support.bench import (
    SECOND,
    START,
    Driver,
    consumes,
    full,
    module,
    move,
    plan,
    station,
    step,
    take,
    workcell,
)

MANY = 5_000
DECK = StationName(full("dev.deck"))


class Quick(Driver):
    """What must always hold is not asked after every one of many thousand events."""

    careful = False


@pytest.fixture
def lab() -> Quick:
    places = [station("stack", "stack", 10), station("a"), station("dev.deck", "nest", MANY)]
    return Quick(workcell([module("arm"), module("dev")], places))


def place(lab: Driver, count: int, owner: Owner = SHARED, run: str = "") -> list[LabwareId]:
    """Labware on the deck, and nothing else there."""
    names = []
    for _ in range(count):
        names.append(lab.state.bench.next_id)
        lab.write(LabwarePlaced(names[-1], run, "plate", DECK, owner))
    return names


def under_way(lab: Driver) -> RunId:
    run = lab.submit(plan(step("arm", take("stack", "a")), step("arm", move("a", "dev.deck"))))
    lab.stock("stack", 1)
    lab.step(run)
    return run


def pieces_of(lab: Driver, *topics: type) -> Iterator[LabwareId]:
    for question in lab.state.interventions.open_about(*topics):
        yield from question.labware


def test_a_run_that_leaves_five_thousand_pieces_can_be_cancelled_and_cleared_away(lab: Quick) -> None:
    run = under_way(lab)
    names = [*lab.state.bench.labware, *place(lab, MANY, run_owner(run), run)]
    lab.do(CancelRun(run))
    assert lab.types()[-1] == "run.cancelled"
    assert sorted(pieces_of(lab, LeftLabware)) == sorted(names)
    questions = lab.questions()
    assert len(questions) == 6
    assert "P2 at dev.deck" in questions[0].text
    assert questions[0].text.endswith("and 992 more.")
    lab.answer(questions[0], "leave")
    assert len(lab.state.bench.labware) == len(names)
    for question in questions[1:]:
        lab.answer(question, "removed")
    assert list(lab.state.bench.labware) == names[:1000]
    lab.check_log()


def test_what_is_not_seen_is_asked_about_in_pieces(lab: Quick) -> None:
    names = place(lab, MANY)
    lab.do(ObserveStation(DECK, "ada", 0))
    assert list(pieces_of(lab, NotSeen)) == names
    first, second, *_ = lab.questions()
    lab.answer(first, "there")
    lab.answer(second, "gone")
    assert lab.at("dev.deck") == names[:200]
    assert len(lab.state.bench.labware) == MANY - 200


def test_another_type_at_a_full_place(lab: Quick) -> None:
    names = place(lab, MANY)
    lab.do(ObserveStation(DECK, "ada", None, kind="tube"))
    assert list(pieces_of(lab, NotSeen)) == names


def test_one_piece_seen_in_a_place_full_of_others(lab: Quick) -> None:
    lab.write(LabwarePlaced(LabwareId("P1"), "", "plate", StationName(full("a")), SHARED))
    others = place(lab, MANY)
    lab.do(ObserveStation(DECK, "ada", None, LabwareId("P1")))
    assert list(pieces_of(lab, SeenElsewhere, NotSeen)) == ["P1", *others]
    lab.answer(lab.questions()[0], "seen")
    lab.answer(lab.questions()[0], "there")
    assert lab.at("dev.deck") == ["P1", *others[200:400]]


def test_a_booked_place_full_of_others_labware(lab: Quick) -> None:
    names = place(lab, MANY, Owner("user:cy"))
    hour = 3600 * SECOND
    begins = START + 2 * hour
    lab.do(MakeBooking(full("dev"), NewTerms(begins=begins, ends=begins + hour, user="bo"), "op", lab.now))
    lab.pump()
    lab.now = begins - LEAD_NS
    lab.pump()
    topics = [question.topic for question in lab.questions()]
    assert [name for topic in topics if isinstance(topic, BookedPlace) for name in topic.labware] == names


def test_more_runs_than_an_event_holds_wait_for_a_resource() -> None:
    lab = Quick(workcell([module("arm"), module("dev", levels={"tips": 2_000.0})], []))
    flow = plan(step("arm"), step("dev", consumes("tips", 10)))
    for _ in range(101):
        lab.step(lab.submit(flow))
    lab.level("dev", "tips", 0.0, 2_000.0)
    (event,) = lab.do(Replenish(ModuleName(full("dev")), "tips", 10.0))
    assert event.awaited == tuple(f"R{number}" for number in range(1, 101))  # type: ignore[attr-defined]


def test_thousands_of_stations_leave_a_workcell() -> None:
    arm = [module("arm")]
    places = [station(f"a-place-with-quite-a-long-name-{number}") for number in range(3_000)]
    lab = Quick(workcell(arm, places), empty=False)
    lab.do(ApplyWorkcell(workcell(arm, [station("a")])))
    assert full("a") in lab.state.bench.stations
    assert not any("long" in name for name in lab.state.bench.stations)

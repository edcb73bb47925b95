"""Requests of several parts: all of them happen, or none, whoever asks and wherever it breaks off."""

from __future__ import annotations

from collections.abc import Callable

import msgspec
import pytest

from labos.core.decide import Command
from labos.core.decide.access import RequestAccess
from labos.core.decide.composites import DeclareStations, ReportRound, SubmitWithLabware
from labos.core.decide.lab import ApplyWorkcell, CreateLab, DeclareStation, StartKernel
from labos.core.decide.nodes import RecordStops
from labos.core.decide.runs import SubmitRun
from labos.core.decide.shorter import ReportShorterLog, SayContents, list_to_say
from labos.core.decide.stock import LoadStation
from labos.core.decide.users import AddUser, GrantRole
from labos.core.ids import LabId, ModuleName, StationName
from labos.core.labware import LabwarePlaced
from labos.core.state import encode_picture
from tests.support.bench import CELL, Driver, full, move, plan, small, small_cell, station, step, workcell
from tests.support.bench import module as device

LONG = "x" * 70_000


def place(name: str) -> StationName:
    return StationName(full(name))


def load(name: str, count: int = 1, labware: str = "plate", lot: str = "") -> LoadStation:
    return LoadStation(place(name), labware, count, lot)


def carries(source: str = "a", target: str = "b") -> SubmitRun:
    return SubmitRun(plan(step("arm", move(source, target))), "ada", request="key")


def declare(name: str, *contents: str) -> DeclareStation:
    return DeclareStation(place(name), contents)


def roomy() -> Driver:
    """A hotel with shelves beside the rest, of which nobody has said what stands there."""
    lab = Driver()
    lab.do(CreateLab(LabId("lab-1"), "test lab", 1.0))
    lab.do(StartKernel(1, "0"))
    hotel = station("inn", "hotel", 3)
    shelves = [station(f"inn.{number}", hotel=hotel.name) for number in (1, 2, 3)]
    lab.do(ApplyWorkcell(workcell([device("arm")], [*map(station, "abc"), hotel, *shelves])))
    return lab


def check_untouched(lab: Driver, command: Command, by: str = "labos") -> str:
    """Why a command is refused; nothing of it has happened."""
    before = encode_picture(lab.state)
    code = lab.reject(command, by).code
    assert encode_picture(lab.state) == before
    return code


def test_labware_and_the_run_for_which_it_was_put_there() -> None:
    lab = small(stock=0)
    command = SubmitWithLabware(carries(), (load("a"), load("c", labware="plate+lid"), load("stack", 2)))
    events = lab.do(command)
    placed = [(e.labware, e.station) for e in events if isinstance(e, LabwarePlaced)]
    assert placed == [("P1", place("a")), ("P2", place("c")), ("P3", place("c"))]
    assert events[-1].TYPE == "run.submitted"
    assert lab.do(command) == [], "the same request again"
    assert lab.pump() == ["R1#0"]
    lab.check_log()


REFUSED: dict[str, tuple[Callable[[], Command], str]] = {
    "the run": (lambda: SubmitWithLabware(carries(target="nowhere"), (load("a"),)), "no_station"),
    "the second load": (lambda: SubmitWithLabware(carries(), (load("a"), load("b", 5))), "too_many"),
    "the same place twice": (lambda: SubmitWithLabware(carries(), (load("a"), load("a"))), "twice"),
    "the words of a part": (lambda: SubmitWithLabware(carries(), (load("a", lot=LONG),)), "bad_text"),
    "a payload that is too large": (
        lambda: SubmitWithLabware(
            msgspec.structs.replace(carries(), payload={"text": LONG}), (load("a"), load("c"))
        ),
        "unfit",
    ),
    "the last station": (lambda: DeclareStations((declare("a", "plate"), declare("inn"))), "no_station"),
    "a station twice": (lambda: DeclareStations((declare("a"), declare("a", "plate"))), "twice"),
    "what does not fit there": (
        lambda: DeclareStations((declare("a", "plate"), declare("b", "plate", "plate"))),
        "too_many",
    ),
    "too many words": (lambda: DeclareStations((declare("a"), declare("b", LONG))), "bad_text"),
}


@pytest.mark.parametrize("part", REFUSED)
def test_one_part_that_is_refused_leaves_nothing_of_the_others(part: str) -> None:
    make, code = REFUSED[part]
    lab = Driver(small_cell(), empty=False)
    assert check_untouched(lab, make()) == code


def test_a_hotel_and_one_of_its_shelves() -> None:
    lab = roomy()
    run = carries()
    assert check_untouched(lab, SubmitWithLabware(run, (load("inn", 2), load("inn.2")))) == "twice"
    for loads in ((load("inn", 2), load("inn.3")), (load("inn.3"), load("inn", 2))):
        lab = roomy()
        lab.do(SubmitWithLabware(run, loads))
        assert [lab.at(f"inn.{number}") != [] for number in (1, 2, 3)] == [True] * 3
        lab.check_log()


def test_stations_are_declared_together() -> None:
    lab = Driver(small_cell(), empty=False)
    lab.do(DeclareStations((declare("a", "plate+lid"), declare("b"), declare("stack", "plate", "plate"))))
    assert (lab.at("a"), lab.at("b")) == (["P1"], [])
    assert len(lab.state.bench.stations[place("stack")].stock) == 2
    lab.check_log()


def test_a_workcell_and_what_stands_there_at_first() -> None:
    lab = Driver()
    lab.do(CreateLab(LabId("lab-1"), "test lab", 1.0))
    lab.do(StartKernel(1, "0"))
    cell = small_cell()
    too_many = ApplyWorkcell(cell, {place("a"): ("plate", "plate")})
    assert check_untouched(lab, too_many) == "too_many"
    assert lab.state.lab.workcells == {}
    many = workcell([device("arm")], [station("tall", "stack", 900)])
    names = ("x" * 90,) * 900
    assert check_untouched(lab, ApplyWorkcell(many, {place("tall"): names})) == "unfit"
    command = ApplyWorkcell(cell, {place("a"): ("plate",), place("stack"): ("plate",) * 3})
    lab.do(command)
    assert all(lab.state.bench.stations[spec.name].known for spec in cell.places)
    assert lab.at("a") == ["P1"]
    assert lab.do(command) == [], "what is known is not said again"
    lab.check_log()


def test_somebody_reaches_in_and_the_arms_go_home() -> None:
    lab = small()
    homes = [SubmitRun(plan(step(arm, action="home")), "ada") for arm in ("arm", "nobody", "arm2")]
    events = lab.do(RequestAccess(CELL, "ada", "oil", tuple(homes)))
    assert [event.TYPE for event in events if event.TYPE != "run.plan_recorded"].count("run.submitted") == 2
    assert events[0].TYPE == "workcell.access_requested"
    assert sorted(lab.pump()) == ["R1#0", "R2#0"]
    assert check_untouched(lab, RequestAccess(CELL, "bo", "", tuple(homes))) == "occupied"
    lab.check_log()


def test_a_round_is_recorded_as_far_as_possible_and_finished() -> None:
    lab = small(stock=0)
    round_ = ReportRound("ada", (SayContents(place("a"), "ada", ("plate",)),), finish=True)
    assert check_untouched(lab, round_) == "no_round"
    lab.do(ReportShorterLog(900, "a checkpoint", 5))
    stations = (
        SayContents(place("a"), "ada", ("plate",)),
        SayContents(place("b"), "ada", ("plate", "plate", "plate")),
    )
    events = lab.do(ReportRound("ada", stations, (place("c"),), finish=True))
    assert not any(event.TYPE == "intervention.resolved" for event in events)
    assert (lab.at("a"), lab.at("b")) == (["P1"], [])
    assert place("b") in list_to_say(lab.state)
    left = tuple(list_to_say(lab.state))
    events = lab.do(ReportRound("ada", (), left, finish=True))
    assert any(event.TYPE == "log.bench_compared" for event in events)
    assert list_to_say(lab.state) == []
    lab.check_log()


def test_modules_that_were_stopped_at_once() -> None:
    lab = small()
    arm, arm2 = ModuleName(full("arm")), ModuleName(full("arm2"))
    stops = {arm: lab.now, ModuleName("cell/nix"): lab.now, arm2: lab.now + 1}
    assert [event.stream() for event in lab.do(RecordStops("ada", stops))] == [
        "cell/arm",
        "cell/arm2",
    ]
    assert lab.do(RecordStops("ada", stops)) == []


def with_people() -> Driver:
    lab = small(stock=0)
    lab.do(AddUser("root-1"))
    for name in ("ada", "olga"):
        lab.do(AddUser(name), "root-1")
    lab.do(GrantRole("user:ada", "submitter"), "root-1")
    lab.do(GrantRole("user:olga", "operator", CELL), "root-1")
    return lab


def test_whoever_asks_must_be_allowed_each_part() -> None:
    lab = with_people()
    assert check_untouched(lab, SubmitWithLabware(carries(), (load("a"),)), "ada") == "no_right"
    assert check_untouched(lab, SubmitWithLabware(carries(), (load("a"),)), "olga") == "not_you"
    assert check_untouched(lab, DeclareStations((declare("a"), declare("b"))), "ada") == "no_right"
    assert check_untouched(lab, ReportRound("ada"), "ada") == "no_right"
    assert check_untouched(lab, ReportRound("olga"), "olga") == "no_round"
    assert check_untouched(lab, ReportRound("olga", finish=True), "olga") == "no_right", (
        "not in the whole lab"
    )
    assert check_untouched(lab, ReportRound("olga", (SayContents(place("a"), "olga"),)), "ada") == "not_you"
    other = SubmitRun(plan(step("arm", action="home")), "ada")
    assert check_untouched(lab, RequestAccess(CELL, "olga", "", (other,)), "olga") == "not_you"
    lab.do(SubmitWithLabware(msgspec.structs.replace(carries(), user="olga"), (load("a"),)), "olga")


def test_a_user_and_their_first_role() -> None:
    lab = with_people()
    assert check_untouched(lab, AddUser("bo", role="operator", scope="nowhere"), "root-1") == "no_workcell"
    assert check_untouched(lab, AddUser("bo", role="admin"), "ada") == "no_right"
    events = lab.do(AddUser("bo", role="operator", scope=CELL), "root-1")
    assert [event.TYPE for event in events] == ["user.added", "role.granted"]
    assert lab.state.users.roles["user:bo"] == {CELL: "operator"}
    first = small(stock=0)
    first.do(AddUser("eve", role="viewer"))
    assert first.state.users.list_admins() == ["eve"]

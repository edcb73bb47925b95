"""What the log says of any moment, event, plate and run."""

from __future__ import annotations

import types
import typing
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import msgspec
import pytest

from labos.core.envelope import Envelope
from labos.core.ids import LabwareId, RunId, StationName
from labos.core.labware import LabwareUncertain
from labos.core.registry import TYPES, Event
from labos.core.state import LabState
from labos.core.suggestions import OrderSuggested, Suggested
from labos.errors import BadInput, LogDamaged, NotFound
from labos.runtime.ledger import fold
from labos.services.catalogue import read_catalogue
from labos.services.describe import describe
from labos.services.filters import FilteredLog, LogFilter
from labos.services.history import find_position_at, fold_state_at
from labos.services.labware import fold_histories, list_labware_histories, read_labware_history
from labos.services.log import decode_events
from labos.services.runs import run_histories, run_history
from labos.services.times import Moment
from labos.store import SqlEventStore, open_store
from tests.unit.services.logbook import SECOND, START_NS, Logbook, two_users

Open = Callable[[str], SqlEventStore]


@pytest.fixture
def open_log() -> Iterator[Open]:
    stores: list[SqlEventStore] = []

    def open_(url: str) -> SqlEventStore:
        stores.append(open_store(url, create=False, read_only=True))
        return stores[-1]

    yield open_
    for store in stores:
        store.close()


@pytest.fixture
def log(tmp_path: Path, open_log: Open) -> SqlEventStore:
    return open_log(two_users().save(tmp_path))


def fold_to(upto: int) -> Any:
    state = LabState()
    fold(state, two_users().records[:upto])
    return msgspec.to_builtins(state)


# -- moments --------------------------------------------------------------------------------------


def test_the_state_at_every_tenth_position(log: SqlEventStore) -> None:
    for position in range(1, two_users().position + 1, 10):
        assert msgspec.to_builtins(fold_state_at(log, Moment(position=position))) == fold_to(position)


def test_a_time_means_everything_recorded_up_to_it(log: SqlEventStore) -> None:
    records = two_users().records
    for record in records[::7]:
        at = record.head.recorded_at
        last = max(r.head.position for r in records if r.head.recorded_at <= at)
        assert find_position_at(log, Moment(at_ns=at)) == last
        if at > START_NS:
            before = max(r.head.position for r in records if r.head.recorded_at < at)
            assert find_position_at(log, Moment(at_ns=at - 1)) == before
    assert find_position_at(log, Moment(at_ns=2**62)) == len(records) == find_position_at(log)


def test_moments_outside_the_log_are_refused(log: SqlEventStore) -> None:
    with pytest.raises(BadInput, match=r"there was no log yet\. It begins at"):
        fold_state_at(log, Moment(at_ns=START_NS - 1))
    for position in (0, two_users().position + 1):
        with pytest.raises(BadInput, match=rf"no position {position}\. Its positions are 1"):
            fold_state_at(log, Moment(position=position))


def test_a_snapshot_is_used_only_for_what_comes_after_it(tmp_path: Path, open_log: Open) -> None:
    log = open_log(two_users().save(tmp_path, with_snapshot=True))
    end = two_users().position
    assert msgspec.to_builtins(fold_state_at(log)) == fold_to(end)
    assert msgspec.to_builtins(fold_state_at(log, Moment(position=end - 5))) == fold_to(end - 5)


def test_a_record_that_contradicts_the_log_is_named() -> None:
    records = list(two_users().records[:90])
    records[80] = msgspec.structs.replace(records[80], payload=b"{}")
    with pytest.raises(LogDamaged, match=r"position 81 .* labos verify"):
        list(decode_events(records))


# -- sentences ------------------------------------------------------------------------------------


def sample(hint: Any) -> Any:
    """Some value of a type."""
    origin = typing.get_origin(hint)
    if origin in (typing.Union, types.UnionType):
        return sample(typing.get_args(hint)[0])
    if origin is typing.Literal:
        return typing.get_args(hint)[0]
    if isinstance(hint, typing.NewType):
        return sample(hint.__supertype__)
    known: dict[Any, Any] = {str: "cell/thing.part", int: 1, float: 2.5, bool: True, typing.Any: None}
    return known.get(hint, () if origin is tuple else {})


@pytest.mark.parametrize("kind", sorted(TYPES))
def test_every_type_of_event_is_told_in_a_sentence(kind: str) -> None:
    cls: type[Event] = TYPES[kind]
    hints = typing.get_type_hints(cls)
    event = cls(**{f.name: sample(hints[f.name]) for f in msgspec.structs.fields(cls)})
    head = Envelope("lab", 1, "id", event.stream(), 1, kind, 1, 1, "ada", "", "", "")
    told = describe(event, head)
    assert not told.startswith(kind), "only types that nobody knows are told by their name"
    assert "None" not in told


def test_sentences_bear_the_names_of_steps(log: SqlEventStore) -> None:
    names = read_catalogue(log)
    told = [describe(event, head, names) for event, head in decode_events(log.read())]
    assert "R1 #4 'Seal plate/Seal': sealer.seal requested (attempt 1)" in told
    assert "R1: P1 moved from sciclops.exchange to ot2_pcr_alpha.deck1_cooler" in told
    assert "R1: ada submitted 'pcr'" in told
    assert "the lab 'paper' was created, simulated at 10 × real time" in told
    assert "sciclops.tower2 declared: 20 × pcr96" in told
    assert "wc.output.1 declared: empty" in told


# -- filters --------------------------------------------------------------------------------------


def find_events(log: SqlEventStore, **wanted: Any) -> list[Event]:
    return [event for event, _ in FilteredLog(log, LogFilter(**wanted)).read_matching()]


def positions(log: SqlEventStore, **wanted: Any) -> list[int]:
    return [record.head.position for _, record in FilteredLog(log, LogFilter(**wanted)).read_matching()]


def test_no_filter_shows_everything_in_order(log: SqlEventStore) -> None:
    assert positions(log) == list(range(1, two_users().position + 1))
    assert positions(log, last=3) == list(range(two_users().position - 2, two_users().position + 1))
    assert positions(log, last=0) == []


def test_types_and_families(log: SqlEventStore) -> None:
    assert {e.TYPE for e in find_events(log, types=("labware", "run.started"))} >= {
        "labware.moved",
        "run.started",
    }
    assert {e.TYPE for e in find_events(log, types=("run.started",))} == {"run.started"}
    with pytest.raises(BadInput, match=r"no events of type 'runs'.*'run'"):
        find_events(log, types=("runs",))


def test_a_run_is_found_with_its_plan_and_its_labware(log: SqlEventStore) -> None:
    shown = find_events(log, run="R1")
    assert {"plan.recorded", "run.submitted", "run.completed", "labware.moved"} <= {e.TYPE for e in shown}
    assert all(getattr(event, "run", "R1") == "R1" for event in shown)
    assert len(shown) > 60
    with pytest.raises(NotFound, match="no run 'R9'"):
        find_events(log, run="R9")


def test_a_module_is_found_with_what_stands_at_its_stations(log: SqlEventStore) -> None:
    shown = find_events(log, module="sealer")
    assert positions(log, module="rpl/sealer") == positions(log, module="sealer")
    assert {"labware.moved", "action.requested", "resource.level_set", "station.declared"} <= {
        e.TYPE for e in shown
    }
    assert {getattr(e, "module", "rpl/sealer") for e in shown} == {"rpl/sealer"}
    with pytest.raises(NotFound, match="Did you mean 'sealer'"):
        find_events(log, module="seal")


def test_labware_is_found_with_the_outcome_of_what_was_done_to_it(log: SqlEventStore) -> None:
    kinds = [event.TYPE for event in find_events(log, labware="P1")]
    assert kinds.count("action.requested") == kinds.count("action.succeeded") == 12
    with pytest.raises(NotFound, match="no labware 'P99'"):
        find_events(log, labware="P99")
    assert positions(log, labware="P1", last=2) == positions(log, labware="P1")[-2:]


def test_a_well_is_no_labware(tmp_path: Path, open_log: Open) -> None:
    """P1 is also a well of a plate with 384: a payload that names it is not about the plate."""
    book = Logbook()
    book.furnish()
    book.at(10)
    from labos.core.decide.runs import SubmitRun
    from tests.simulation import mixes

    book.do(SubmitRun(mixes.PLANS["pcr"].plan, "ada", {"well": "P1", "run": "R7"}))
    book.carry_through("R1", steps=1)
    log = open_log(book.save(tmp_path))
    assert "run.submitted" not in {event.TYPE for event in find_events(log, labware="P1")}
    assert "labware.placed" in {event.TYPE for event in find_events(log, labware="P1")}


def test_users_and_times(log: SqlEventStore) -> None:
    bo = find_events(log, user="bo")
    assert {"run.submitted", "action.succeeded", "labware.moved"} <= {event.TYPE for event in bo}
    assert all(getattr(event, "run", "R2") == "R2" for event in bo)
    since, until = START_NS + 300 * SECOND, START_NS + 320 * SECOND
    shown = [
        record.head.recorded_at
        for _, record in FilteredLog(log, LogFilter(since_ns=since, until_ns=until)).read_matching()
    ]
    assert shown
    assert min(shown) >= since
    assert max(shown) < until


def test_later_events_pass_the_same_sieve(log: SqlEventStore) -> None:
    every = positions(log, run="R2", types=("action",))
    sieve = FilteredLog(log, LogFilter(run="R2", types=("action",)))
    half = every[len(every) // 2]
    first = [record.head.position for _, record in sieve.read_matching(half)]
    assert first + [record.head.position for _, record in sieve.read_later(half)] == every


# -- plates and runs ------------------------------------------------------------------------------


def test_the_story_of_a_plate(log: SqlEventStore) -> None:
    story = read_labware_history(log, "P1")
    assert story is not None
    assert [stay.places[0].partition("/")[2] for stay in story.stays] == [
        "sciclops.exchange",
        "ot2_pcr_alpha.deck1_cooler",
        "sealer.default",
        "biometra.default",
        "peeler.default",
        "camera_module.plate_station",
        "wc.output.1",
    ]
    assert story.owner == "user:ada"
    assert story.variables == {"a1": 0, "sealed": False}
    assert all(a.until == b.since for a, b in zip(story.stays, story.stays[1:], strict=False))
    assert story.stays[1].by == "pf400.transfer, R1 #1 'Move to OT-2' (ada)"
    for stay in story.stays:
        record = two_users().records[stay.proof.position - 1]
        assert record.hash.hex() == stay.proof.hash
        assert record.head.recorded_at == stay.since
    assert read_labware_history(log, "P9") is None
    assert read_labware_history(log, "P1", upto=story.stays[2].proof.position).place == "sealer.default"  # type: ignore[union-attr]


def test_uncertain_and_gone_are_said(log: SqlEventStore) -> None:
    book = two_users()
    places = (StationName("rpl/pf400.gripper"), StationName("rpl/wc.output.1"))
    event = LabwareUncertain(LabwareId("P2"), RunId(""), places, "the arm lost it")
    from tests.unit.services.logbook import seal_records

    doubt = seal_records([(500, "rpl/pf400", event)])
    told = fold_histories([*book.records, *doubt], read_catalogue(log))
    assert told["P2"].place == "not known: pf400.gripper or wc.output.1"
    assert list(list_labware_histories(log)) == ["P1", "P2"]


def test_the_story_of_runs(log: SqlEventStore) -> None:
    told = run_histories(log)
    assert [(r.id, r.user, r.status, r.done) for r in told.values()] == [
        ("R1", "ada", "completed", 14),
        ("R2", "bo", "active", 5),
    ]
    one = run_history(log, "R1")
    assert msgspec.to_builtins(one) == msgspec.to_builtins(told["R1"])
    assert [step.ended_at - step.requested_at for step in one.steps if step.state != "asleep"] == [
        10 * SECOND
    ] * 14
    assert {step.state for step in told["R2"].steps[5:14]} == {"pending"}


def test_a_failed_step_bears_its_error(tmp_path: Path, open_log: Open) -> None:
    book = Logbook()
    book.furnish()
    book.submit("pcr")
    book.carry_through("R1", seconds=5, steps=4)
    action = book.start("R1", 4)
    book.finish(action, succeeded=False, effects="none", error="no foil")
    run = run_history(open_log(book.save(tmp_path)), "R1")
    assert (run.status, run.steps[4].state, run.steps[4].error) == ("failed", "failed", "no foil")
    assert "no foil" in run.why


def test_each_kind_of_suggestion_has_its_sentence() -> None:
    def say(steps: tuple[Suggested, ...], line: tuple[RunId, ...]) -> str:
        event = OrderSuggested("rpl", "planner", 1, steps, line)
        head = Envelope("lab", 1, "id", event.stream(), 1, event.TYPE, 1, 1, "ada", "", "", "")
        return describe(event, head)

    run = RunId("R1")
    assert "planner suggests an order for 1 steps in rpl" in say((Suggested(run, 0, 1),), ())
    assert "planner suggests an order of 2 runs in rpl to begin with" in say((), (run, RunId("R2")))
    assert "planner suggests no order in rpl any more" in say((), ())

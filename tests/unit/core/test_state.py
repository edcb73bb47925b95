"""Pictures of a state, and what must always hold of one."""

from __future__ import annotations

import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec
import pytest

from labos.core import state as state_code
from labos.core.decide.nodes import LoseNode
from labos.core.effects import Move
from labos.core.ids import ActionId, LabwareId, Owner, StationName
from labos.core.invariants import find_broken
from labos.core.model import ActionSpec, Description
from labos.core.modules import Flight
from labos.core.runs import StepState
from labos.core.state import (
    LabState,
    encode_picture,
    fingerprint_folder,
    fold_fingerprint,
    from_picture,
    hash_state,
)
from labos.planning.waiting import find_head
from tests.support.bench import (
    Driver,
    move,
    order,
    plan,
    refold,
    route,
    sets,
    small,
    step,
    stream_faults,
    take,
)

SHOW_BEFORE_AND_AFTER_AN_UPGRADE = """
from pathlib import Path
from labos.core import fold, state
print(state.fold_fingerprint())
with Path(fold.__file__).open("a") as file:
    file.write("# another version")
print(state.fold_fingerprint())
"""


def lively() -> Driver:
    """A state with something in every slice."""
    lab = small()
    name = lab.experiment(closing=route("a", "trash"), request="e")
    lab.step(lab.submit(route("stack", "a"), experiment=name, request="r"))
    lab.submit(plan(step("dev"), files={"f": "d"}), user="bob", priority=2)
    run = lab.submit(route("stack", "b", "c"))
    lab.step(run)
    lab.doubt(lab.start(run, 1))
    lab.start(lab.submit(plan(step("dev", sets("lid", "closed"), action="close"))))
    lab.fail(lab.start(lab.submit(route("stack", "hotel", arm="arm2"))))
    return lab


def test_a_picture_is_the_state() -> None:
    lab = lively()
    assert find_broken(lab.state) == ""
    back = from_picture(encode_picture(lab.state))
    assert back == lab.state
    assert order(back) == order(lab.state)
    assert encode_picture(back) == encode_picture(lab.state)
    assert hash_state(back) == hash_state(lab.state)
    assert len(hash_state(back)) == 64
    assert from_picture(encode_picture(LabState())) == LabState()


def test_a_picture_keeps_who_came_first() -> None:
    """R10 does not overtake R2 because a kernel was restarted."""
    lab = small()
    for _ in range(12):
        lab.submit(plan(step("dev")))
    state = from_picture(encode_picture(lab.state))
    (group,) = state.runs.queue
    assert list(state.runs.queue[group]) == [f"R{n}" for n in range(1, 13)]
    lab.keep_picture()
    for _ in range(3):
        lab.step(find_head(lab.state, group).id)
    assert list(lab.state.runs.queue[group]) == [f"R{n}" for n in range(4, 13)]
    lab.check_log()


def test_what_is_no_picture_is_refused() -> None:
    with pytest.raises(msgspec.MsgspecError):
        from_picture(b"\xc1")
    with pytest.raises(msgspec.MsgspecError):
        from_picture(msgspec.msgpack.encode({"position": "seven"}))


def test_a_log_folds_the_same_from_every_picture() -> None:
    lab = small()
    pictures = {}
    for number in range(3):
        run = lab.submit(route("stack", "a", "trash"), request=f"k{number}")
        for index in (0, 1):
            lab.keep_picture()
            lab.step(run, index)
        pictures[lab.state.position] = encode_picture(lab.state)
    lab.check_log()
    assert len(lab.pictures) == 6


def test_the_fingerprint_is_of_the_code_that_runs(tmp_path: Path) -> None:
    """Also when an upgrade replaces the files of a running process: its snapshots are of the older code."""
    core = Path(state_code.__file__).parent
    shutil.copytree(core.parent, tmp_path / "labos", ignore=shutil.ignore_patterns("__pycache__"))
    shown = subprocess.run(
        [sys.executable, "-c", SHOW_BEFORE_AND_AFTER_AN_UPGRADE], cwd=tmp_path, capture_output=True, text=True
    )
    assert shown.stdout.split() == [fold_fingerprint()] * 2, shown.stderr
    assert fingerprint_folder(tmp_path / "labos" / "core") != fold_fingerprint()


def test_streams_end_and_are_not_remembered() -> None:
    lab = small()
    before = set(lab.state.versions)
    name = lab.experiment()
    run = lab.submit(route("stack", "a", "trash"), experiment=name)
    assert {run, name} <= set(lab.state.versions)
    lab.step(run)
    lab.step(run, 1)
    lab.end(name)
    assert set(lab.state.versions) == before
    assert lab.state.runs.active == lab.state.shares.users == {}


def test_the_checker_of_streams_sees_a_stream_that_goes_on_after_its_end() -> None:
    lab = small()
    lab.step(lab.submit(plan(step("dev"))))
    assert stream_faults(lab.log) == []
    again = msgspec.structs.replace(lab.log[-1], version=1)
    assert stream_faults([*lab.log, again])


def test_an_event_that_contradicts_the_state_is_no_event() -> None:
    lab = small()
    lab.step(lab.submit(plan(step("dev"))))
    with pytest.raises(KeyError):
        refold(lab.log[-1:], lab.state)


def test_a_module_may_be_known_by_an_action_alias() -> None:
    description = Description("d", "1", "x", actions=(ActionSpec("seal", aliases=("close",)),))
    assert description.action("close") is description.action("seal") is not None
    assert description.action("open") is None


# -- invariants -------------------------------------------------------------------------------------


def station_of(state: LabState, name: str) -> Any:
    return state.bench.stations[StationName(f"cell/{name}")]


def expects_less_than_nothing(state: LabState) -> None:
    station_of(state, "c").expected = -1


def overfill(state: LabState) -> None:
    station_of(state, "b").stock = ["plate"] * 2
    station_of(state, "b").lots = [""] * 2


def not_knowing(state: LabState) -> None:
    station_of(state, "dev.n1").labware = [LabwareId("P1")]


def in_two_minds(state: LabState) -> None:
    state.bench.labware[LabwareId("P1")].maybe = (StationName("cell/c"),)


def nowhere(state: LabState) -> None:
    station_of(state, "a").labware.clear()
    state.bench.labware[LabwareId("P1")].station = StationName("")


def list_missing(state: LabState) -> None:
    station_of(state, "a").labware.clear()


def set_unknown_carrier(state: LabState) -> None:
    state.bench.labware[LabwareId("P1")].moving = "A99"


def set_unknown_owner(state: LabState) -> None:
    state.bench.labware[LabwareId("P1")].owner = Owner("user:eve")


def twice_at_work(state: LabState) -> None:
    module = next(m for m in state.modules.by_name.values() if m.in_flight)
    module.in_flight[ActionId("A98")] = Flight(True)


def at_work_on_nothing(state: LabState) -> None:
    state.modules.by_name["cell/cam"].in_flight[ActionId("A97")] = Flight(False)  # type: ignore[index]


def reserves_nothing(state: LabState) -> None:
    state.bench.reserved.clear()


def on_no_module(state: LabState) -> None:
    action = next(iter(state.actions.open.values()))
    action.module = "cell/gone"  # type: ignore[assignment]
    state.modules.by_name["cell/arm"].in_flight.clear()  # type: ignore[index]


def without_plan(state: LabState) -> None:
    state.runs.plans = {}


def miscount(state: LabState) -> None:
    next(iter(state.runs.active.values())).steps.append(StepState())


def out_of_the_queue(state: LabState) -> None:
    state.runs.queue.clear()


@pytest.mark.parametrize(
    ("damage", "sentence"),
    [
        (expects_less_than_nothing, "cell/c expects -1 arrivals"),
        (overfill, "cell/b holds 3 of 1"),
        (not_knowing, "P1 stands at cell/dev.n1 but knows nothing of it"),
        (in_two_minds, "P1 is both at cell/a and uncertain"),
        (nowhere, "P1 is nowhere"),
        (list_missing, "P1 is not exactly once at cell/a"),
        (set_unknown_carrier, "P1 is moved by A99, which is not open"),
        (set_unknown_owner, "P1 is missing among what user:eve owns"),
        (twice_at_work, "carries out two exclusive actions at once"),
        (at_work_on_nothing, "cell/cam is busy with A97, which is not open"),
        (reserves_nothing, "is open but reserves nothing"),
        (on_no_module, "which does not exist"),
        (without_plan, "has lost its plan"),
        (miscount, "counts its steps wrongly"),
        (out_of_the_queue, "1 runs wait, but 0 stand in the queue"),
    ],
)
def test_each_invariant_is_seen_when_it_breaks(damage: Callable[[LabState], None], sentence: str) -> None:
    lab = small()
    lab.stock("a", 1)
    lab.submit(plan(step("dev")))
    run = lab.submit(plan(step("arm", take("stack", "b")), step("arm", move("b", "c"))))
    lab.step(run)
    lab.start(run, 1)
    assert find_broken(lab.state) == ""
    damage(lab.state)
    assert sentence in find_broken(lab.state)


def test_a_node_that_is_lost_breaks_nothing() -> None:
    lab = lively()
    for name in list(lab.state.modules.by_name):
        lab.do(LoseNode(name, "i1", "power cut"))
    assert isinstance(lab.state.actions.open[ActionId("A3")].effects[0], Move)
    lab.check_log()


@pytest.mark.parametrize("number", [2**70, -(2**64)])
def test_a_log_of_before_64_bits_were_the_limit_still_has_its_picture(number: int) -> None:
    state = lively().state
    state.versions["old"] = number
    again = from_picture(encode_picture(state))
    assert again.versions["old"] == number
    assert again == state
    assert hash_state(again) == hash_state(state)

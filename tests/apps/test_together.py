"""All five applications of four users at the same time on one lab with four workcells; and a small version of
it. Whatever is killed, everything is done once, and every sink has every event."""

from __future__ import annotations

from pathlib import Path

import pytest

from labos.node.world import World
from tests.apps.together.kills import WHAT, Kill, plan_of
from tests.apps.together.programs import FIVE, POLYMERS, TWO_PICKERS
from tests.apps.together.scenario import run_together
from tests.apps.together.sinks import twice
from tests.apps.together.truth import check_wells
from tests.integration.audit.logs import golden
from tests.support.foreign import java_libraries_of, python_of
from tests.support.needed import need

SPEED = 1500.0
EVENTS = 1000
"""About so many events five applications make after the last of them has begun."""


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_two_applications_of_two_users_go_on_when_the_kernel_and_one_of_them_are_killed(
    tmp_path: Path,
) -> None:
    apps = [TWO_PICKERS, POLYMERS._replace(payload={"saturated": "thinner", "tolerance": 3.0})]
    kills = [Kill("application", 20, 0), Kill("kernel", 60)]
    found = run_together(tmp_path, apps, speed=3000.0, kills=kills)
    assert found.not_killed == []
    assert found.lives == {"color_picker": 2, "polymers": 1}


@pytest.fixture
def foreign() -> None:
    """A beamline and a broker."""
    need("aioca", "epics")
    need("confluent_kafka", "kafka")
    python_of("epics")
    java_libraries_of("kafka")


@pytest.mark.full
@pytest.mark.timeout(1800)
@pytest.mark.usefixtures("foreign")
def test_five_applications_of_four_users_at_the_same_time(tmp_path: Path) -> None:
    found = run_together(tmp_path, FIVE, speed=SPEED, kafka=True)
    assert set(found.lives.values()) == {1}
    assert found.together > 0
    assert (found.asked, found.sent_twice) == ([], {"file": 0, "topic": 0})


@pytest.mark.full
@pytest.mark.timeout(1800)
@pytest.mark.usefixtures("foreign")
@pytest.mark.parametrize("seed", range(1, 7))
def test_kernel_application_worker_and_broker_are_killed(tmp_path: Path, seed: int) -> None:
    """With odd seeds nodes live on when the kernel is killed, else they end with it."""
    kills = plan_of(seed, WHAT, EVENTS, times=1 + seed // 4)
    found = run_together(tmp_path, FIVE, speed=SPEED, kills=kills, detach=bool(seed % 2), kafka=True)
    assert found.not_killed == []
    assert found.together > 0
    assert sum(found.lives.values()) == len(FIVE) + 1 + seed // 4


# -- the checks see what is wrong ------------------------------------------------------------------


def test_a_well_that_is_mixed_twice_is_seen() -> None:
    world = World()
    world.stock("deck", "plate96")
    world.work("ot2", "pipette", "deck", wells=["A1", "A2"])
    world.work("ot2", "pipette", "deck", wells=["A3"])
    assert check_wells(world, "rpl") == 3
    world.work("ot2", "pipette", "deck", wells=["A2"])
    with pytest.raises(AssertionError, match=r"rpl: mixed again: .*'A2'"):
        check_wells(world, "rpl")


def test_an_event_that_is_missing_or_out_of_order_or_another_one_is_seen() -> None:
    records = golden("simulated-1")[:5]
    told = [{"position": r.head.position, "hash": r.hash.hex()} for r in records]
    assert twice("file", told, records) == 0
    assert twice("file", [*told[:3], *told[1:]], records) == 2
    for wrong, why in (
        (told[:2] + told[3:], "position 4 stands where 3 should be"),
        ([told[1], told[0], *told[2:]], "position 2 stands where 1 should be"),
        (told[:4], "ends at 4"),
        ([*told, {**told[0], "hash": "00"}], "1 differs"),
    ):
        with pytest.raises(AssertionError, match=why):
            twice("file", wrong, records)


def test_a_plan_kills_each_in_the_middle_and_is_the_same_again() -> None:
    plan = plan_of(3, WHAT, 1000, times=2)
    assert plan == plan_of(3, WHAT, 1000, times=2)
    assert sorted(kill.what for kill in plan) == sorted([*WHAT, "kernel", "application", "broker"])
    assert all(50 <= kill.at <= 700 for kill in plan if kill.what != "worker")

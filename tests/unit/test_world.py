"""The simulated bench itself."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from labos.node import Crash, World


@pytest.fixture
def world() -> Iterator[World]:
    world = World()
    yield world
    world.close()


def elsewhere(path: Path, code: str) -> subprocess.Popen[str]:
    """Another process that opens the same bench."""
    program = f"from labos.node import Crash, World\nworld = World({str(path)!r})\n{code}\nworld.close()\n"
    return subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE, text=True)


def output(process: subprocess.Popen[str]) -> str:
    said, _ = process.communicate(timeout=60)
    assert process.returncode == 0
    return said.strip()


def test_a_plate_goes_through_a_hand(world: World) -> None:
    (plate,) = world.stock("a", "pcr")
    assert world.kind(plate) == "pcr"
    assert world.grip("arm", "a") == plate
    assert world.list_contents() == {"hand:arm": [plate]}
    assert world.release("arm", "b") == plate
    assert world.list_contents() == {"b": [plate]}
    assert [motion.verb for motion in world.motions()] == ["stock", "grip", "release"]


def test_a_stack_gives_its_topmost_plate(world: World) -> None:
    world.furnish("tower", 3)
    first, second = world.stock("tower", "pcr", 2)
    assert world.grip("arm", "tower") == second
    world.release("arm", "tower")
    assert world.at("tower") == [first, second]


def test_accidents_are_told_and_remembered(world: World) -> None:
    with pytest.raises(Crash, match="empty air"):
        world.grip("arm", "a")
    with pytest.raises(Crash, match="releases nothing"):
        world.release("arm", "a")
    with pytest.raises(Crash, match="discards nothing"):
        world.discard("arm", "bin")
    world.stock("a", "pcr")
    world.stock("b", "pcr")
    world.grip("arm", "a")
    with pytest.raises(Crash, match="full hand"):
        world.grip("arm", "b")
    with pytest.raises(Crash, match="plate on a plate"):
        world.release("arm", "b")
    with pytest.raises(Crash, match="not there"):
        world.work("sealer", "seal", "a")
    with pytest.raises(Crash, match="spills"):
        world.crash("pump", "deck", "spills")
    assert len(world.crashes()) == 7
    assert world.at("hand:arm"), "a crash takes nothing out of the hand"


def test_a_shut_gate_keeps_hands_out(world: World) -> None:
    world.stock("block", "pcr")
    world.gate("cycler", "block", shut=True)
    assert world.is_shut("block")
    with pytest.raises(Crash, match="closed gate"):
        world.grip("arm", "block")
    world.gate("cycler", "block", shut=False)
    assert not world.is_shut("block")
    world.grip("arm", "block")


def test_waste_ends_a_plate(world: World) -> None:
    (plate,) = world.stock("a", "pcr")
    world.grip("arm", "a")
    assert world.discard("arm", "bin") == plate
    assert world.list_contents() == {}


def test_what_was_done_to_a_plate_last(world: World) -> None:
    (plate,) = world.stock("a", "pcr")
    assert world.last(plate, "seal", "peel") == ""
    world.work("sealer", "seal", "a")
    assert world.last(plate, "seal", "peel") == "seal"
    world.work("peeler", "peel", "a")
    world.carry(plate, "b")
    assert world.last(plate, "seal", "peel") == "peel"


def test_a_place_is_furnished_or_holds_one(world: World) -> None:
    assert not world.is_furnished("tower")
    world.furnish("tower", 2)
    assert world.is_furnished("tower")
    for _ in range(2):
        world.stock("a", "pcr")
        world.grip("arm", "a")
        world.release("arm", "tower")
    assert len(world.at("tower")) == 2


def test_a_file_outlives_its_process(tmp_path: Path) -> None:
    path = tmp_path / "bench.db"
    assert output(elsewhere(path, "world.stock('a', 'pcr'); print(world.grip('arm', 'a'))")) == "plate1"
    world = World(str(path))
    assert world.list_contents() == {"hand:arm": ["plate1"]}
    assert world.kind("plate1") == "pcr"
    world.close()


def test_two_processes_share_one_bench(tmp_path: Path) -> None:
    path = tmp_path / "bench.db"
    here = World(str(path))
    (plate,) = here.stock("a", "pcr")
    here.gate("cycler", "block", shut=True)
    taken = elsewhere(
        path,
        "print(world.grip('arm', 'a'))\n"
        "try:\n    world.release('arm', 'block')\n"
        "except Crash as crash:\n    print(crash)",
    )
    assert output(taken).splitlines() == [plate, "arm reaches into a closed gate at block"]
    assert here.list_contents() == {"hand:arm": [plate]}
    assert len(here.crashes()) == 1
    here.gate("cycler", "block", shut=False)
    assert output(elsewhere(path, "print(world.release('arm', 'block'))")) == plate
    assert here.at("block") == [plate]
    here.close()


def test_processes_at_once_lose_nothing(tmp_path: Path) -> None:
    path = tmp_path / "bench.db"
    here = World(str(path))
    for arm in range(3):
        here.stock(f"a{arm}", "pcr")
    rounds = 50
    arms = [
        elsewhere(
            path,
            f"for _ in range({rounds}):\n"
            f"    for start, end in (('a{arm}', 'b{arm}'), ('b{arm}', 'a{arm}')):\n"
            f"        world.grip('arm{arm}', start); world.release('arm{arm}', end)",
        )
        for arm in range(3)
    ]
    for process in arms:
        output(process)
    motions = here.motions()
    assert [motion.seq for motion in motions] == list(range(1, 3 + 3 * rounds * 4 + 1))
    assert {place: len(plates) for place, plates in here.list_contents().items()} == {
        "a0": 1,
        "a1": 1,
        "a2": 1,
    }
    here.close()

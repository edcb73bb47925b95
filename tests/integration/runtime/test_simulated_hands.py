"""On a simulated bench a person's doing is carried out when it is on disk, and not before."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Sequence
from pathlib import Path
from typing import Any

import pytest

from labos.bootstrap._hands import SimulatedHands
from labos.clock import SystemClock, Uuid7Ids
from labos.core.decide.access import EndAccess, ReportedChange, RequestAccess
from labos.core.decide.lab import ApplyWorkcell, DeclareStation
from labos.core.decide.observation import ObserveStation
from labos.core.decide.stock import LoadStation, Replenish, UnloadStation
from labos.core.envelope import Record
from labos.core.ids import ModuleName, StationName
from labos.errors import StoreUnavailable
from labos.node.world import World
from labos.ports import EventStore, Head
from labos.runtime.kernel import Kernel
from labos.runtime.kernel_log import KernelSettings
from labos.runtime.ledger import Entry
from labos.runtime.writer import ThreadWriter
from labos.store import open_store
from tests.integration.bus.contract import until
from tests.support.bench import full, module, station, workcell

A, B, STACK = (StationName(full(name)) for name in ("a", "b", "stack"))
DEV = ModuleName(full("dev"))
CELL = workcell(
    [module("dev", levels={"tips": 10.0})], [station("a"), station("b"), station("stack", "stack", 9)]
)


class Flaky:
    """A store whose next commit fails: before anything is on disk, or after all of it is (``in_doubt``)."""

    def __init__(self, store: EventStore) -> None:
        self._store = store
        self.fails = False
        self.in_doubt = False

    def append(self, expected: Head, records: Sequence[Record]) -> Head:
        if self.fails:
            self.fails = False
            raise StoreUnavailable("The connection broke before the commit.")
        done = self._store.append(expected, records)
        if self.in_doubt:
            self.in_doubt = False
            raise StoreUnavailable("The connection broke during the commit.")
        return done

    def __getattr__(self, name: str) -> Any:
        return getattr(self._store, name)


class Witness:
    """Hears of commits behind the hands, as the dispatcher does; notes what stands on the bench then."""

    def __init__(self, world: World) -> None:
        self._world = world
        self.seen: list[dict[str, list[str]]] = []

    def on_committed(self, entries: Sequence[Entry]) -> None:
        self.seen.append(self._world.list_contents())

    def on_reopened(self) -> None:
        pass


Work = Callable[[Kernel, World, Flaky], Awaitable[None]]


def on_a_bench(path: Path, work: Work) -> World:
    world = World()

    async def main() -> None:
        store = open_store(f"sqlite:///{path}/labos.db")
        flaky = Flaky(store)
        kernel = Kernel(ThreadWriter(flaky), SystemClock(), Uuid7Ids(), KernelSettings())  # type: ignore[arg-type]
        try:
            await kernel.open()
            kernel.listeners.append(SimulatedHands(lambda _: world, store, kernel.state))
            await kernel.execute(ApplyWorkcell(CELL), "ada")
            for place in (A, B):
                await kernel.execute(DeclareStation(place), "ada")
            await kernel.execute(DeclareStation(STACK, ("plate", "plate")), "ada")
            await work(kernel, world, flaky)
            assert not kernel.failed.done()
            assert not kernel.faults
        finally:
            await kernel.close()
            store.close()

    asyncio.run(main())
    return world


async def is_open(kernel: Kernel, position: int) -> None:
    def has_arrived() -> bool:
        try:
            return kernel.state.position >= position
        except StoreUnavailable:
            return False

    await until(has_arrived, 10.0)


def test_a_bench_is_furnished_and_filled_as_declared(tmp_path: Path) -> None:
    async def nothing(kernel: Kernel, world: World, store: Flaky) -> None:
        pass

    world = on_a_bench(tmp_path, nothing)
    assert world.list_contents() == {"stack": ["plate1", "plate2"]}
    assert world.find_level("dev", "tips") == 10.0


def test_hands_do_nothing_of_a_batch_whose_commit_failed(tmp_path: Path) -> None:
    async def work(kernel: Kernel, world: World, store: Flaky) -> None:
        before, position = world.motions(), kernel.durable
        for command in (
            LoadStation(A, "plate", 1),
            UnloadStation(STACK, "ada"),
            DeclareStation(STACK, ("plate",) * 5),
        ):
            store.fails = True
            with pytest.raises(StoreUnavailable):
                await kernel.execute(command, "ada")
            await is_open(kernel, position)
            assert world.motions() == before
            assert kernel.durable == position
        await kernel.execute(LoadStation(A, "plate", 1), "ada")
        assert world.at("a") == ["plate3"]

    on_a_bench(tmp_path, work)


def test_hands_do_once_what_turns_out_to_be_on_disk(tmp_path: Path) -> None:
    async def work(kernel: Kernel, world: World, store: Flaky) -> None:
        position, store.in_doubt = kernel.durable, True
        with pytest.raises(StoreUnavailable):
            await kernel.execute(LoadStation(A, "plate", 1), "ada")
        await is_open(kernel, position + 1)
        await until(lambda: world.at("a") == ["plate3"], 10.0)
        await kernel.execute(LoadStation(B, "plate", 1), "ada")
        assert (world.at("a"), world.at("b")) == (["plate3"], ["plate4"])

    on_a_bench(tmp_path, work)


def test_the_bench_is_ready_before_anybody_else_hears_of_it(tmp_path: Path) -> None:
    async def work(kernel: Kernel, world: World, store: Flaky) -> None:
        witness = Witness(world)
        kernel.listeners.append(witness)
        await kernel.execute(LoadStation(A, "plate+lid", 1), "ada")
        assert witness.seen == [
            {"a": ["plate3"], "lid:plate3": ["lid of plate3"], "stack": ["plate1", "plate2"]}
        ]

    on_a_bench(tmp_path, work)


def test_what_is_taken_away_is_what_the_log_means(tmp_path: Path) -> None:
    async def work(kernel: Kernel, world: World, store: Flaky) -> None:
        await kernel.execute(LoadStation(A, "plate", 1), "ada")
        await kernel.execute(UnloadStation(STACK, "ada", count=1), "ada")
        assert world.list_contents() == {"a": ["plate3"], "stack": ["plate1"]}
        await kernel.execute(UnloadStation(A, "ada"), "ada")
        assert world.list_contents() == {"stack": ["plate1"]}
        world.use("dev", "tips", 4.0)
        await kernel.execute(Replenish(DEV, "tips", 10.0, instead=True), "ada")
        assert world.find_level("dev", "tips") == 10.0

    on_a_bench(tmp_path, work)


def test_who_only_looks_moves_nothing(tmp_path: Path) -> None:
    async def work(kernel: Kernel, world: World, store: Flaky) -> None:
        await kernel.execute(LoadStation(A, "plate", 1), "ada")
        before = world.motions()
        await kernel.execute(ObserveStation(A, "ada", 0), "ada")
        assert world.motions() == before

    on_a_bench(tmp_path, work)


def test_what_somebody_who_reaches_in_has_changed_is_changed(tmp_path: Path) -> None:
    async def work(kernel: Kernel, world: World, store: Flaky) -> None:
        await kernel.execute(LoadStation(A, "plate", 1), "ada")
        await kernel.execute(RequestAccess("cell", "ada"), "ada")
        changes = (ReportedChange(B, "P1"), ReportedChange(A, "tube"))
        await kernel.execute(EndAccess("cell", "ada", "", changes), "ada")
        assert world.list_contents() == {"a": ["plate4"], "b": ["plate3"], "stack": ["plate1", "plate2"]}

    on_a_bench(tmp_path, work)

"""Steps a second while many follow the log: nobody is kept waiting because others watch.

The limit is the same lab in the same run without followers. Followers are in a process of their own, as
people's programs are, and get every event.
"""

from __future__ import annotations

import asyncio
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from contextlib import AsyncExitStack
from pathlib import Path

from labos.clock import Clock
from labos.core.ids import ModuleName
from labos.core.model import Description
from labos.http.feed import Feed
from labos.http.identity import Gate
from labos.http.server import HttpServer, Listening
from labos.http.service import LabService
from labos.http.viewers import Viewers
from labos.http.views import Supervised
from labos.node.world import World
from labos.ports import BlobStore
from labos.services.accounts import Accounts
from labos.store import open_accounts, open_blobs
from tests.benchmarks.figures import Figure, Report, median, scratch, spread, times
from tests.benchmarks.idle_lab import IdleLab, idle_lab

MUST = 0.9


class Parts:
    """What the HTTP service stands on, of an idle lab."""

    simulated = False
    supervised: Supervised | None = None
    descriptions: Mapping[str, Description] = {}
    broken_drivers: Mapping[str, str] = {}

    def __init__(self, lab: IdleLab, folder: Path) -> None:
        self.kernel, self.bus, self.registry, self.store = lab.kernel, lab.bus, lab.registry, lab.store
        self.blobs: BlobStore = open_blobs(folder / "blobs")
        self.clock: Clock = lab.kernel.clock

    def world(self, workcell: str) -> World:
        raise NotImplementedError

    def follow_workcells(self, changed: Sequence[ModuleName] = ()) -> None:
        """Nobody changes them."""


async def rate(lab: IdleLab, steps: int) -> tuple[float, float]:
    """Steps a second, and the kernel's processor time for each, in ms."""
    wanted = lab.ends.actions + lab.modules * steps
    began, cpu = time.perf_counter(), time.process_time()
    for module in range(lab.modules):
        lab.submit(module, steps)
    await lab.ends.until(lambda: lab.ends.actions >= wanted, 240.0)
    done = lab.modules * steps
    return done / (time.perf_counter() - began), (time.process_time() - cpu) / done * 1e3


class Followers:
    """So many of them, as long as the block lasts; ``counts`` are the events that the slowest and the
    quickest of them got."""

    def __init__(self, url: str, count: int, after: int) -> None:
        argv = [sys.executable, "-m", "tests.benchmarks.follower_process", url, str(count), str(after)]
        self._process = subprocess.Popen(argv, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        self.counts = ""

    async def __aenter__(self) -> Followers:
        assert self._process.stdout is not None
        assert "ready" in await asyncio.to_thread(self._process.stdout.readline)
        return self

    async def __aexit__(self, *error: object) -> None:
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        await asyncio.sleep(1.5)  # what is under way comes in
        self._process.stdin.close()
        self.counts = (await asyncio.to_thread(self._process.stdout.readline)).strip()
        self._process.stdout.close()
        await asyncio.to_thread(self._process.wait, 20)


async def measure_in(folder: Path, rounds: int, modules: int, steps: int, numbers: Sequence[int]) -> Report:
    ratios: dict[int, list[float]] = {number: [] for number in numbers}
    rates: dict[int, list[float]] = {number: [] for number in (0, *numbers)}
    cpus: dict[int, list[float]] = {number: [] for number in (0, *numbers)}
    notes: list[str] = []
    async with idle_lab(folder, modules) as lab, AsyncExitStack() as stack:
        feed = Feed()
        lab.kernel.listeners.append(feed)
        url = f"sqlite:///{folder}/labos.db"
        store = open_accounts(url)
        stack.callback(store.close)
        accounts = Accounts(store, lab.kernel.clock, lambda user: False)
        service = LabService(Parts(lab, folder), feed, Viewers(url))
        http = HttpServer(service, Gate(accounts, lambda: lab.kernel.state.users), Listening())
        await http.start()
        stack.push_async_callback(http.close)
        lab.keep_plans(steps)
        await rate(lab, 2)
        for _ in range(rounds):
            alone, cpu = await rate(lab, steps)
            rates[0].append(alone)
            cpus[0].append(cpu)
            for number in numbers:
                before = lab.kernel.durable
                async with Followers(http.url, number, before - 1) as followers:
                    seen, cpu = await rate(lab, steps)
                    written = lab.kernel.durable - before
                rates[number].append(seen)
                cpus[number].append(cpu)
                ratios[number].append(seen / alone)
                notes.append(
                    f"{number} followers: {seen:.0f} steps/s of {alone:.0f}; of {written} events the slowest "
                    f"and the quickest got {followers.counts}"
                )
    figures = [
        Figure(
            f"steps/s with {number} followers of every event",
            f"{median(rates[number]):.0f}/s, {median(cpus[number]):.1f} ms of processor each",
            f"{median(rates[0]):.0f}/s, {median(cpus[0]):.1f} ms (alone)",
            times(median(ratios[number])),
            f"≥ {MUST} ×",
            median(ratios[number]) >= MUST,
        )
        for number in numbers
    ]
    notes += [f"ratios of {rounds} rounds, {n} followers: {spread(ratios[n])}" for n in numbers]
    return Report(figures, notes)


def measure(
    rounds: int = 3, modules: int = 1, steps: int = 400, numbers: Sequence[int] = (50, 300)
) -> Report:
    with scratch("viewers") as folder:
        return asyncio.run(measure_in(folder, rounds, modules, steps, numbers))


def smoke() -> Report:
    return measure(1, 1, 5, (3,))

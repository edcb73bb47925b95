"""Steps a second while many follow the log: nobody is kept waiting because others watch.

The limit is the same lab in the same run without followers. Followers are in a process of their own, as
people's programs are, and get every event. A second figure is that of a lab behind API processes, with many
queued runs and somebody who sends odd requests.
"""

from __future__ import annotations

import asyncio
import os
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import AsyncExitStack, contextmanager
from pathlib import Path

from labos.bootstrap._desk import make_api_key
from labos.clock import Clock
from labos.core.decide.control import PauseStarts
from labos.core.ids import ModuleName
from labos.core.model import Description
from labos.http.desk import Desk
from labos.http.feed import Feed
from labos.http.identity import Gate
from labos.http.letters import Letters
from labos.http.parts import Supervised
from labos.http.server import HttpServer, Listening
from labos.http.service import LabService
from labos.http.viewers import Viewers
from labos.node.protocol import Keys
from labos.node.world import World
from labos.ports import BlobStore
from labos.services.accounts import Accounts
from labos.settings import Settings, free_port
from labos.store import open_accounts, open_blobs
from tests.benchmarks.figures import Figure, Report, median, scratch, spread, times
from tests.benchmarks.idle_lab import IdleLab, idle_lab, module_name

MUST = 0.9


class Parts:
    """What the HTTP service stands on, of an idle lab."""

    simulated = False
    supervised: Supervised | None = None
    descriptions: Mapping[str, Description] = {}
    broken_drivers: Mapping[str, str] = {}
    log_check = None

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


CORES = sorted(os.sched_getaffinity(0)) if sys.platform == "linux" else []
OURS, THEIRS = CORES[: len(CORES) // 2], CORES[len(CORES) // 2 :]
BUSY_S = 2.0
OTHERS = (*(("taskset", "-c", ",".join(map(str, THEIRS))) if OURS else ()), "nice", "-n", "15")
"""What stands on other computers in an installation that needs API processes has half of this one's
processors; the kernel and its nodes have the other half, with and without them. Nothing else should run
meanwhile."""


class Followers:
    """So many of them, as long as the block lasts; ``counts`` are the events that the slowest and the
    quickest of them got."""

    def __init__(self, url: str, count: int, after: int, *, elsewhere: bool = False) -> None:
        argv = [
            *(OTHERS if elsewhere else ()),
            sys.executable,
            "-m",
            "tests.benchmarks.follower_process",
            url,
            str(count),
            str(after),
        ]
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


class Helper:
    """A process beside the lab, from its first word to its last."""

    def __init__(self, *argv: str) -> None:
        self._argv = [*OTHERS, sys.executable, "-m", *argv]
        self.said = ""

    async def __aenter__(self) -> Helper:
        self._process = await asyncio.to_thread(
            subprocess.Popen, self._argv, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        assert self._process.stdout is not None
        assert await asyncio.to_thread(self._process.stdout.readline), self._argv
        return self

    async def __aexit__(self, *error: object) -> None:
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.close()
        try:
            self.said = (await asyncio.wait_for(asyncio.to_thread(self._process.stdout.read), 5.0)).strip()
        except TimeoutError:
            self._process.terminate()
        await asyncio.to_thread(self._process.wait, 20)
        self._process.stdout.close()


def settle(busy_s: float) -> None:
    """Be busy for a while: on a loaded machine the system moves others' work away from the processor."""
    end = time.perf_counter() + busy_s
    while time.perf_counter() < end:
        pass


async def measure_api_in(folder: Path, rounds: int, steps: int, queued: int, number: int) -> Report:
    """Two API processes of a lab, of which each serves half of the followers."""
    rates: dict[str, list[float]] = {name: [] for name in ("alone", "queued", "quiet", "all")}
    cpus: dict[str, list[float]] = {name: [] for name in rates}

    async def note_rate(name: str) -> None:
        settle(BUSY_S if rounds > 1 else 0.0)
        seen, cpu = await rate(lab, steps)
        rates[name].append(seen)
        cpus[name].append(cpu)

    notes: list[str] = []
    async with idle_lab(folder, 2) as lab, AsyncExitStack() as stack:
        lab.modules = 1  # what is measured; the other one has a queue, and does not work
        url = f"sqlite:///{folder}/labos.db"
        store = open_accounts(url)
        stack.callback(store.close)
        accounts = Accounts(store, lab.kernel.clock, lambda user: False)
        service = LabService(Parts(lab, folder), Feed())
        http = HttpServer(service, Gate(accounts, lambda: lab.kernel.state.users), Listening())
        stack.push_async_callback(http.close)
        settings = Settings.make(folder, url)
        desk = Desk(http.app, service, Letters(make_api_key(settings), lab.kernel.clock))
        keys = Keys(lab.kernel.lab).requests_of("*", lab.kernel.epoch)
        await lab.bus.serve_all(keys, desk.on_question)
        await lab.kernel.execute(PauseStarts(module_name(1), "ada", "a queue"), "ada")
        lab.keep_plans(steps)
        await rate(lab, 2)
        for _ in range(rounds):
            await note_rate("alone")
        for _ in range(queued):
            lab.submit(1, 1)
        await lab.kernel.flush()
        for _ in range(rounds):
            await note_rate("queued")
        where = ("--home", str(folder), "--database", url, "--bus", lab.endpoint)
        ports = [free_port(), free_port()]
        urls = [f"http://127.0.0.1:{port}" for port in ports]
        for port in ports:
            argv = ("labos", "api", "--process", f"api-{port}", "--http-port", str(port), *where)
            await stack.enter_async_context(Helper(*argv))
        for _ in range(rounds):
            await note_rate("quiet")
            before = lab.kernel.durable
            halves = [Followers(url, number // 2, before - 1, elsewhere=True) for url in urls]
            fuzzer = Helper("tests.benchmarks.fuzzer_process", *urls)
            async with halves[0], halves[1], fuzzer:
                await note_rate("all")
                written = lab.kernel.durable - before
            got = " and ".join(half.counts for half in halves)
            notes.append(f"of {written} events followers got (least, most) {got}; fuzzer: {fuzzer.said}")
    alone, all_ = median(rates["alone"]), median(rates["all"])
    for name, of in rates.items():
        seen, cpu = (
            ", ".join(f"{value:.{digits}f}" for value in all_of)
            for all_of, digits in ((of, 0), (cpus[name], 2))
        )
        notes.append(f"{name}: {seen} steps/s; {cpu} ms of the kernel's processor time a step")
    notes.append(f"load of the machine afterwards: {os.getloadavg()[0]:.1f}")
    notes.append(
        f"kernel and nodes on the processors {OURS or 'all'}; API processes and clients: {' '.join(OTHERS)}"
    )
    quiet = times(all_ / median(rates["quiet"]))
    notes.append(f"with followers and fuzzer {quiet} of what it is while nobody asks the API processes")
    load = f"{number} followers, {queued} queued runs, a fuzzer"
    cpu = median(cpus["all"]) / median(cpus["alone"])
    figure = Figure(
        f"steps/s behind API processes: {load}",
        f"{all_:.0f}/s",
        f"{alone:.0f}/s (alone)",
        times(all_ / alone),
        f"≥ {MUST} ×",
        all_ / alone >= MUST,
    )
    notes.append(f"the kernel's processor time a step is {times(cpu)} of that alone")
    return Report([figure], notes)


def measure_api(rounds: int = 3, steps: int = 1500, queued: int = 10_000, number: int = 200) -> Report:
    with scratch("viewers-api") as folder, keep_to(OURS):
        return asyncio.run(measure_api_in(folder, rounds, steps, queued, number))


@contextmanager
def keep_to(cores: Sequence[int]) -> Iterator[None]:
    """This process, and those that it starts, work on some of the processors."""
    if cores:
        os.sched_setaffinity(0, cores)
    try:
        yield
    finally:
        if cores:
            os.sched_setaffinity(0, CORES)


def measure(
    rounds: int = 3, modules: int = 1, steps: int = 400, numbers: Sequence[int] = (50, 300)
) -> Report:
    with scratch("viewers") as folder:
        here = asyncio.run(measure_in(folder, rounds, modules, steps, numbers))
    beside = measure_api() if rounds > 1 else measure_api(1, 5, 3, 2)
    return Report([*here.figures, *beside.figures], [*here.notes, *beside.notes])


def smoke() -> Report:
    return measure(1, 1, 5, (3,))

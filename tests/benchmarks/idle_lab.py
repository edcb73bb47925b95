"""A lab of instruments that do nothing: real kernel, writer thread, SQLite file, bus, and nodes with
journals in processes of their own."""

from __future__ import annotations

import asyncio
import subprocess
import sys
import time
from collections.abc import AsyncIterator, Callable, Sequence
from contextlib import AsyncExitStack, asynccontextmanager
from pathlib import Path

from labos.bus import ZenohBus, open_bus
from labos.clock import SystemClock, Uuid7Ids
from labos.core.actions import ActionSucceeded
from labos.core.canonical import digest
from labos.core.decide import Rejection
from labos.core.decide.experiments import StartExperiment
from labos.core.decide.lab import ApplyWorkcell
from labos.core.decide.runs import SubmitRun
from labos.core.ids import ModuleName, RunId
from labos.core.model import ModuleSpec, Plan, PlanStep, Workcell
from labos.runtime.dispatcher import Dispatcher
from labos.runtime.kernel import Kernel
from labos.runtime.kernel_log import KernelSettings
from labos.runtime.ledger import Entry
from labos.runtime.registry import Registry
from labos.runtime.writer import ThreadWriter
from labos.settings import free_port
from labos.store import SqlEventStore, open_store
from tests.benchmarks.node_process import CELL, local_name


class Ends:
    """Counts actions whose result is on disk, and remembers the batches of the log."""

    def __init__(self) -> None:
        self.actions = 0
        self.batches: list[list[Entry]] = []
        self.changed = asyncio.Event()

    def on_committed(self, entries: Sequence[Entry]) -> None:
        self.batches.append(list(entries))
        self.actions += sum(isinstance(entry.event, ActionSucceeded) for entry in entries)
        self.changed.set()

    def on_reopened(self) -> None:
        """Nothing was lost that was counted."""

    async def until(self, done: Callable[[], bool], limit_s: float = 60.0) -> None:
        """Wait until it holds; looked at after each commit."""
        give_up = time.monotonic() + limit_s
        while not done():
            self.changed.clear()
            await asyncio.wait_for(self.changed.wait(), max(give_up - time.monotonic(), 0.01))


class IdleLab:
    """The parts that benchmarks touch."""

    def __init__(
        self,
        kernel: Kernel,
        bus: ZenohBus,
        ends: Ends,
        modules: int,
        registry: Registry,
        store: SqlEventStore,
        endpoint: str = "",
    ) -> None:
        self.kernel, self.bus, self.ends, self.modules = kernel, bus, ends, modules
        self.registry, self.store, self.endpoint = registry, store, endpoint

    def submit(self, module: int, steps: int) -> RunId:
        """Queue a run of that many actions, one after the other, on one module."""
        answer = self.kernel.submit(SubmitRun(plan(module, steps), "ada"), "ada")
        assert not isinstance(answer, Rejection), answer
        return RunId(f"R{self.kernel.state.runs.named}")

    def keep_plans(self, steps: int) -> None:
        """Let an experiment of each module hold its plan, so that later runs need not record it."""
        for module in range(self.modules):
            answer = self.kernel.submit(StartExperiment("keeper", "ada", plan(module, steps)), "ada")
            assert not isinstance(answer, Rejection), answer


def module_name(number: int) -> ModuleName:
    return ModuleName(f"{CELL}/{local_name(number)}")


def plan(module: int, steps: int) -> Plan:
    name = module_name(module)
    return Plan(
        f"idle {module}",
        CELL,
        tuple(
            PlanStep(f"s{index}", name, "act", after=(index - 1,) if index else (), duration_s=0.0)
            for index in range(steps)
        ),
    )


@asynccontextmanager
async def idle_lab(folder: Path, modules: int, processes: int = 1) -> AsyncIterator[IdleLab]:
    """Run the lab as long as the block lasts."""
    async with AsyncExitStack() as stack:
        store = open_store(f"sqlite:///{folder}/labos.db")
        stack.callback(store.close)
        kernel = Kernel(ThreadWriter(store), SystemClock(), Uuid7Ids(), KernelSettings())
        await kernel.open()
        stack.push_async_callback(kernel.close)
        endpoint = f"tcp/127.0.0.1:{free_port()}"
        bus = await open_bus(mode="router", listen=[endpoint])
        stack.push_async_callback(bus.close)
        dispatcher = Dispatcher(kernel, bus)
        registry = Registry(kernel, bus, dispatcher, silence_s=60.0)
        await dispatcher.start()
        stack.push_async_callback(dispatcher.close)
        await registry.start()
        stack.push_async_callback(registry.close)
        specs = tuple(ModuleSpec(module_name(number), "idle") for number in range(modules))
        cell = Workcell(CELL, digest(str(modules).encode()), specs, ())
        await kernel.execute(ApplyWorkcell(cell), "ada")
        ends = Ends()
        kernel.listeners.append(ends)
        shares = [len(range(number, modules, processes)) for number in range(processes)]
        first = 0
        for count in shares:
            child = start_nodes(endpoint, kernel.lab, folder, first, count)
            stack.callback(stop_nodes, child)
            first += count
        await ends.until(lambda: all(m.status == "IDLE" for m in kernel.state.modules.by_name.values()))
        yield IdleLab(kernel, bus, ends, modules, registry, store, endpoint)


def start_nodes(endpoint: str, lab: str, folder: Path, first: int, count: int) -> subprocess.Popen[bytes]:
    argv = [sys.executable, "-m", "tests.benchmarks.node_process", endpoint, lab, str(folder)]
    return subprocess.Popen([*argv, str(first), str(count)], stdin=subprocess.PIPE)


def stop_nodes(child: subprocess.Popen[bytes]) -> None:
    assert child.stdin is not None
    child.stdin.close()
    try:
        child.wait(20)
    except subprocess.TimeoutExpired:
        child.kill()
        child.wait()

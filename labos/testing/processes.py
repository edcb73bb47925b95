"""The processes of a simulated lab: one kernel, a node for each module, and their bus and store. A process
that dies is started again after a while, as by a supervisor.
"""

from __future__ import annotations

import asyncio
import contextvars
import random
from collections import Counter
from collections.abc import Callable, Coroutine, Mapping, Sequence
from pathlib import Path
from typing import Any

import msgspec

from labos.core.canonical import digest
from labos.core.ids import local
from labos.core.state import LabState
from labos.errors import LabosError
from labos.node.files import Attachment, Files
from labos.node.journal import Journal
from labos.node.node import Node, Setup
from labos.node.server import NodeServer
from labos.node.world import World
from labos.planning.scheduler import Scheduler, make_searching_scheduler
from labos.ports import Bus
from labos.runtime.dispatcher import Dispatcher
from labos.runtime.kernel import Kernel
from labos.runtime.kernel_log import KernelSettings
from labos.runtime.ledger import fold
from labos.runtime.reconcile import Reconciler
from labos.runtime.registry import Registry
from labos.runtime.verify import Verifier
from labos.testing.bus import Network
from labos.testing.disk import SimulatedJournalFile, SimulatedStore, SimulatedWriter
from labos.testing.faults import FaultRates, Faults
from labos.testing.loop import CountedIds, Process, VirtualClock, VirtualLoop
from labos.testing.stand import Stand

HEARTBEAT_S = 30.0

MACHINES = ("one", "another")
"""The machines on which kernels run."""


class SlipperyWorld(World):
    """A bench on which grippers lose labware with the probability of the faults."""

    def __init__(self, faults: Faults) -> None:
        super().__init__()
        self._faults = faults
        self.mishaps: Counter[str] = Counter()

    def mishap(self, device: str) -> str:
        how = super().mishap(device) or self._faults.mishap()
        self.mishaps[how] += 1
        return how


class NotedFiles(Files):
    """The files of a lab without a disk: the names of output files are recorded without their content, and an
    input file is only a name."""

    async def send(self, attachment: Attachment) -> dict[str, Any]:
        content = attachment.content
        data = content if isinstance(content, bytes) else content.read_bytes()
        return {"file": attachment.name, "sha256": digest(data), "bytes": len(data)}

    async def fetch(self, sha256: str, name: str) -> Path:
        return Path(name)


class Conditions(msgspec.Struct, frozen=True):
    """How a lab is run. Modules in ``dead`` have no node; those in ``mended`` get theirs back after the given
    seconds. With ``standby``, another kernel is started on another machine when the lease of the kernel
    (``lease_s``) has expired."""

    dead: Sequence[str] = ()
    mended: Mapping[str, float] = {}
    plan_with: Callable[[], Scheduler] = make_searching_scheduler
    make_faults: Callable[[FaultRates, random.Random], Faults] = Faults
    pace: float = 1.0
    lease_s: float = 1e9
    standby: bool = False
    most_kernels: int = 100_000
    """The number of starts after which a process that keeps failing is not started again."""
    snapshot_every: int = 300


class Processes:
    """Kernel and nodes over one bench, one bus and one store."""

    def __init__(self, stand: Stand, seed: int, rates: FaultRates, conditions: Conditions) -> None:
        self.stand = stand
        self.seed = seed
        self.conditions = conditions
        self.rng = random.Random(seed)
        self.loop = VirtualLoop()
        self.faults = conditions.make_faults(rates, self.rng)
        self.faults.calm = True
        self.faults.on_freeze = self.faults.on_jump = self._watch_over
        self.faults.choose_peer = self._choose_peer
        self.network = Network(self.faults, self.loop)
        self.store = SimulatedStore(self.loop.time)
        self.world = SlipperyWorld(self.faults)
        self.disk: dict[str, bytes] = {}
        self._devices: dict[str, Node] = {}
        self.kernel: Kernel | None = None
        self.kernels = 0
        self.takeovers = 0
        self.dead = set(conditions.dead)
        self.mended = dict(conditions.mended)
        self.opened: list[Kernel] = []
        self._ids: dict[str, CountedIds] = {}
        self._clocks: dict[str, VirtualClock] = {}
        self.processes: list[Process] = []
        """All processes that ever existed."""
        self._process_of: dict[Kernel, Process] = {}
        self._serving: list[Kernel] = []
        self.before_restart: Callable[[], None] = lambda: None

    def files_of(self, bus: Bus) -> Files:
        """The place for the files of a node."""
        return NotedFiles(bus, "", Path())

    def is_moving(self, module: str) -> bool:
        """Whether a module's device is visibly moving."""
        node = self._devices.get(module)
        return bool(getattr(getattr(node, "device", node), "moving", False))

    def fold_log(self) -> LabState:
        """The state of the log, folded from the first event."""
        state = LabState()
        fold(state, self.store.read())
        return state

    def _furnish(self) -> None:
        for station in self.stand.workcell.places:
            self.world.furnish(local(station.name), station.capacity)
        for name, kind, count in self.stand.stock:
            self.world.stock(local(name), kind, count)
        zones = {local(station.name): station.zone for station in self.stand.workcell.stations}
        zones |= {local(module.name): module.zone for module in self.stand.workcell.modules}
        for place, zone in zones.items():
            if zone:
                self.world.share(zone, place)
        for module in self.stand.workcell.modules:
            for resource, capacity in module.levels.items():
                self.world.supply(local(module.name), resource, capacity)

    def ids(self, name: str) -> CountedIds:
        return self._ids.setdefault(name, CountedIds(name))

    def _make_process(self, name: str, machine: str) -> Process:
        """A new process, with the clock of its machine."""
        clock = self._clocks.setdefault(machine, VirtualClock(self.loop))
        process = Process(name, clock)
        self.processes.append(process)
        return process

    def _start_kernel(self, machine: str = MACHINES[0]) -> None:
        self.kernels += 1
        process = self._make_process(f"kernel{self.kernels}", machine)
        process.on_death.append(lambda: self._on_kernel_death(process, machine))
        self.loop.start(process, self._run_or_die(process, self._kernel_main(process)))

    def _on_kernel_death(self, process: Process, machine: str) -> None:
        if self.kernel is not None and self._process_of[self.kernel] is process:
            self.kernel = self._find_latest_kernel()
        self.before_restart()
        if not self._list_living_kernels() and self.kernels < self.conditions.most_kernels:
            self._schedule_restart(self._start_kernel, machine)

    def _find_latest_kernel(self) -> Kernel | None:
        """The kernel that people use: the one that was started last."""
        living = [kernel for kernel in self._serving if self._process_of[kernel].alive]
        return max(living, key=self.opened.index, default=None)

    def _list_living_kernels(self) -> list[Process]:
        return [process for process in self.processes if process.alive and is_kernel(process)]

    def _choose_peer(self, process: Process) -> Process | None:
        """A process with which a process communicates."""
        if not is_kernel(process):
            return next(iter(self._list_living_kernels()), None)
        nodes = [other for other in self.processes if other.alive and not is_kernel(other)]
        return self.rng.choice(nodes) if nodes else None

    def _watch_over(self, process: Process) -> None:
        """Watch the lease of a kernel, as its standby does."""
        if self.conditions.standby and is_kernel(process):
            self._look_at_lease(process, self.loop.time() + self.conditions.lease_s / 2)

    def _look_at_lease(self, process: Process, until: float) -> None:
        if self._list_living_kernels() != [process]:
            return
        machine = MACHINES[self._clocks[MACHINES[0]] is process.clock]
        # The request comes from the standby's machine: its clock must have no influence.
        self.store.process = Process("standby", self._clocks.setdefault(machine, VirtualClock(self.loop)))
        if self.store.is_abandoned():
            self.takeovers += 1
            self._start_kernel(machine)
        elif process.frozen or self.loop.time() < until:
            outside = contextvars.Context()
            self.loop.call_later(1.0, self._look_at_lease, process, until, context=outside)

    async def _run_or_die(self, process: Process, main: Coroutine[Any, Any, None]) -> None:
        """Run a program. If it ends with an error, it is started again like a killed one."""
        try:
            await main
        except LabosError:
            process.kill()

    async def _kernel_main(self, process: Process) -> None:
        bus = self.network.endpoint(process)
        writer = SimulatedWriter(self.store, self.faults, process)
        how = self.conditions
        settings = KernelSettings("simulated", how.pace, process.name, how.lease_s, how.snapshot_every)
        assert process.clock is not None
        salts = self.ids("salt")
        kernel = Kernel(
            writer, process.clock, self.ids("kernel"), settings, how.plan_with, lambda: salts.new().encode()
        )
        self.opened.append(kernel)
        self._process_of[kernel] = process
        await kernel.open()
        dispatcher = Dispatcher(kernel, bus)
        registry = Registry(kernel, bus, dispatcher, silence_s=10 * HEARTBEAT_S)
        await dispatcher.start()
        await registry.start()
        await Reconciler(kernel, bus).start()
        await Verifier(kernel, bus).start()
        await self._serve(kernel)
        self._serving.append(kernel)
        self.kernel = self._find_latest_kernel()
        await kernel.failed
        process.kill()

    async def _serve(self, kernel: Kernel) -> None:
        """Further work of a kernel's process; there is none by default."""

    def _bury(self, name: str) -> None:
        self.dead.add(name)
        for process in self.processes:
            if process.name == f"node:{self.stand.workcell.name}/{name}":
                process.kill()
        if name in self.mended:
            self.loop.call_later(self.mended[name], self._mend, name, context=contextvars.Context())

    def _mend(self, name: str) -> None:
        self.dead.discard(name)
        self._start_node(f"{self.stand.workcell.name}/{name}")

    def _start_node(self, name: str) -> None:
        if local(name) in self.dead:
            return
        process = self._make_process(f"node:{name}", name)
        process.on_death.append(lambda: self._schedule_restart(self._start_node, name))
        process.on_death.append(lambda: self._devices.pop(name, None))
        self.loop.start(process, self._run_or_die(process, self._node_main(process, name)))

    async def _node_main(self, process: Process, name: str) -> None:
        spec = next(m for m in self.stand.workcell.modules if m.name == name)
        bus = self.network.endpoint(process)
        ids = self.ids(f"node-{local(name)}")
        journal = await Journal.open(SimulatedJournalFile(self.disk, name, self.faults, process), ids)
        setup = Setup(
            name=local(name),
            workcell=self.stand.workcell.name,
            config=spec.config.get("config", spec.config),
            regrip=local(spec.regrip),
            world=self.world,
            pace=self.conditions.pace,
            seed=self.seed,
        )
        node = self._devices[name] = self.stand.node_class(spec)(setup)
        lab = await self._await_lab_id()
        assert process.clock is not None
        server = NodeServer(
            node,
            bus,
            lab,
            journal,
            process.clock,
            ids,
            heartbeat_s=HEARTBEAT_S,
            idle_poll_s=5.0,
            files=self.files_of(bus),
        )
        await server.start()

    async def _await_lab_id(self) -> str:
        while not self.store.head().lab:
            await asyncio.sleep(0.01)
        return self.store.head().lab

    def _schedule_restart(self, start: Callable[..., None], *args: str) -> None:
        """Start a process again after a while, outside the context of the dead process."""
        low, high = self.faults.rates.restart_s
        self.loop.call_later(self.rng.uniform(low, high), start, *args, context=contextvars.Context())


def is_kernel(process: Process) -> bool:
    return process.name.startswith("kernel")

"""The processes of a simulated lab: one kernel, a node for each module, and what they stand on.

Whoever dies is started again after a while, as by a supervisor.
"""

from __future__ import annotations

import asyncio
import contextvars
import random
from collections import Counter
from collections.abc import Callable, Coroutine, Mapping, Sequence
from typing import Any

from labos.core.ids import local
from labos.core.state import LabState
from labos.errors import LabosError
from labos.node.journal import Journal
from labos.node.node import Setup
from labos.node.server import NodeServer
from labos.node.world import World
from labos.planning.scheduler import Scheduler
from labos.runtime.dispatcher import Dispatcher
from labos.runtime.kernel import Kernel, KernelSettings
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


class SlipperyWorld(World):
    """A bench on which hands lose what they hold, as often as the faults say."""

    def __init__(self, faults: Faults) -> None:
        super().__init__()
        self._faults = faults
        self.mishaps: Counter[str] = Counter()

    def mishap(self, device: str) -> str:
        how = super().mishap(device) or self._faults.mishap()
        self.mishaps[how] += 1
        return how


class Processes:
    """Kernel and nodes over one bench, one bus and one store. Modules in ``dead`` have no node; those in
    ``mended`` get theirs back so many seconds after they lost it."""

    def __init__(
        self,
        stand: Stand,
        seed: int,
        rates: FaultRates,
        *,
        dead: Sequence[str] = (),
        mended: Mapping[str, float] | None = None,
        plan_with: Callable[[], Scheduler] = Scheduler,
    ) -> None:
        self.stand = stand
        self.seed = seed
        self.plan_with = plan_with
        self.rng = random.Random(seed)
        self.loop = VirtualLoop()
        self.faults = Faults(rates, self.rng)
        self.faults.calm = True
        self.network = Network(self.faults)
        self.store = SimulatedStore()
        self.world = SlipperyWorld(self.faults)
        self.disk: dict[str, bytes] = {}
        self.kernel: Kernel | None = None
        self.kernels = 0
        self.dead = set(dead)
        self.mended = dict(mended or {})
        self.opened: list[Kernel] = []
        self._ids: dict[str, CountedIds] = {}
        self._everybody: list[Process] = []
        self.before_restart: Callable[[], None] = lambda: None

    def folded(self) -> LabState:
        """The state that the log amounts to, folded from nothing."""
        state = LabState()
        fold(state, self.store.read())
        return state

    def _furnish(self) -> None:
        for station in self.stand.workcell.stations:
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

    def _start_kernel(self) -> None:
        self.kernels += 1
        process = Process(f"kernel{self.kernels}")
        self._everybody.append(process)
        process.on_death.append(lambda: self._kernel_died(process))
        self.loop.start(process, self._or_die(process, self._kernel_main(process)))

    def _kernel_died(self, process: Process) -> None:
        self.kernel = None
        self.before_restart()
        self._later(self._start_kernel)

    async def _or_die(self, process: Process, main: Coroutine[Any, Any, None]) -> None:
        """A program that ends with an error is started again like one that was killed."""
        try:
            await main
        except LabosError:
            process.kill()

    async def _kernel_main(self, process: Process) -> None:
        bus = self.network.endpoint(process)
        writer = SimulatedWriter(self.store, self.faults, process)
        settings = KernelSettings(name="simulated", lease_s=1e9, snapshot_every=300)
        clock = VirtualClock(self.loop)
        kernel = Kernel(writer, clock, self.ids("kernel"), settings, self.plan_with)
        self.opened.append(kernel)
        await kernel.open()
        dispatcher = Dispatcher(kernel, bus)
        registry = Registry(kernel, bus, dispatcher, silence_s=10 * HEARTBEAT_S)
        await dispatcher.start()
        await registry.start()
        reconciler = Reconciler(kernel, bus)
        reconciler.start()
        Verifier(kernel, bus).start()
        self.kernel = kernel
        await kernel.failed
        process.kill()

    def _bury(self, name: str) -> None:
        self.dead.add(name)
        for process in self._everybody:
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
        process = Process(f"node:{name}")
        self._everybody.append(process)
        process.on_death.append(lambda: self._later(self._start_node, name))
        self.loop.start(process, self._or_die(process, self._node_main(process, name)))

    async def _node_main(self, process: Process, name: str) -> None:
        spec = next(m for m in self.stand.workcell.modules if m.name == name)
        bus = self.network.endpoint(process)
        ids = self.ids(f"node-{local(name)}")
        journal = await Journal.open(SimulatedJournalFile(self.disk, name, self.faults), ids)
        setup = Setup(
            name=local(name),
            workcell=self.stand.workcell.name,
            config=spec.config.get("config", spec.config),
            regrip=local(spec.regrip),
            world=self.world,
            seed=self.seed,
        )
        node = self.stand.nodes[spec.driver](setup)
        lab = await self._lab_id()
        clock = VirtualClock(self.loop)
        server = NodeServer(node, bus, lab, journal, clock, ids, heartbeat_s=HEARTBEAT_S, idle_poll_s=5.0)
        await server.start()

    async def _lab_id(self) -> str:
        while not self.store.head().lab:
            await asyncio.sleep(0.01)
        return self.store.head().lab

    def _later(self, start: Callable[..., None], *args: str) -> None:
        """Somebody starts a process again after a while; the dead one's context is no part of it."""
        low, high = self.faults.rates.restart_s
        self.loop.call_later(self.rng.uniform(low, high), start, *args, context=contextvars.Context())

"""A running lab: its parts, its nodes, and its answers to them."""

from __future__ import annotations

import asyncio
import sys
from collections.abc import Mapping, Sequence

import msgspec
import structlog

from labos.bootstrap._drivers import load_drivers
from labos.bootstrap._metrics import LabMetrics
from labos.bootstrap._secure import Guard, explain_unheard
from labos.bus import Unheard, ZenohBus
from labos.core.ids import ModuleName, local, workcell_of
from labos.core.model import Description
from labos.core.texts import LONGEST_NAME, cut
from labos.errors import StoreError, Unreadable
from labos.http.desk import Desk
from labos.http.identity import Gate
from labos.http.server import HttpServer
from labos.http.service import LabService
from labos.node.limits import read
from labos.node.protocol import Keys, SetupReply, SetupRequest
from labos.node.world import World
from labos.private import make_folder
from labos.runtime.announcer import Announcer
from labos.runtime.dispatcher import Dispatcher
from labos.runtime.kernel import Kernel
from labos.runtime.log_check import LogCheck
from labos.runtime.registry import Registry
from labos.runtime.spawning import choose_spawner
from labos.runtime.supervisor import END_WITH_PARENT, NodeCommand, Supervisor
from labos.runtime.tasks import Tasks
from labos.settings import Settings, is_alive
from labos.spec import CompiledWorkcell
from labos.store import SqlEventStore, open_blobs
from labos.version import VERSION

_log = structlog.get_logger(__name__)


_setup_request = msgspec.json.Decoder(SetupRequest)


class LabRuntime:
    """A running lab, in the process of its kernel. Made by ``open_lab``."""

    bus: ZenohBus
    registry: Registry
    dispatcher: Dispatcher
    announcer: Announcer
    service: LabService
    metrics: LabMetrics
    bus_endpoint: str
    gate: Gate
    http: HttpServer
    desk: Desk
    log_check: LogCheck | None = None
    """The check of the whole log, after it has begun."""
    guard: Guard | None = None
    """The certificates of a secure bus."""

    def __init__(self, settings: Settings, kernel: Kernel, store: SqlEventStore, *, simulated: bool) -> None:
        self.settings, self.kernel, self.store, self.simulated = settings, kernel, store, simulated
        self.clock = kernel.clock
        self.blobs = open_blobs(settings.blobs)
        self.supervised: Supervisor | None = None
        drivers = load_drivers()
        self.descriptions: Mapping[str, Description] = drivers.make_descriptions()
        self.broken_drivers: Mapping[str, str] = drivers.broken
        for name, why in drivers.broken.items():
            _log.warning("driver_broken", driver=name, why=why)
        self.nodes_from = 0
        """The position in the log after which this kernel's nodes were started."""
        self.cut_short: list[str] = []
        """The actions, with their runs, that had not ended when the lab was closed."""
        self.left_to_standby = False
        """Whether the lab is closed so that a standby can take over."""
        self._unheard: dict[ModuleName, str] = {}
        self._worlds: dict[str, World] = {}
        self._detach = False
        self._following = Tasks()

    def world(self, workcell: str) -> World:
        """The simulated bench of a workcell."""
        if workcell not in self._worlds:
            make_folder(self.settings.worlds)
            self._worlds[workcell] = World(str(self.settings.world(workcell)))
        return self._worlds[workcell]

    async def apply(self, cell: CompiledWorkcell, *, declare: bool | None = None) -> None:
        """Set up a workcell. By default, its stock is declared on a simulated bench, but not on a real
        one."""
        await self.service.apply(cell, "labos", declare=self.simulated if declare is None else declare)

    def start_nodes(self, *, detach: bool = False) -> None:
        """Start a process for each module of the applied workcells (``only``: for these)."""
        self._detach = detach
        if self.supervised is None:
            self.nodes_from = self.kernel.durable
            folders = self.settings.nodes, self.settings.logs
            for folder in folders:
                make_folder(folder)
            spawner = choose_spawner(self.settings.logs / "fork-server.log", is_alive)
            self.supervised = Supervisor(
                *folders, self.clock, is_alive, self.settings.journal, detach=detach, spawner=spawner
            )
        modules = self.kernel.state.modules.by_name
        self.supervised.start([NodeCommand(str(name), self._make_argv(name, detach)) for name in modules])

    async def leave_to_standby(self) -> bool:
        """Whether this lab can be left to a standby. A standby has to be ready, and the nodes must not end
        together with this process. Raises StoreError."""
        standing_by = await asyncio.to_thread(self.store.standbys)
        mortal = self.supervised is not None and not self._detach
        if not standing_by or mortal:
            _log.warning("not_left_to_standby", standing_by=standing_by, nodes_end_with_it=mortal)
            return False
        self.left_to_standby = True
        return True

    def is_stopping(self, module: ModuleName) -> bool:
        """Whether LabOS has asked the node of a module to end."""
        return self.supervised is not None and self.supervised.is_stopping(module)

    def follow_workcells(self, changed: Sequence[ModuleName] = ()) -> None:
        """Adapt the nodes to the workcells: nodes of removed modules end, nodes of ``changed`` modules are
        restarted after their present actions, and nodes of new modules are started."""
        if self.supervised is not None:
            self._following.spawn(self._follow(self.supervised, changed))

    async def _follow(self, supervisor: Supervisor, changed: Sequence[ModuleName]) -> None:
        known = self.kernel.state.modules.by_name
        old = [name for name in supervisor.nodes if name not in known or name in changed]
        await asyncio.gather(*(supervisor.stop(name) for name in old))
        if self.guard is not None:
            await asyncio.to_thread(self.guard.issue_for, list(known))
        self.start_nodes(detach=self._detach)

    def _make_argv(self, module: ModuleName, detach: bool) -> tuple[str, ...]:
        spec = self.kernel.state.modules.by_name[module].spec
        # A foreign node has no driver's description.
        driver = [] if "about" in spec.config else [spec.driver]
        endpoints = self.settings.bus or (self.bus_endpoint,)
        return (
            *(sys.executable, "-m", "labos", "node", "start", *driver),
            *("--name", local(module), "--workcell", workcell_of(module)),
            *("--home", str(self.settings.home)),
            *(word for endpoint in endpoints for word in ("--connect", endpoint)),
            *(["--cert", str(self.guard.find_node_folder(module))] if self.guard is not None else []),
            *(["--simulate"] if self.simulated else []),
            *(["--wire"] if self.simulated and self.settings.wire else []),
            *(["--trace", str(self.settings.trace(module))] if self.settings.trace_wires else []),
            *(["--metrics-port", "0"] if self.settings.node_metrics else []),
            *([] if detach else [END_WITH_PARENT]),
        )

    def note_unheard(self, unheard: Unheard) -> None:
        """Note which modules' nodes are connected but do not answer, and clear those that do."""
        found, rejected = explain_unheard(unheard, self.kernel.lab), self.registry.rejected
        for module, why in self._unheard.items():
            if module not in found and rejected.get(module) == why:
                del rejected[module]
        rejected.update(found)
        self._unheard = found

    async def on_setup(self, payload: bytes) -> bytes:
        """Answer a starting node that asks for its module's configuration; it gets no other module's."""
        try:
            request = read(payload, _setup_request)
            reply = self._make_setup(ModuleName(request.module))
        except (Unreadable, StoreError) as error:
            reply = SetupReply(unknown=str(error))
        return msgspec.json.encode(reply)

    async def on_setup_of(self, key: str, payload: bytes) -> bytes:
        """The same on a separate key for each module; on a secure bus only the module's node may query it."""
        try:
            module = read(payload, _setup_request).module
        except Unreadable as error:
            return msgspec.json.encode(SetupReply(unknown=str(error)))
        if key != Keys(self.kernel.lab).setup_of(module):
            return msgspec.json.encode(SetupReply(unknown="this key belongs to another module"))
        return await self.on_setup(payload)

    def _make_setup(self, name: ModuleName) -> SetupReply:
        state = self.kernel.state
        module = state.modules.by_name.get(name)
        if module is None:
            return SetupReply(unknown=f"no workcell of this lab has a module {cut(name, LONGEST_NAME)}")
        config = module.spec.config
        return SetupReply(
            driver=module.spec.driver,
            config=config.get("config", {}),
            poses={**config.get("poses", {}), **module.list_poses()},
            poses_of=module.list_poses_by_type(),
            regrip=local(module.spec.regrip),
            pace=state.lab.pace,
            seed=self.settings.seed,
            simulated=self.simulated,
            interface=config.get("interface", ""),
            about=config.get("about", {}),
            extends=config.get("extends", {}),
            labos=VERSION,
        )

    def close_worlds(self) -> None:
        for world in self._worlds.values():
            world.close()

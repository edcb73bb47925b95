"""Who answers for which module: nodes are noticed, heard and missed here.

A node is there when its liveliness token is; it is silent when its heartbeat stops although the
token stands (a process alive with its interpreter held is not noticed otherwise).
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Coroutine
from typing import Any

import msgspec
import structlog

from labos.core.actions import Actions
from labos.core.decide import Rejection
from labos.core.decide.nodes import HearJournal, JoinNode, LoseNode, RecordStop, ReportState
from labos.core.decide.shorter import Found
from labos.core.ids import ActionId, ModuleName
from labos.errors import NoAnswer, StoreError
from labos.node.journal import knows_more
from labos.node.protocol import AboutReport, AdminRequest, Keys, StateReport
from labos.ports import Bus, Handle
from labos.runtime.dispatcher import Dispatcher
from labos.runtime.kernel import Kernel

_log = structlog.get_logger(__name__)
_decode_about = msgspec.json.Decoder(AboutReport).decode
_decode_state = msgspec.json.Decoder(StateReport).decode


class Registry:
    """Keeps the modules slice in step with the nodes on the bus. ``silence_s`` without a
    heartbeat counts as gone. ``is_stopping`` says of which module the node was told to end."""

    def __init__(
        self,
        kernel: Kernel,
        bus: Bus,
        dispatcher: Dispatcher,
        *,
        silence_s: float = 10.0,
        answer_s: float = 5.0,
        is_stopping: Callable[[ModuleName], bool] = lambda _: False,
    ) -> None:
        self._kernel, self._bus, self._dispatcher = kernel, bus, dispatcher
        self._is_stopping = is_stopping
        self._silence_s, self._answer_s = silence_s, answer_s
        self.lab = kernel.lab
        self._keys = Keys(kernel.lab)
        self._living: dict[ModuleName, list[str]] = {}
        self._heard: dict[tuple[ModuleName, str], float] = {}
        self._handles: list[Handle] = []
        self._tasks: set[asyncio.Task[None]] = set()
        self._starts: list[tuple[int, int]] = []
        self.rejected: dict[ModuleName, str] = {}

    async def start(self) -> None:
        """Watch from now on. Nodes that the log believes in but that do not live are lost."""
        self._kernel.listeners.append(self)
        self._handles.append(await self._bus.subscribe(self._keys.all_states, self._on_state))
        self._handles.append(await self._bus.watch_alive(self._keys.all_alive, self._on_alive))
        self._spawn(self._listen())

    async def close(self) -> None:
        if self in self._kernel.listeners:
            self._kernel.listeners.remove(self)
        for handle in self._handles:
            handle.close()
        for task in list(self._tasks):
            task.cancel()

    @property
    def living(self) -> list[ModuleName]:
        """Modules for which a node is on the bus, whatever the log says."""
        return [module for module, instances in self._living.items() if instances]

    def committed(self, entries: object) -> None:
        """Nothing follows here from what was written."""

    def reopened(self) -> None:
        for module in list(self._living):
            self._spawn(self._greet(module))

    # -- liveliness --------------------------------------------------------------------------

    def _on_alive(self, key: str, living: bool) -> None:
        module, instance = ModuleName(Keys.module_of(key)), key.rpartition("/")[2]
        instances = self._living.setdefault(module, [])
        if living:
            self._hear(module, instance)
            self._spawn(self._greet(module))
        else:
            self._forget(module, instance)
            self._lose(module, instance, "it does not answer (gone or frozen)")
            if instances:
                self._spawn(self._greet(module))

    def _hear(self, module: ModuleName, instance: str) -> None:
        """It lives."""
        instances = self._living.setdefault(module, [])
        if instance not in instances:
            instances.append(instance)
        self._heard[module, instance] = self._kernel.clock.monotonic()

    def _forget(self, module: ModuleName, instance: str) -> None:
        instances = self._living.get(module, [])
        if instance in instances:
            instances.remove(instance)
        self._heard.pop((module, instance), None)

    async def _greet(self, module: ModuleName) -> None:
        """Ask a living node who it is, and let it join."""
        pause = 0.1
        while self._living.get(module):
            try:
                about = _decode_about(await self._query(module, "about"))
                state = _decode_state(await self._query(module, "state"))
                self._join(module, about, state, await self._beyond(about))
                return
            except NoAnswer:
                await asyncio.sleep(pause)
                pause = min(pause * 2, 2.0)
            except msgspec.MsgspecError as error:
                self.rejected[module] = f"its about cannot be read ({error})"
                _log.warning("node_unreadable", module=module, error=str(error))
                return
            except StoreError:
                return  # greeted again when the log is open

    async def _beyond(self, about: AboutReport) -> int:
        """The position up to which a node was told of things, if the log does not hold all of that."""
        kernel = self._kernel
        if not about.acknowledged:
            return 0
        if about.acknowledged_by == kernel.epoch:
            starts: list[tuple[int, int]] = []
        else:
            starts = self._starts = self._starts or await kernel.starts()
        more = knows_more(about.acknowledged, about.acknowledged_by, kernel.durable, starts)
        return about.acknowledged if more else 0

    def _join(self, module: ModuleName, about: AboutReport, report: StateReport, beyond: int) -> None:
        if about.epoch > self._kernel.epoch:
            self._dispatcher.outranked(
                f"{module} obeys the kernel of epoch {about.epoch}; this one's is {self._kernel.epoch}."
            )
            return
        actions = self._kernel.state.actions
        strange = [
            Found(ActionId(entry.action), entry.name, entry.status, entry.position, entry.effects)
            for entry in about.open
            if not _known(actions, module, ActionId(entry.action))
        ]
        description = about.description
        # A node is not BUSY to us with what we asked of it ourselves.
        busy_for_us = any(name in self._kernel.state.actions.open for name in report.running)
        status = "IDLE" if report.status == "BUSY" and busy_for_us else report.status
        known = self._kernel.state.modules.by_name.get(module)
        if known is not None and known.status != "GONE" and known.instance != about.instance:
            if known.instance in self._living.get(module, []):
                self.rejected[module] = "two nodes claim this module"
            else:
                self._lose(module, known.instance, "another process took its place")
        answer = self._kernel.submit(
            JoinNode(
                module,
                about.journal,
                about.instance,
                str(description.get("driver", "")),
                str(description.get("version", "")),
                about.digest,
                status,
                about.simulated,
                tuple(strange),
                beyond,
            ),
            str(module),
        )
        if isinstance(answer, Rejection):
            self.rejected[module] = answer.message
            _log.warning("node_not_admitted", module=module, why=answer.message, remedy=answer.remedy)
            return
        self.rejected.pop(module, None)
        if strange:  # a node that had joined before
            self._kernel.submit(HearJournal(module, tuple(strange)), str(module))
        if beyond:
            self._spawn(self._rewind(module))
        self._find_out_about(module)
        self._heed(module, report)

    def _find_out_about(self, module: ModuleName) -> None:
        for action in list(self._kernel.state.actions.open.values()):
            if action.module == module:
                self._dispatcher.find_out(action.id)

    async def _rewind(self, module: ModuleName) -> None:
        """Let a node take requests again whose positions it was once told of; losing this costs
        another question when it joins again. It is out of service meanwhile."""
        try:
            await self._kernel.written()
            request = AdminRequest(
                self._kernel.lab, self._kernel.epoch, "rewind", {"position": self._kernel.durable}
            )
            key = self._keys.operation(module, "admin")
            await self._bus.query(key, msgspec.json.encode(request), self._answer_s)
        except (NoAnswer, StoreError) as error:
            _log.warning("journal_not_rewound", module=module, why=str(error))

    def _lose(self, module: ModuleName, instance: str, why: str) -> None:
        stopped = self._is_stopping(module)
        told = "LabOS has told it to end" if stopped else why
        try:
            self._kernel.submit(LoseNode(module, instance, told, stopped), str(module))
        except StoreError:
            pass  # seen again when the log is open

    # -- heartbeats --------------------------------------------------------------------------

    def _on_state(self, key: str, payload: bytes) -> None:
        module = ModuleName(Keys.module_of(key))
        try:
            report = _decode_state(payload)
            self._hear(module, report.instance)
            known = self._kernel.state.modules.by_name.get(module)
            if known is not None and known.status == "GONE":
                self._spawn(self._greet(module))
            elif known is not None and known.instance == report.instance:
                self._heed(module, report)
        except StoreError:
            pass
        except msgspec.MsgspecError as error:
            _log.warning("state_unreadable", module=module, error=str(error))

    def _heed(self, module: ModuleName, report: StateReport) -> None:
        """A node's own view: its status, and actions of ours that it has ended or never got."""
        state = self._kernel.state
        known = state.modules.by_name.get(module)
        if known is None:
            return
        mine = [state.actions.open[name] for name in known.in_flight]
        for name in map(ActionId, report.running):
            if name in state.actions.ended.get(module, ()):
                self._dispatcher.tell_settled(module, name, done=False)
        if report.stopped_at and report.stopped_at != known.stopped_at:
            stop = RecordStop(module, report.stopped_by, report.stopped_at)
            self._kernel.submit(stop, report.stopped_by or str(module))
        status = report.status
        if status == "BUSY" and any(action.id in report.running for action in mine):
            status = "IDLE"
        if (status, report.error) != (known.status, known.error):
            self._kernel.submit(ReportState(module, status, report.error), str(module))
        for action in mine:
            ended = action.id in report.finished or action.id in report.interrupted
            lost = action.status == "accepted" and action.id not in report.running
            if action.status == "unknown":  # a node that knows no more than that is not asked again
                ended, lost = action.id in report.finished and not action.looks, False
            if action.status != "reported" and (ended or lost):
                self._dispatcher.find_out(action.id)

    async def _listen(self) -> None:
        """Miss the nodes whose heartbeat has stopped, and those that only the log remembers. A token alone
        does not count for ever: word of its end may have come before word of itself."""
        while True:
            await asyncio.sleep(self._silence_s / 4)
            now = self._kernel.clock.monotonic()
            try:
                modules = list(self._kernel.state.modules.by_name.items())
            except StoreError:
                continue
            for name, module in modules:
                if module.status != "GONE":
                    self._heard.setdefault((name, module.instance), now)
            for (name, instance), heard in list(self._heard.items()):
                if now - heard > self._silence_s:
                    self._forget(name, instance)
                    self._lose(name, instance, f"no heartbeat for {now - heard:.0f} s")
                    if self._living.get(name):
                        self._spawn(self._greet(name))

    # -- inside ------------------------------------------------------------------------------

    async def _query(self, module: ModuleName, operation: str) -> bytes:
        return await self._bus.query(self._keys.operation(module, operation), b"{}", self._answer_s)

    def _spawn(self, work: Coroutine[Any, Any, None]) -> None:
        task = asyncio.get_running_loop().create_task(work)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)


def _known(actions: Actions, module: ModuleName, name: ActionId) -> bool:
    return name in actions.open or name in actions.settled or name in actions.ended.get(module, ())

"""Keeps track of the nodes of modules: which are on the bus, and which are missing.

A node is present while its liveliness token exists. It is silent if its heartbeat stops although the token
exists (otherwise a running process with a blocked interpreter would not be noticed).

Tokens and heartbeats can be forged. They only cause a question to the process that serves the module's keys,
never more than one at a time, and only for modules that the lab has.
"""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Callable, Sequence

import msgspec
import structlog

from labos.core.actions import ActionStatus
from labos.core.decide import Rejection
from labos.core.decide.nodes import HearJournal, JoinNode, LoseNode, RecordStops, ReportState
from labos.core.decide.shorter import FoundAction
from labos.core.ids import ActionId, ModuleName, local
from labos.core.lab import WorkcellApplied
from labos.core.modules import ModuleStatus
from labos.core.texts import LONGEST_NAME, cut
from labos.errors import BusError, LabosError, NoAnswer, StoreError, Unreadable
from labos.node.journal import knows_more
from labos.node.protocol import AboutReport, AdminRequest, Keys, StateReport, explain_skew
from labos.ports import Bus
from labos.runtime.discovery import Discovery
from labos.runtime.dispatcher import Dispatcher
from labos.runtime.incoming import RateLimiter, find_module, read_about, read_state
from labos.runtime.kernel import Kernel
from labos.runtime.ledger import Entry
from labos.runtime.liveness import Liveness
from labos.runtime.tasks import KernelPart

GREET_S = 0.1
"""The shortest pause between two requests to one node for its description."""

LEAVE_S = 2.0
"""The longest wait for the message of the bus that a node is gone, after its process has ended."""

TWO_NODES = "two nodes claim this module"

_log = structlog.get_logger(__name__)


class Registry(KernelPart):
    """Keeps the modules slice up to date with the nodes on the bus. A node counts as gone after ``silence_s``
    without a heartbeat; a node that obeys another kernel is asked again after ``barred_s``. ``is_stopping``
    tells whether a module's node was ordered to end."""

    def __init__(
        self,
        kernel: Kernel,
        bus: Bus,
        dispatcher: Dispatcher,
        *,
        silence_s: float = 10.0,
        answer_s: float = 5.0,
        barred_s: float = 30.0,
        is_stopping: Callable[[ModuleName], bool] = lambda _: False,
    ) -> None:
        super().__init__(kernel)
        self._bus, self._dispatcher = bus, dispatcher
        self._is_stopping = is_stopping
        self._silence_s, self._answer_s, self._barred_s = silence_s, answer_s, barred_s
        self.lab = kernel.lab
        self._keys = Keys(kernel.lab)
        self._living = Liveness()
        self._greeting: dict[ModuleName, bool] = {}
        self._discovery = Discovery(kernel, self._ask_about, self._tasks)
        self._changes = RateLimiter(kernel.clock, 0.2, 50)
        self._doubled: dict[ModuleName, float] = {}
        self._barred: dict[ModuleName, float] = {}
        self._starts: list[tuple[int, int]] = []
        self._left = asyncio.Event()
        self.rejected: dict[ModuleName, str] = {}
        self.metrics: dict[ModuleName, str] = {}
        """The addresses (``host:port``) of the metrics of the nodes that joined last."""

    async def start(self) -> None:
        """Watch from now on. Nodes that are present in the log but not running are recorded as gone."""
        await super().start()
        self._dispatcher.refuse = self._refuse
        self._handles.append(await self._bus.subscribe(self._keys.all_states, self._on_state))
        self._handles.append(await self._bus.watch_alive(self._keys.all_alive, self._on_alive))
        self._tasks.spawn(self._listen())

    @property
    def living(self) -> list[ModuleName]:
        """Modules with a node on the bus, whatever the log says."""
        return self._living.modules

    def on_committed(self, entries: Sequence[Entry]) -> None:
        """The nodes of new modules may be waiting."""
        if any(isinstance(entry.event, WorkcellApplied) for entry in entries):
            self.on_reopened()

    def on_reopened(self) -> None:
        for module in self._living.modules:
            self._greet_soon(module)

    # -- liveliness --------------------------------------------------------------------------

    def _on_alive(self, key: str, living: bool) -> None:
        module, instance = find_module(key, self._keys.all_alive), key.rpartition("/")[2]
        if module is None:
            self._dispatcher.doubts.note("token_unreadable", "", cut(key, LONGEST_NAME))
        elif living:
            if self._hear(module, instance):
                self._greet_soon(module)
        else:
            self._living.forget(module, instance)
            self._lose(module, instance, "it does not answer (gone or frozen)")
            self._left.set()
            self._greet_soon(module)
            self._drop_stranger(module)

    async def wait_until_nodes_left(self, modules: Sequence[str]) -> None:
        """Wait until the log has recorded that the nodes of ``modules``, whose processes have ended, are
        gone. The bus reports this a little later than the end of a process."""
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(LEAVE_S):
                while any(self._living.list_instances(ModuleName(module)) for module in modules):
                    self._left.clear()
                    await self._left.wait()

    def _hear(self, module: ModuleName, instance: str) -> bool:
        """Note that an instance is alive; false if this is of no interest."""
        try:
            known = self._kernel.state.modules.by_name
        except StoreError:
            known = {}
        keep = known[module].instance if module in known else ""
        now = self._kernel.clock.monotonic()
        others = None if module in known else len(known)
        heard = self._living.remember(module, instance, now, keep, others)
        if not heard:
            self._dispatcher.doubts.note("too_many_nodes", "", f"there is another node of {module}")
        return heard

    def _drop_stranger(self, module: ModuleName) -> None:
        """Forget why a module was rejected, if no workcell has it."""
        if not self._living.list_instances(module) and not self._dispatcher.doubts.has(module):
            self.rejected.pop(module, None)

    def _greet_soon(self, module: ModuleName) -> None:
        """Ask the node of a module for its description; if a request is in progress, once more afterwards."""
        if not self._living.list_instances(module):
            return
        if module in self._greeting:
            self._greeting[module] = True
            return
        self._greeting[module] = False
        self._tasks.spawn(self._query_while_requested(module))

    async def _query_while_requested(self, module: ModuleName) -> None:
        try:
            await self._greet(module)
            while self._greeting[module]:
                self._greeting[module] = False
                await asyncio.sleep(GREET_S)
                await self._greet(module)
        except StoreError:
            pass  # greeted again when the log is open
        except LabosError as error:
            self._dispatcher.doubts.note("not_greeted", module, str(error))
        finally:
            del self._greeting[module]

    async def _greet(self, module: ModuleName) -> None:
        """Ask a running node for its description, and let it join. Raises StoreError."""
        pause = GREET_S
        while self._living.list_instances(module):
            if module not in self._kernel.state.modules.by_name:
                self._reject(module, f"No workcell of this lab has a module {local(module)}.")
                return
            barred_s = self._barred.get(module, 0.0) - self._kernel.clock.monotonic()
            if barred_s > 0:
                await asyncio.sleep(barred_s)
                continue
            try:
                about = await self._ask_about(module)
                state = read_state(await self._query(module, "state"), str(module))
                if (about.instance, about.journal) != (state.instance, state.journal):
                    self.rejected[module] = TWO_NODES
                    raise NoAnswer(f"Two nodes answer for {module}, in turn.")
                if skew := explain_skew(about.protocol, "Its node", cut(about.labos, LONGEST_NAME)):
                    self._reject(module, skew)
                    return
                if about.epoch > self._kernel.epoch:
                    if self._is_second(module, about):
                        self.rejected[module] = TWO_NODES
                        return
                    await self._check_outranked(module, about.epoch)
                    continue
                strange = await self._discovery.find_unlogged(module, about.open)
                self._join(module, about, state, await self._find_position_beyond(about), strange)
                return
            except BusError as error:
                if isinstance(error, Unreadable):
                    self._reject(module, error.message, "node_unreadable")
                await asyncio.sleep(pause)
                pause = min(pause * 2, 2.0)

    def _is_second(self, module: ModuleName, about: AboutReport) -> bool:
        """Whether the module's own node is running besides the one that answered."""
        known = self._kernel.state.modules.by_name.get(module)
        if known is None or known.status == ModuleStatus.GONE or known.instance == about.instance:
            return False
        return known.instance in self._living.list_instances(module)

    def _reject(self, module: ModuleName, why: str, what: str = "node_not_admitted") -> None:
        self.rejected[module] = why
        self._dispatcher.doubts.note(what, module, why)

    async def _find_position_beyond(self, about: AboutReport) -> int:
        """The position up to which a node was acknowledged, if the log is shorter than that."""
        kernel = self._kernel
        if not about.acknowledged:
            return 0
        if about.acknowledged_by == kernel.epoch:
            starts: list[tuple[int, int]] = []
        else:
            starts = self._starts = self._starts or await kernel.list_starts()
        more = knows_more(about.acknowledged, about.acknowledged_by, kernel.durable, starts)
        return about.acknowledged if more else 0

    def _join(
        self,
        module: ModuleName,
        about: AboutReport,
        report: StateReport,
        beyond: int,
        strange: Sequence[FoundAction],
    ) -> None:
        description = about.description
        known = self._kernel.state.modules.by_name.get(module)
        # A node that only carries out our own request does not count as BUSY.
        busy_for_us = known is not None and not known.in_flight.keys().isdisjoint(report.running)
        status = "IDLE" if report.status == "BUSY" and busy_for_us else report.status
        if self._is_second(module, about):
            self.rejected[module] = TWO_NODES
        elif known is not None and known.status != ModuleStatus.GONE and known.instance != about.instance:
            self._lose(module, known.instance, "another process took its place")
        answer = self._kernel.submit(
            JoinNode(
                module,
                about.journal,
                about.instance,
                cut(str(description.get("driver", "")), LONGEST_NAME),
                cut(str(description.get("version", "")), LONGEST_NAME),
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
            self._dispatcher.doubts.note("node_not_admitted", module, f"{answer.message} {answer.remedy}")
            return
        self.metrics.pop(module, None)
        if about.metrics:
            self.metrics[module] = cut(about.metrics, LONGEST_NAME)
        if len(self._living.list_instances(module)) < 2:
            self.rejected.pop(module, None)
        if strange:  # a node that had joined before
            self._kernel.submit(HearJournal(module, tuple(strange)), str(module))
        if beyond:
            self._tasks.spawn(self._rewind(module))
        self._dispatcher.find_out_about(module)
        now = self._kernel.state.modules.by_name.get(module)
        if now is not None and now.instance == report.instance:
            self._compare_report(module, report)

    async def _rewind(self, module: ModuleName) -> None:
        """Let a node accept requests again at positions that were already acknowledged. If this message is
        lost, another one follows when the node joins again. The module is out of service meanwhile."""
        try:
            await self._kernel.flush()
            request = AdminRequest(
                self._kernel.lab, self._kernel.epoch, "rewind", {"position": self._kernel.durable}
            )
            key = self._keys.operation(module, "admin")
            await self._bus.query(key, msgspec.json.encode(request), self._answer_s)
        except (BusError, StoreError) as error:
            _log.warning("journal_not_rewound", module=module, why=str(error))

    def _lose(self, module: ModuleName, instance: str, why: str) -> None:
        stopped = self._is_stopping(module)
        reason = "LabOS has requested its end" if stopped else why
        try:
            self._kernel.submit(LoseNode(module, instance, reason, stopped), str(module))
        except LabosError as error:
            _log.info("loss_not_written", module=module, why=str(error))  # seen again when the log is open

    # -- other kernels -----------------------------------------------------------------------

    async def _check_outranked(self, module: ModuleName, epoch: int) -> None:
        """A node obeys a later kernel. If the database calls this one the lab's kernel, the module is
        refused. Raises StoreError; the kernel stops if it is Fenced."""
        await self._kernel.check_lease()
        why = f"it obeys the kernel of epoch {epoch}; this one's is {self._kernel.epoch}"
        self._keep_out(module, f"{why}: see labos db restored")
        self._dispatcher.doubts.outrank(module, epoch)

    def _refuse(self, module: ModuleName, why: str) -> None:
        """A node does not obey this kernel, although it is the lab's kernel. Nothing more is requested from
        the node until its own description shows which kernel it obeys."""
        self._keep_out(module, why)
        self._tasks.spawn(self._refuse_after_asking(module, why))

    async def _refuse_after_asking(self, module: ModuleName, why: str) -> None:
        try:
            about = await self._ask_about(module)
            if about.epoch > self._kernel.epoch:
                self._dispatcher.doubts.outrank(module, about.epoch)
                return
        except (BusError, StoreError) as error:
            _log.info("not_said_whom_it_obeys", module=module, why=str(error))
        self._dispatcher.doubts.ask(module, f"it refuses this kernel: {why.rstrip('.')}")

    def _keep_out(self, module: ModuleName, why: str) -> None:
        self.rejected[module] = why
        self._barred[module] = self._kernel.clock.monotonic() + self._barred_s
        try:
            known = self._kernel.state.modules.by_name.get(module)
        except StoreError:
            return  # its node reports it again when the log is open
        if known is not None and known.status != ModuleStatus.GONE:
            self._lose(module, known.instance, why)
            self._greet_soon(module)

    # -- heartbeats --------------------------------------------------------------------------

    def _on_state(self, key: str, payload: bytes) -> None:
        module = find_module(key, self._keys.all_states)
        if module is None:
            return
        try:
            report = read_state(payload, str(module))
            if not self._hear(module, report.instance):
                return
            known = self._kernel.state.modules.by_name.get(module)
            if known is None or known.status == ModuleStatus.GONE:
                self._greet_soon(module)
            elif (known.instance, known.journal) == (report.instance, report.journal):
                self._compare_report(module, report)
        except NoAnswer as error:
            self._dispatcher.doubts.note("state_unreadable", module, error.message)
        except LabosError as error:
            _log.debug("state_dropped", module=module, why=str(error))  # the next one follows

    def _compare_report(self, module: ModuleName, report: StateReport) -> None:
        """Compare a heartbeat with the log: the node's status, and actions of ours that have ended or never
        arrived."""
        state = self._kernel.state
        known = state.modules.by_name.get(module)
        if known is None:
            return
        mine = [state.actions.open[name] for name in known.in_flight]
        for name in map(ActionId, report.running):
            if name in state.actions.ended.get(module, ()):
                self._dispatcher.report_settled(module, name, done=False)
        stopped = report.stopped_at and report.stopped_at != known.stopped_at
        if stopped and self._changes.spend(module):
            self._kernel.submit(RecordStops(report.stopped_by, {module: report.stopped_at}), str(module))
        status = report.status
        if status == "BUSY" and any(action.id in report.running for action in mine):
            status = "IDLE"
        # If a node changes its status too often, the next heartbeat brings the present one.
        if (status, report.error) != (known.status, known.error) and self._changes.spend(module):
            self._kernel.submit(ReportState(module, status, report.error), str(module))
        for action in mine:
            ended = action.id in report.finished or action.id in report.interrupted
            lost = action.status == ActionStatus.ACCEPTED and action.id not in report.running
            if action.status == ActionStatus.UNKNOWN:  # a node that has no further facts is not asked again
                ended, lost = action.id in report.finished and not action.looks, False
            if action.status != ActionStatus.REPORTED and (ended or lost):
                self._dispatcher.find_out(action.id)
        self._discovery.compare(module, report)

    async def _listen(self) -> None:
        """Record nodes as gone if their heartbeat has stopped, or if only the log still has them. A token
        alone is not enough for long: the bus may report the end of a token before its beginning."""
        while True:
            await asyncio.sleep(self._silence_s / 4)
            try:
                self._miss_silent()
            except StoreError:
                continue
            except LabosError as error:
                _log.error("silence_not_noticed", why=str(error))

    def _miss_silent(self) -> None:
        now = self._kernel.clock.monotonic()
        modules = self._kernel.state.modules.by_name
        for name, module in modules.items():
            if module.status != ModuleStatus.GONE:
                self._living.expect(name, module.instance, now)
        for name, instance, silent_s in self._living.list_silent(now, self._silence_s):
            self._living.forget(name, instance)
            self._lose(name, instance, f"no heartbeat for {silent_s:.0f} s")
            self._greet_soon(name)
            self._drop_stranger(name)
        for name in list(modules):
            self._report_double(name, now)

    def _report_double(self, module: ModuleName, now: float) -> None:
        """Report two nodes with the same name if both stay alive: then the second one is not a replacement of
        the first."""
        known = self._kernel.state.modules.by_name[module]
        living = self._living.list_instances(module)
        if known.status == ModuleStatus.GONE or known.instance not in living or len(living) < 2:
            if self._doubled.pop(module, None) is not None:
                self.rejected.pop(module, None)
            return
        since = self._doubled.setdefault(module, now)
        if now - since > self._silence_s:
            self.rejected[module] = TWO_NODES
            others = ", ".join(cut(i, 40) for i in living if i != known.instance)
            self._dispatcher.doubts.ask(
                module, f"besides the node that is in use ({known.instance}) others use its name: {others}"
            )

    # -- internal ----------------------------------------------------------------------------

    async def _ask_about(self, module: ModuleName) -> AboutReport:
        return read_about(await self._query(module, "about"), str(module))

    async def _query(self, module: ModuleName, operation: str) -> bytes:
        return await self._bus.query(self._keys.operation(module, operation), b"{}", self._answer_s)

"""The dispatcher sends committed requests to nodes, and submits their answers to the kernel.

It decides nothing. If a message is lost, ``find_out`` asks the node. If the node does not know the attempt,
it first makes sure that the attempt can never run, and then says so; only then is the next attempt made.

Anybody can publish on the bus. A published result counts only if it has the key of the requested module and
fits the request. In all other cases the node itself is asked.
"""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Callable, Sequence
from functools import partial

import msgspec
import structlog

from labos.core.actions import (
    Action,
    ActionFailed,
    ActionReconciled,
    ActionRejected,
    ActionRequested,
    ActionStatus,
    ActionSucceeded,
    explain_disbelief,
    find_device_time,
)
from labos.core.decide.actions import (
    AcceptAction,
    DoubtAction,
    FinishAction,
    RefuseAction,
    ResendAction,
)
from labos.core.effects import Carrying, Needs
from labos.core.ids import ActionId, ModuleName
from labos.core.interventions import InterventionRequested
from labos.core.modules import ModuleStatus
from labos.core.structs import make_from
from labos.core.texts import LONGEST_NAME, cut
from labos.core.topics import PlannedWork
from labos.errors import BusError, LabosError, StoreError, Unreadable
from labos.node.protocol import (
    Acknowledge,
    ActionReply,
    AdminRequest,
    Ask,
    JointStart,
    Keys,
    Outcome,
    ResultPublished,
    Start,
)
from labos.ports import Bus
from labos.runtime.doubts import Doubts
from labos.runtime.incoming import RateLimiter, find_module, read_reply, read_result
from labos.runtime.kernel import Kernel
from labos.runtime.ledger import Entry
from labos.runtime.tasks import KernelPart, Tasks

_log = structlog.get_logger(__name__)
_encode = msgspec.json.Encoder().encode

ENDS = (ActionSucceeded, ActionFailed, ActionRejected, ActionReconciled)

SETTLED_S = 1.0
"""How long a start waits until its module is informed that a person's work there has ended."""

LONGEST_PAUSE_S = 5.0
"""The longest pause between questions to a node that does not answer."""

LATE_QUESTIONS = 20
"""How often a node is asked about a result that came late."""

MOST_ATTEMPTS = 2**31
"""A number of attempts that no action reaches."""


class Dispatcher(KernelPart):
    """Sends the requests of one kernel. ``answer_s`` is how long a node may take to accept; acknowledgements
    wait ``acknowledge_s``, so that several are sent as one."""

    def __init__(
        self, kernel: Kernel, bus: Bus, *, answer_s: float = 5.0, acknowledge_s: float = 1.0
    ) -> None:
        super().__init__(kernel)
        self._bus = bus
        self._answer_s, self._acknowledge_s = answer_s, acknowledge_s
        self._keys = Keys(kernel.lab)
        self.doubts = Doubts(kernel)
        self.refuse: Callable[[ModuleName, str], None] = self.doubts.ask
        """Called for a module whose node does not obey this kernel, although it is the lab's kernel."""
        self._spawn = self._tasks.spawn
        self._questions = Tasks()
        self._starting: dict[ActionId, tuple[ModuleName, str]] = {}
        self._unacknowledged: set[ModuleName] = set()
        self._open_at: dict[ModuleName, dict[ActionId, int]] = {}
        self._by_person: set[str] = set()
        self._reporting: dict[ModuleName, dict[ActionId, asyncio.Task[None]]] = {}
        self._late: set[ActionId] = set()
        self._prompted = RateLimiter(kernel.clock, 0.1, 50)
        self.sent = 0
        self.asked = 0

    async def start(self) -> None:
        """Receive results from now on, and ask about everything that was in flight."""
        await super().start()
        self._handles.append(await self._bus.subscribe(self._keys.all_results, self._on_result))
        self.on_reopened()

    async def close(self) -> None:
        await super().close()
        await self._questions.end()

    # -- from the log ------------------------------------------------------------------------

    def on_committed(self, entries: Sequence[Entry]) -> None:
        for entry in entries:
            event = entry.event
            if isinstance(event, ActionRequested):
                self._open_at.setdefault(event.module, {})[event.action] = entry.position
                self._spawn(self._send(event, entry.position))
            elif isinstance(event, ENDS):
                self._open_at.get(event.module, {}).pop(event.action, None)
                if event.action in self._by_person:
                    self._by_person.discard(event.action)
                    self.report_settled(event.module, event.action, done=isinstance(event, ActionSucceeded))
                self._acknowledge_soon(event.module)
            elif isinstance(event, InterventionRequested) and event.kind == PlannedWork.KIND:
                self._by_person.add(event.subject)

    def on_reopened(self) -> None:
        """Ask about everything that is open. A question that is still unanswered may be about an attempt that
        was never written; its answer says nothing about the attempt in the log."""
        self._questions.cancel()
        self._starting.clear()
        self._open_at.clear()
        asked = self._kernel.state.interventions.open.values()
        self._by_person = {question.subject for question in asked if question.kind == PlannedWork.KIND}
        for action in self._kernel.state.actions.open.values():
            self._open_at.setdefault(action.module, {})[action.id] = action.position
            self.find_out(action.id)

    # -- to nodes ----------------------------------------------------------------------------

    async def _send(self, event: ActionRequested, position: int) -> None:
        start = make_start(event, self._kernel.lab, position)
        self.sent += 1
        if reports := self._reporting.get(event.module):  # which has to be sent first
            await asyncio.wait(list(reports.values()), timeout=SETTLED_S)
        reply = None
        self._starting[event.action] = (event.module, self._find_instance(event.module))
        try:
            with contextlib.suppress(BusError):
                reply = await self._ask_node(event.module, start)
        finally:
            self._starting.pop(event.action, None)
        if reply is None:
            self.find_out(event.action)
            return
        self._take_answer(event.action, event.attempt, event.journal, reply, started=True)

    def report_settled(self, module: ModuleName, action: ActionId, *, done: bool) -> None:
        """Inform a node that a person has settled an action which may still run there; if this message is
        lost, the next heartbeat brings another one."""
        reports = self._reporting.setdefault(module, {})
        if action not in reports:
            reports[action] = self._spawn(self._report_settled(module, action, done))

    async def _report_settled(self, module: ModuleName, action: ActionId, done: bool) -> None:
        args = {"action": action, "done": done}
        try:
            request = AdminRequest(self._kernel.lab, self._kernel.epoch, "settled", args)
            await self._bus.query(self._keys.operation(module, "admin"), _encode(request), self._answer_s)
        except (BusError, StoreError) as error:
            _log.info("settled_not_reported", module=module, action=action, why=str(error))
        finally:
            reports = self._reporting[module]
            del reports[action]
            if not reports:
                del self._reporting[module]

    def find_out(self, action: ActionId) -> None:
        """Ask the node for the outcome of an action until it is known; only one question at a time. A node
        that has not answered the request yet is not asked: the question could overtake the request, and end
        the attempt."""
        if not self._is_being_started(action):
            self._questions.spawn_once(action, partial(self._find_out, action))

    def find_out_about(self, module: ModuleName) -> None:
        """Ask the node of a module for the outcome of everything that is open there. Raises StoreError."""
        for action in self._kernel.state.actions.open.values():
            if action.module == module:
                self.find_out(action.id)

    async def _find_out(self, name: ActionId) -> None:
        pause = 0.2
        try:
            while True:
                action = self._open(name)
                if action is None or action.looks:
                    return
                if self._kernel.state.modules.by_name[action.module].status == ModuleStatus.GONE:
                    return  # asked again when the node is back
                question = Ask(
                    self._kernel.lab, self._kernel.epoch, name, action.attempt, action.position, void=True
                )
                self.asked += 1
                try:
                    reply = await self._ask_node(action.module, question)
                except BusError:
                    await asyncio.sleep(pause)
                    pause = min(pause * 2, LONGEST_PAUSE_S)
                    continue
                self._take_answer(name, action.attempt, action.journal, reply)
                return
        except StoreError as error:
            _log.info("question_given_up", action=name, why=str(error))

    def _acknowledge_soon(self, module: ModuleName) -> None:
        """One acknowledgement for all actions that end within a moment."""
        if module not in self._unacknowledged:
            self._unacknowledged.add(module)
            self._spawn(self._acknowledge(module))

    async def _acknowledge(self, module: ModuleName) -> None:
        """Inform a node up to which position it may discard entries; if this message is lost, a later one
        replaces it."""
        await asyncio.sleep(self._acknowledge_s)
        self._unacknowledged.discard(module)
        open_at = self._open_at.get(module)
        # Events that are decided but not yet on disk must not be acknowledged.
        position = min(open_at.values()) - 1 if open_at else self._kernel.durable
        try:
            await self._ask_node(module, Acknowledge(self._kernel.lab, self._kernel.epoch, position))
        except (BusError, StoreError) as error:
            _log.debug("not_acknowledged", module=module, why=str(error))

    async def _ask_node(self, module: ModuleName, message: Start | Ask | Acknowledge) -> ActionReply:
        key = self._keys.operation(module, "action")
        payload = await self._bus.query(key, _encode(message), self._answer_s)
        try:
            return read_reply(payload, str(module))
        except Unreadable as error:
            self.doubts.ask(module, error.message.rstrip("."))
            raise

    # -- answers -----------------------------------------------------------------------------

    def _take_answer(
        self, name: ActionId, attempt: int, journal: str, reply: ActionReply, *, started: bool = False
    ) -> None:
        try:
            self._act_on(name, attempt, journal, reply, started)
        except LabosError as error:
            _log.info("answer_dropped", action=name, why=str(error))  # asked again after reopening

    def _act_on(self, name: ActionId, attempt: int, journal: str, reply: ActionReply, started: bool) -> None:
        """Handle the answer to a start (``started``) or to a question."""
        kernel = self._kernel
        action = self._open(name)
        if action is None or action.attempt != attempt:
            return
        by = str(action.module)
        if reply.status == "fenced":
            self.note_outranked(action.module, reply.why)
        elif reply.journal != journal:
            kernel.submit(DoubtAction(name, "its node has lost the journal with its outcome"), by)
        elif not 0 <= reply.attempt <= attempt:
            why = f"its node reports attempt {cut(str(reply.attempt), 30)}, which was never sent"
            kernel.submit(DoubtAction(name, why), by)
        elif reply.status in ("accepted", "running"):
            kernel.submit(AcceptAction(name, attempt, kernel.clock.now_ns()), by)
        elif reply.status == "finished" and reply.outcome is not None:
            self._finish(action, reply.attempt or attempt, reply.journal, reply.outcome)
        elif reply.status == "refused" and started:
            kernel.submit(RefuseAction(name, attempt, reply.why, final=not reply.transient), by)
        elif reply.status == "void" and action.status == ActionStatus.UNKNOWN:
            kernel.submit(RefuseAction(name, attempt, "it was never started there", final=False), by)
        elif reply.status == "void":
            kernel.submit(ResendAction(name, attempt, journal), by)
        elif reply.status == "interrupted":
            kernel.submit(DoubtAction(name, reply.why or "its node was restarted in mid-motion"), by)
        elif reply.status == "unheard":
            self.find_out(name)
        else:
            # Also if the node refuses to answer: the action may be running all the same.
            kernel.submit(DoubtAction(name, f"its node says {reply.status}: {reply.why}"), by)

    def _finish(self, action: Action, attempt: int, journal: str, outcome: Outcome) -> None:
        ended_ns = find_device_time(action, outcome.ended_ns, self._kernel.clock.now_ns())
        ids = {"action": action.id, "attempt": attempt, "journal": journal}
        report = make_from(FinishAction, outcome, **ids, ended_ns=ended_ns)
        self._kernel.submit(report, str(action.module))

    # -- publications ------------------------------------------------------------------------

    def _on_result(self, key: str, payload: bytes) -> None:
        module = find_module(key, self._keys.all_results)
        if module is None:
            return
        try:
            self._hear(module, key.rpartition("/")[2], read_result(payload, str(module)))
        except Unreadable as error:
            self.doubts.note("result_unreadable", module, error.message)
        except LabosError as error:
            self.doubts.note("result_dropped", module, str(error))  # pulled again later

    def _hear(self, module: ModuleName, named: str, result: ResultPublished) -> None:
        """Accept a result if it fits the request that it answers; if not, ask the node of the request."""
        name = ActionId(result.action)
        action = self._open(name)
        if action is None:
            settled = self._kernel.state.actions.settled.get(name)
            if settled is not None and settled.module == module and 0 < result.attempt < MOST_ATTEMPTS:
                self._ask_late(module, name, result.attempt)
            return
        ended_ns = find_device_time(action, result.outcome.ended_ns, self._kernel.clock.now_ns())
        why = explain_disbelief(action, module, result.journal, result.attempt)
        if not why and named != result.action:
            why = f"it came under the key of action {named}"
        if ended_ns and not why:
            self._finish(action, result.attempt, result.journal, result.outcome)
            return
        of_earlier = module == action.module and 0 < result.attempt < action.attempt
        if why and not of_earlier:  # such a result may have been delayed for long
            what = f"a result of its action {action.name!r} was published that does not match"
            self.doubts.ask(action.module, f"{what}: {cut(why, 2 * LONGEST_NAME)}")
        if self._prompted.spend(action.module):  # else its heartbeat will show it
            self.find_out(name)

    def _ask_late(self, module: ModuleName, name: ActionId, attempt: int) -> None:
        """Ask a node for the outcome of an action that was settled without it."""
        if name not in self._late and self._prompted.spend(module):
            self._late.add(name)
            self._spawn(self._on_late_result(module, name, attempt))

    async def _on_late_result(self, module: ModuleName, name: ActionId, attempt: int) -> None:
        """The node's own answer is recorded as evidence."""
        pause = 0.2
        try:
            for _ in range(LATE_QUESTIONS):
                known = self._kernel.state.modules.by_name.get(module)
                if known is None or name not in self._kernel.state.actions.settled:
                    return
                try:
                    question = Ask(self._kernel.lab, self._kernel.epoch, name, attempt, 1)
                    reply = await self._ask_node(module, question)
                except BusError:
                    await asyncio.sleep(pause)
                    pause = min(pause * 2, LONGEST_PAUSE_S)
                    continue
                outcome = reply.outcome if reply.status == "finished" else None
                if outcome is not None and reply.journal == known.journal and 0 < reply.attempt <= attempt:
                    report = make_from(FinishAction, outcome, action=name, attempt=reply.attempt, ended_ns=0)
                    self._kernel.submit(report, str(module))
                return
        except LabosError as error:
            _log.info("late_result_dropped", action=name, why=str(error))
        finally:
            self._late.discard(name)

    # -- other kernels -----------------------------------------------------------------------

    def note_outranked(self, module: ModuleName, why: str) -> None:
        """A node reports that it obeys a newer kernel, or another lab's. Only the database can tell whether
        that is true."""
        self._tasks.spawn_once(module, partial(self._check_outranked, module, why))

    async def _check_outranked(self, module: ModuleName, why: str) -> None:
        try:
            await self._kernel.check_lease()
        except StoreError as error:
            _log.warning("lease_not_known", module=module, why=str(error))
            await asyncio.sleep(LONGEST_PAUSE_S)
            with contextlib.suppress(StoreError):  # asked again when the log is open
                self.find_out_about(module)  # unless another kernel has the lab: then this one has stopped
        else:
            self.refuse(module, why)

    # -- internal ----------------------------------------------------------------------------

    def _is_being_started(self, name: ActionId) -> bool:
        """Whether the module's present node process has not yet answered the request."""
        if name not in self._starting:
            return False
        module, instance = self._starting[name]
        return instance != "" and instance == self._find_instance(module)

    def _find_instance(self, module: ModuleName) -> str:
        """The present process of the module's node; empty while the log is read again."""
        try:
            return self._kernel.state.modules.by_name[module].instance
        except StoreError:
            return ""

    def _open(self, name: ActionId) -> Action | None:
        return self._kernel.state.actions.open.get(name)


def make_start(event: ActionRequested, lab: str, position: int) -> Start:
    """The message to a node for a committed request."""
    effects = tuple(e for e in event.effects if isinstance(e, Carrying | Needs))
    kind = JointStart if event.together else Start
    return make_from(kind, event, lab=lab, position=position, effects=effects)

"""The dispatcher carries committed requests to nodes and their answers back to the kernel.

It decides nothing. Whatever gets lost on the way, ``find_out`` asks the node, which makes an
attempt it never heard of impossible before it says so; only then is the next attempt made.
"""

from __future__ import annotations

import asyncio
from collections.abc import Coroutine, Sequence
from typing import Any

import msgspec
import structlog

from labos.core.actions import (
    Action,
    ActionFailed,
    ActionReconciled,
    ActionRejected,
    ActionRequested,
    ActionSucceeded,
)
from labos.core.decide.actions import (
    AcceptAction,
    DoubtAction,
    FinishAction,
    RefuseAction,
    ResendAction,
)
from labos.core.effects import Move, Needs, Take
from labos.core.ids import ActionId, ModuleName
from labos.core.interventions import PLANNED_WORK, InterventionRequested
from labos.core.state import LabState
from labos.errors import Fenced, NoAnswer, StoreError
from labos.node.protocol import (
    Acknowledge,
    ActionReply,
    AdminRequest,
    Ask,
    Keys,
    Outcome,
    ResultPublished,
    Start,
)
from labos.ports import Bus, Handle
from labos.runtime.kernel import Kernel
from labos.runtime.ledger import Entry

_log = structlog.get_logger(__name__)
_encode = msgspec.json.Encoder().encode
_decode_reply = msgspec.json.Decoder(ActionReply).decode
_decode_result = msgspec.json.Decoder(ResultPublished).decode

ENDS = (ActionSucceeded, ActionFailed, ActionRejected, ActionReconciled)


class Dispatcher:
    """One kernel's carrier. ``answer_s`` is how long a node may take to say that it accepts;
    ``pause_s`` the longest pause between questions to a node that does not answer;
    acknowledgements wait ``acknowledge_s`` for more to come."""

    def __init__(
        self,
        kernel: Kernel,
        bus: Bus,
        *,
        answer_s: float = 5.0,
        pause_s: float = 5.0,
        acknowledge_s: float = 1.0,
    ) -> None:
        self._kernel, self._bus = kernel, bus
        self._answer_s, self._pause_s, self._acknowledge_s = answer_s, pause_s, acknowledge_s
        self._keys = Keys(kernel.lab)
        self._tasks: set[asyncio.Task[None]] = set()
        self._asking: dict[ActionId, asyncio.Task[None]] = {}
        self._handles: list[Handle] = []
        self._unacknowledged: set[ModuleName] = set()
        self._open_at: dict[ModuleName, dict[ActionId, int]] = {}
        self._by_person: set[str] = set()
        self._telling: set[asyncio.Task[None]] = set()
        self.sent = 0
        self.asked = 0

    async def start(self) -> None:
        """Hear results from now on, and find out about everything that was in flight."""
        self._kernel.listeners.append(self)
        self._handles.append(await self._bus.subscribe(self._keys.all_results, self._on_result))
        self.reopened()

    async def close(self) -> None:
        if self in self._kernel.listeners:
            self._kernel.listeners.remove(self)
        for handle in self._handles:
            handle.close()
        for task in list(self._tasks):
            task.cancel()

    # -- from the log ------------------------------------------------------------------------

    def committed(self, entries: Sequence[Entry]) -> None:
        for entry in entries:
            event = entry.event
            if isinstance(event, ActionRequested):
                self._open_at.setdefault(event.module, {})[event.action] = entry.position
                self._spawn(self._send(event, entry.position))
            elif isinstance(event, ENDS):
                self._open_at.get(event.module, {}).pop(event.action, None)
                if event.action in self._by_person:
                    self._by_person.discard(event.action)
                    self.tell_settled(event.module, event.action, done=isinstance(event, ActionSucceeded))
                self._acknowledge_soon(event.module)
            elif isinstance(event, InterventionRequested) and event.kind == PLANNED_WORK:
                self._by_person.add(event.subject)

    def reopened(self) -> None:
        """Ask about everything that is open. Who is still being asked may be asked about an attempt that was
        never written, and such an answer says nothing about the one that was."""
        for asking in self._asking.values():
            asking.cancel()
        self._asking.clear()
        self._open_at.clear()
        asked = self._kernel.state.interventions.open.values()
        self._by_person = {question.subject for question in asked if question.kind == PLANNED_WORK}
        for action in self._kernel.state.actions.open.values():
            self._open_at.setdefault(action.module, {})[action.id] = action.position
        for action in self._kernel.state.actions.open.values():
            self.find_out(action.id)

    # -- to nodes ----------------------------------------------------------------------------

    async def _send(self, event: ActionRequested, position: int) -> None:
        start = Start(
            lab=self._kernel.lab,
            epoch=event.epoch,
            journal=event.journal,
            action=event.action,
            attempt=event.attempt,
            position=position,
            name=event.name,
            args=event.args,
            files=event.files,
            effects=tuple(e for e in event.effects if isinstance(e, Move | Take | Needs)),
        )
        self.sent += 1
        if self._telling:  # a person's module has to know first that its work has ended
            await asyncio.wait(list(self._telling))
        try:
            reply = await self._ask_node(event.module, start)
        except NoAnswer:
            self.find_out(event.action)
            return
        self._heed(event.action, event.attempt, event.journal, reply)

    def tell_settled(self, module: ModuleName, action: ActionId, *, done: bool) -> None:
        """Tell a node that an action which may still run there has ended by a person's word; losing
        this costs a heartbeat."""
        task = self._spawn(self._tell_settled(module, action, done))
        self._telling.add(task)
        task.add_done_callback(self._telling.discard)

    async def _tell_settled(self, module: ModuleName, action: ActionId, done: bool) -> None:
        told = {"action": action, "done": done}
        request = AdminRequest(self._kernel.lab, self._kernel.epoch, "settled", told)
        try:
            await self._bus.query(self._keys.operation(module, "admin"), _encode(request), self._answer_s)
        except (NoAnswer, StoreError) as error:
            _log.info("not_told", module=module, action=action, why=str(error))

    def find_out(self, action: ActionId) -> None:
        """Ask the node what became of an action until it is known; once at a time."""
        running = self._asking.get(action)
        if running is None or running.done():
            self._asking[action] = self._spawn(self._find_out(action))

    async def _find_out(self, name: ActionId) -> None:
        pause = 0.2
        try:
            while True:
                action = self._open(name)
                if action is None or action.looks:
                    return
                if self._state().modules.by_name[action.module].status == "GONE":
                    return  # asked again when the node is back
                question = Ask(
                    self._kernel.lab, self._kernel.epoch, name, action.attempt, action.position, void=True
                )
                self.asked += 1
                try:
                    reply = await self._ask_node(action.module, question)
                except NoAnswer:
                    await asyncio.sleep(pause)
                    pause = min(pause * 2, self._pause_s)
                    continue
                self._heed(name, action.attempt, action.journal, reply)
                return
        except StoreError as error:
            _log.info("question_given_up", action=name, why=str(error))
        finally:
            if self._asking.get(name) is asyncio.current_task():
                del self._asking[name]

    def _acknowledge_soon(self, module: ModuleName) -> None:
        """One acknowledgement serves for all that ends within a moment."""
        if module not in self._unacknowledged:
            self._unacknowledged.add(module)
            self._spawn(self._acknowledge(module))

    async def _acknowledge(self, module: ModuleName) -> None:
        """Tell a node up to which position it may forget; losing this costs nothing."""
        await asyncio.sleep(self._acknowledge_s)
        self._unacknowledged.discard(module)
        open_at = self._open_at.get(module)
        # What is decided but not yet on disk must not be acknowledged.
        position = min(open_at.values()) - 1 if open_at else self._kernel.durable
        try:
            await self._ask_node(module, Acknowledge(self._kernel.lab, self._kernel.epoch, position))
        except (NoAnswer, StoreError):
            pass

    async def _ask_node(self, module: ModuleName, message: Start | Ask | Acknowledge) -> ActionReply:
        key = self._keys.operation(module, "action")
        payload = await self._bus.query(key, _encode(message), self._answer_s)
        try:
            return _decode_reply(payload)
        except msgspec.MsgspecError as error:
            raise NoAnswer(f"{module} answered what cannot be read ({error}).") from error

    # -- answers -----------------------------------------------------------------------------

    def _heed(self, name: ActionId, attempt: int, journal: str, reply: ActionReply) -> None:
        try:
            self._act_on(name, attempt, journal, reply)
        except StoreError as error:
            _log.info("answer_dropped", action=name, why=str(error))  # asked again after reopening

    def _act_on(self, name: ActionId, attempt: int, journal: str, reply: ActionReply) -> None:
        kernel = self._kernel
        action = self._open(name)
        if action is None or action.attempt != attempt:
            return
        by = str(action.module)
        if reply.status == "fenced":
            self.outranked(reply.why)
        elif reply.journal != journal:
            kernel.submit(DoubtAction(name, "its node has lost the journal that would know"), by)
        elif reply.status in ("accepted", "running"):
            kernel.submit(AcceptAction(name, attempt, kernel.clock.now_ns()), by)
        elif reply.status == "finished" and reply.outcome is not None:
            self._finish(name, reply.attempt or attempt, reply.outcome, by)
        elif reply.status == "refused":
            kernel.submit(RefuseAction(name, attempt, reply.why, final=not reply.transient), by)
        elif reply.status == "void" and action.status == "unknown":
            kernel.submit(RefuseAction(name, attempt, "it was never begun there", final=False), by)
        elif reply.status == "void":
            kernel.submit(ResendAction(name, attempt, journal), by)
        elif reply.status == "interrupted":
            kernel.submit(DoubtAction(name, reply.why or "its node was restarted in mid-motion"), by)
        elif reply.status == "unheard":
            self.find_out(name)
        else:
            kernel.submit(DoubtAction(name, f"its node says {reply.status}: {reply.why}"), by)

    def _finish(self, name: ActionId, attempt: int, outcome: Outcome, by: str) -> None:
        said = (outcome.succeeded, outcome.effects, outcome.result, outcome.error, outcome.ended_ns)
        self._kernel.submit(FinishAction(name, attempt, *said), by)

    def _on_result(self, key: str, payload: bytes) -> None:
        try:
            result = _decode_result(payload)
        except msgspec.MsgspecError as error:
            _log.warning("result_unreadable", key=key, error=str(error))
            return
        try:
            self._finish(ActionId(result.action), result.attempt, result.outcome, Keys.module_of(key))
        except StoreError as error:
            _log.info("result_dropped", action=result.action, why=str(error))  # pulled again later

    def outranked(self, why: str) -> None:
        """A node obeys a newer kernel, or another lab's: this one must not go on."""
        if not self._kernel.failed.done():
            remedy = (
                "Let the other kernel work. If there is none, this database is older than what its nodes "
                "have seen: say so with labos db restored, then start again."
            )
            self._kernel.failed.set_result(Fenced(why, remedy=remedy))

    # -- inside ------------------------------------------------------------------------------

    def _state(self) -> LabState:
        return self._kernel.state

    def _open(self, name: ActionId) -> Action | None:
        return self._state().actions.open.get(name)

    def _spawn(self, work: Coroutine[Any, Any, None]) -> asyncio.Task[None]:
        task = asyncio.get_running_loop().create_task(work)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)
        return task

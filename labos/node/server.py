"""The service that represents a module: it carries actions out, at most once each.

Every decision is made at once, in memory, between two awaits. The answer is sent, and the device moves, only
when the journal has the decision on disk. So if a start and a query that makes it void cross each other,
exactly one of them takes effect. Several decisions share one sync.
"""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Awaitable, Callable, Coroutine, Sequence
from typing import TYPE_CHECKING, Any, assert_never

import msgspec
import structlog

from labos.clock import Clock, Ids
from labos.core.canonical import digest, encode_canonical
from labos.core.effects import list_carried
from labos.core.model import ActionSpec
from labos.errors import ActionInvalid, DeviceError, OutcomeUnknown, Unreadable
from labos.node import arguments
from labos.node._admin import Admin
from labos.node._admission import Admission, NotAdmitted
from labos.node._condition import DeviceCondition
from labos.node._gathering import Gathering
from labos.node._name import claim
from labos.node._outcome import call, describe_error, find_outcome
from labos.node.files import Files, hand_over
from labos.node.journal import Attempt, Journal, JournalError
from labos.node.limits import NAME_LIMIT, TEXT_LIMIT, cut, find_flaw, read
from labos.node.node import INTERRUPTED, Node, current_action, current_together, handle_keeper
from labos.node.protocol import (
    AboutReport,
    Acknowledge,
    ActionMessage,
    ActionReply,
    Ask,
    JointStart,
    Keys,
    NodeStatus,
    Outcome,
    ResourcesReport,
    ResultPublished,
    Start,
    StateReport,
)
from labos.node.unit import find_pinned_unit
from labos.node.worker import Worker
from labos.version import VERSION

if TYPE_CHECKING:
    from labos.ports import Bus, Handle

STOPPED_BEFORE = "Stopped before it started."

_log = structlog.get_logger(__name__)
_encode = msgspec.json.Encoder().encode
_action_message: msgspec.json.Decoder[ActionMessage] = msgspec.json.Decoder(
    Start | JointStart | Ask | Acknowledge
)
_reset_message = msgspec.json.Decoder(Start)


class NodeServer:
    """Answers for one module on the bus.

    Plain ``def`` actions run in one thread of their own. ``files`` gives access to the lab's files; without
    it an action only gets their names. ``settle_s`` is how long to look for another node of this name,
    ``grace_s`` how long to wait for one that is going away. ``stopping`` is set when a shutdown was
    requested. ``metrics`` is the address in the answer of ``about``. ``on_end`` is called for each action
    that ends, with its outcome, or None if that is unknown.
    """

    def __init__(
        self,
        node: Node,
        bus: Bus,
        lab: str,
        journal: Journal,
        clock: Clock,
        ids: Ids,
        *,
        heartbeat_s: float = 2.0,
        idle_poll_s: float = 1.0,
        settle_s: float = 0.1,
        grace_s: float = 3.0,
        simulated: bool | None = None,
        files: Files | None = None,
        trace: Callable[[bool], str] | None = None,
        metrics: str = "",
        on_end: Callable[[str, Outcome | None], None] | None = None,
    ) -> None:
        self.node = node
        self.journal, self._memory = journal, journal.memory
        self.module = f"{node.setup.workcell}/{node.setup.name}"
        self.instance = ids.new()
        self.stopping = asyncio.Event()
        self._bus = bus
        self._keys = Keys(lab)
        self._clock = clock
        self._heartbeat_s = heartbeat_s
        self._settle_s = settle_s
        self._grace_s = grace_s
        self._metrics, self._on_end = metrics, on_end or (lambda action, outcome: None)
        self._simulated = node.setup.world is not None if simulated is None else simulated
        self._files = files
        self._worker = Worker("driver")
        self._description = node.describe()
        self._methods = node.methods()
        self._methods["reset"] = self._reset
        self._running: dict[str, asyncio.Task[None]] = {}
        self._begun: dict[str, Attempt] = {}
        self._unanswered: set[str] = set()
        self._by_person: set[str] = set()
        self._condition = DeviceCondition(
            node, idle_poll_s=idle_poll_s, changed=self._publish_state, spawn=self._spawn
        )
        self._admission = Admission(self.module, lab, journal)
        self._gathering = Gathering(journal)
        self._admin = Admin(
            self.module,
            node,
            clock,
            admission=self._admission,
            synced=self._sync_if_possible,
            fail=self._condition.fail,
            rewind=self.journal.rewind,
            shut_down=self.stopping.set,
            carrying=self._find_carrying_action,
            trace=trace,
        )
        self._handles: list[Handle] = []
        self._tasks: list[asyncio.Task[None]] = []
        self._closed = False
        self._retired = False
        self._alive: Handle | None = None

    # -- life --------------------------------------------------------------------------------

    async def start(self) -> None:
        """Take the module's name, answer requests, and connect the device. If the device does not answer, the
        node is in ERROR, but answers requests. Raises NameTaken."""
        waits = {"settle_s": self._settle_s, "grace_s": self._grace_s}
        name = await claim(self._bus, self._keys, self.module, self.instance, **waits)
        self._handles.append(name)
        left = self._find_left_running()
        for operation, handler in (
            ("about", self._on_about),
            ("action", self._on_action),
            ("reset", self._on_reset),
            ("resources", self._on_resources),
            ("state", self._on_state),
            ("admin", self._admin.on_request),
        ):
            key = self._keys.operation(self.module, operation)
            self._handles.append(await self._bus.serve(key, handler))
        self._alive = await self._bus.declare_alive(self._keys.alive(self.module, self.instance))
        self._handles.append(self._alive)
        self._spawn(self._send_heartbeats())
        await self._condition.connect()
        for attempt, spec in left:
            task = asyncio.get_running_loop().create_task(self._go_on(attempt, spec))
            self._running[attempt.action] = task
        if type(self.node).trouble is not Node.trouble:
            self._spawn(self._watch())

    async def retire(self) -> None:
        """Withdraw from the bus and accept no more actions; returns when the running ones have ended and
        their results are sent. A person's work continues without the node. Queries are answered until
        ``close``."""
        self._retired = True
        if self._alive is not None:
            self._alive.close()
        running = [task for name, task in self._running.items() if name not in self._by_person]
        if running:
            await asyncio.wait(running)

    async def close(self) -> None:
        """Release the name and the device. Running actions are broken off, and are interrupted in the
        journal."""
        if self._closed:
            return
        self._closed = True
        for handle in self._handles:
            handle.close()
        tasks = [*self._tasks, *self._running.values()]
        for task in tasks:
            task.cancel()
        if tasks:
            # A driver that ignores its cancellation must not keep the node from ending.
            await asyncio.wait(tasks, timeout=5.0)
        self._worker.close()
        try:
            await self.node.close()
        except Exception:
            _log.exception("device_not_closed", module=self.module)
        await self.journal.close()

    def is_at_work(self) -> bool:
        """Whether an action is being carried out."""
        return bool(self._running)

    @property
    def status(self) -> NodeStatus:
        return self._condition.status

    def state(self) -> StateReport:
        """The present answer of ``state``."""
        by_status: dict[str, list[str]] = {"running": [], "finished": [], "interrupted": []}
        for attempt in self._memory.list_attempts():
            by_status[attempt.status].append(attempt.action)
        return StateReport(
            status=self.status,
            journal=self._memory.id,
            instance=self.instance,
            **by_status,
            variables=self._admin.variables,
            error=self._condition.error,
            stopped_at=self._admin.stopped_at,
            stopped_by=self._admin.stopped_by,
        )

    def about(self) -> AboutReport:
        """The present answer of ``about``."""
        description = msgspec.to_builtins(self._description)
        return AboutReport(
            module=self.module,
            journal=self._memory.id,
            instance=self.instance,
            digest=digest(encode_canonical(description)),
            description=description,
            simulated=self._simulated,
            open=self._memory.list_unacknowledged(),
            epoch=self._memory.epoch,
            acknowledged=self._memory.pruned,
            acknowledged_by=self._memory.pruned_by,
            labos=VERSION,
            unit=find_pinned_unit(self.node.setup),
            firmware=cut(self.node.setup.firmware, NAME_LIMIT),
            metrics=self._metrics,
            now_ns=self._clock.now_ns(),
        )

    async def _watch(self) -> None:
        while True:
            await self._condition.look()
            await asyncio.sleep(self._heartbeat_s)

    async def _send_heartbeats(self) -> None:
        while True:
            await self._publish_state()
            await asyncio.sleep(self._heartbeat_s)

    # -- operations --------------------------------------------------------------------------

    async def _on_about(self, _: bytes) -> bytes:
        # Actions that are reported as open must still be in the journal after a crash.
        await self._sync_if_possible()
        return _encode(self.about())

    async def _on_state(self, _: bytes) -> bytes:
        return _encode(self.state())

    async def _on_resources(self, _: bytes) -> bytes:
        try:
            resources = await self.node.resources()
            levels = {str(name): float(level) for name, level in resources.items()}
            if flaw := find_flaw(levels):
                raise DeviceError(f"The levels of {self.module} cannot be sent: {flaw}.")
            return _encode(ResourcesReport(levels))
        except Exception as error:
            return _encode(ResourcesReport(error=describe_error(error)))

    async def _on_action(self, payload: bytes) -> bytes:
        return await self._on_message(payload, _action_message)

    async def _on_reset(self, payload: bytes) -> bytes:
        return await self._on_message(payload, _reset_message, recovering=True)

    async def _on_message(
        self, payload: bytes, decoder: msgspec.json.Decoder[Any], *, recovering: bool = False
    ) -> bytes:
        try:
            message: ActionMessage = read(payload, decoder)
            self._admission.check(message)
            self._admission.admit(message.lab, message.epoch)
        except Unreadable as error:
            return _encode(self._reply("refused", str(error)))
        except NotAdmitted as error:
            return _encode(self._reply(error.status, str(error)))
        try:
            match message:
                case Start():
                    reply = await self._on_start(message, recovering=recovering)
                case Ask():
                    reply = await self._on_ask(message)
                case Acknowledge():
                    self.journal.prune(message.position)
                    await self.journal.sync()
                    reply = self._reply("done")
                case _:
                    assert_never(message)
        except JournalError as error:
            await self._condition.fail(str(error))
            reply = self._reply("refused", str(error))
        return _encode(reply)

    # -- actions -----------------------------------------------------------------------------

    async def _on_start(self, start: Start, *, recovering: bool = False) -> ActionReply:
        journal = self.journal
        spec = self._description.action(start.name)
        if spec is not None and spec.recovers:
            # It is reported like any acceptance that cannot be written.
            with contextlib.suppress(JournalError):
                await journal.mend()
        if start.journal != self._memory.id:
            await journal.sync()
            return self._reply(
                "refused", f"The request is for journal {cut(start.journal, 80)}; this is {self._memory.id}."
            )
        if reply := self._reply_from_journal(start.action, start.attempt, start.position):
            if reply.attempt != start.attempt and reply.status not in ("void", "forgotten"):
                # This attempt must not run later either, after the earlier one is forgotten.
                journal.forbid_attempts(start.action, start.attempt, start.position)
                if reply.status != "finished":
                    reply = self._reply(
                        "refused", f"Attempt {reply.attempt} is {reply.status}.", reply.attempt
                    )
            await journal.sync()
            return reply
        try:
            if spec is None:
                offers = ", ".join(action.name for action in self._description.actions)
                raise ActionInvalid(
                    f"{self.module} has no action {cut(start.name, NAME_LIMIT)!r}; it has {offers or 'none'}."
                )
            if recovering and not spec.recovers:
                raise ActionInvalid(f"{spec.name} cannot recover {self.module} from an error.")
            kwargs = arguments.bind(spec, start.args)
            why, transient = self._explain_cannot_begin(spec), True
        except ActionInvalid as error:
            why, transient = str(error), False
        if spec is not None and not why and isinstance(start, JointStart):
            joint = spec
            why = await self._gathering.gather(
                start,
                lambda: self._explain_cannot_begin(joint),
                lambda starts: self._begin(starts, joint, kwargs),
            )
        if why or spec is None:
            journal.forbid_attempts(start.action, start.attempt, start.position)
            self._gathering.break_up(start.action, why)
            await journal.sync()
            return msgspec.structs.replace(self._reply("refused", why), transient=transient)
        if not isinstance(start, JointStart):
            self._begin([start], spec, kwargs)
        return await self._accept(start)

    def _begin(self, starts: Sequence[Start], spec: ActionSpec, kwargs: dict[str, Any]) -> None:
        """Write starts to the journal. When they are on disk, the device begins, once for all of them."""
        attempts = [
            self.journal.accept(start.action, start.attempt, start.position, spec.name, start.effects)
            for start in starts
        ]
        if spec.exclusive:
            self._condition.doing = starts[0].action
        # The task itself waits for the sync, because the asker may be gone before it is done.
        task = asyncio.get_running_loop().create_task(
            self._carry_out(attempts, spec, kwargs, starts[0].files, self._admin.stops)
        )
        for start, attempt in zip(starts, attempts, strict=True):
            self._begun[start.action] = attempt
            self._running[start.action] = task
            if spec.by_person:
                self._by_person.add(start.action)
            self._unanswered.add(start.action)

    async def _accept(self, start: Start) -> ActionReply:
        """The answer to a start that has begun."""
        attempt = self._begun.get(start.action)
        if attempt is None or attempt.attempt != start.attempt:
            await self.journal.sync()
            reply = self._reply_from_journal(start.action, start.attempt, start.position)
            return reply or self._reply("unheard")
        del self._begun[start.action]
        try:
            await self.journal.sync()
            # It begins now, and may end at once: then this one message contains everything.
            await asyncio.sleep(0)
        finally:
            self._unanswered.discard(start.action)
        if attempt.status != "running":
            return self._reply_about(attempt)
        self._spawn(self._publish_state())
        return self._reply("accepted", attempt=start.attempt)

    def _explain_cannot_begin(self, spec: ActionSpec) -> str:
        if self._closed or self._retired:
            return f"{self.module} is shutting down."
        return self._condition.explain_cannot_begin(spec, self._find_current_action())

    def _find_current_action(self) -> str:
        if not self._condition.doing:
            return ""
        running = next((a for a in self._memory.list_attempts() if a.action == self._condition.doing), None)
        return f"{running.name} ({running.action})" if running else self._condition.doing

    def _find_carrying_action(self) -> str:
        """The action that carries labware now; empty if there is none."""
        for attempt in self._memory.list_attempts():
            spec = self._description.action(attempt.name)
            effects = spec.effects if spec is not None and not spec.by_person else ()
            if attempt.action in self._running and list_carried(effects):
                return attempt.name
        return ""

    def _reply_from_journal(self, action: str, attempt: int, position: int) -> ActionReply | None:
        """The answer about an attempt from the journal; None if the journal does not have one. If an earlier
        attempt was accepted, the answer is about that one."""
        known = self._memory.find(action, attempt) or self._memory.find_earlier(action, attempt)
        if known is not None:
            return self._reply_about(known)
        if self._memory.is_void(action, attempt):
            return self._reply("void", attempt=attempt)
        if self._memory.is_forgotten(position):
            return self._reply("forgotten", f"The lab acknowledged everything up to {self._memory.pruned}.")
        return None

    async def _on_ask(self, ask: Ask) -> ActionReply:
        reply = self._reply_from_journal(ask.action, ask.attempt, ask.position)
        if ask.void and (reply is None or (reply.attempt and reply.attempt != ask.attempt)):
            self.journal.forbid_attempts(ask.action, ask.attempt, ask.position)
            self._gathering.break_up(ask.action, "the lab has requested it meanwhile.")
        await self.journal.sync()
        # During the write, the action may have ended, or its acceptance may have failed.
        reply = self._reply_from_journal(ask.action, ask.attempt, ask.position)
        return reply or self._reply("unheard")

    async def _carry_out(
        self,
        attempts: Sequence[Attempt],
        spec: ActionSpec,
        kwargs: dict[str, Any],
        pinned: dict[str, str],
        stops: int,
    ) -> None:
        """Let the device carry out attempts; several of them at once, with one call."""
        try:
            await self.journal.sync()
        except JournalError:
            # The asker gets the answer that it was refused: nothing has moved, and nothing will.
            for attempt in attempts:
                self.journal.withdraw(attempt.action, attempt.attempt)
                del self._running[attempt.action]
            self._condition.release(attempts[0].action)
            return
        started_ns = self._clock.now_ns()
        if self._admin.stops != stops:
            outcome = Outcome(False, "none", error=STOPPED_BEFORE)
            await self._conclude(
                attempts, spec, msgspec.structs.replace(outcome, started_ns=started_ns), stops
            )
        else:
            calling = self._call(spec, kwargs, pinned, stops)
            await self._await_end(attempts, spec, calling, started_ns, stops)

    async def _await_end(
        self,
        attempts: Sequence[Attempt],
        spec: ActionSpec,
        calling: Awaitable[Any],
        started_ns: int,
        stops: int,
    ) -> None:
        """Wait for the driver, and record the outcome, if it can be known."""
        self._set_current_action(attempts)
        try:
            outcome = await find_outcome(
                spec.name,
                calling,
                broken_off=lambda: self._closed,
                module=self.module,
                action=attempts[0].action,
            )
        except OutcomeUnknown as error:
            await self._give_up(attempts, str(error))
            return
        await self._conclude(attempts, spec, msgspec.structs.replace(outcome, started_ns=started_ns), stops)

    async def _give_up(self, attempts: Sequence[Attempt], why: str) -> None:
        """The device cannot report how an action ended: the lab is informed, and no exclusive action begins
        before the device is at rest."""
        for attempt in attempts:
            _log.warning("outcome_unknown", module=self.module, action=attempt.action, why=why)
            self.journal.give_up(attempt, cut(why))
            self._on_end(attempt.name, None)
            del self._running[attempt.action]
        if self._condition.doing in ("", attempts[0].action):
            await self._condition.settle()
        else:
            await self._publish_state()
        await self._sync_if_possible()

    async def _conclude(
        self, attempts: Sequence[Attempt], spec: ActionSpec, outcome: Outcome, stops: int
    ) -> None:
        outcome = msgspec.structs.replace(outcome, ended_ns=self._clock.now_ns())
        for attempt in attempts:
            self.journal.end(attempt.action, attempt.attempt, outcome)
            self._on_end(spec.name, outcome)
            del self._running[attempt.action]
        self._condition.release(attempts[0].action)
        # An action that was stopped meanwhile leaves the node in error: only a later recovery ends that.
        stopped = self._admin.stops != stops and self._condition.error
        if not stopped and self._condition.judge(spec, outcome):
            self._admin.note_recovery()
        answered = [attempt for attempt in attempts if attempt.action not in self._unanswered]
        for attempt in answered:
            published = ResultPublished(attempt.action, attempt.attempt, self._memory.id, outcome)
            key = self._keys.result(self.module, attempt.action)
            await self._publish(key, published)
        if answered or self._condition.error or spec.recovers:
            await self._publish_state()
        await self._sync_if_possible()

    async def _call(
        self, spec: ActionSpec, kwargs: dict[str, Any], pinned: dict[str, str], stops: int
    ) -> Any:
        """Call the driver's method. The files that it needs are fetched before, and the files that it returns
        are sent afterwards."""
        if self._files is not None and pinned:
            named = {arg.name for arg in spec.args if arg.type == "file"}
            for name in named & kwargs.keys():
                if sha256 := pinned.get(str(kwargs[name])):
                    kwargs[name] = str(await self._files.fetch(sha256, str(kwargs[name])))
            if self._admin.stops != stops:  # fetching may have taken long
                raise DeviceError(STOPPED_BEFORE, effects="none")
        result = await call(self._methods[spec.name], kwargs, self._worker)
        return await hand_over(result, self._files)

    def _set_current_action(self, attempts: Sequence[Attempt]) -> None:
        """Set the action and the function for its handle, which the driver's method uses."""

        async def keep(handle: str) -> None:
            if find_flaw(handle, limit=TEXT_LIMIT):
                raise DeviceError(f"The device's own id cannot be stored: it is {cut(repr(handle), 80)}.")
            for attempt in attempts:
                self.journal.note_handle(attempt.action, attempt.attempt, handle)
            await self.journal.sync()

        handle_keeper.set(keep)
        current_action.set(attempts[0].action)
        current_together.set(tuple(attempt.action for attempt in attempts) if len(attempts) > 1 else ())

    def _reply_about(self, attempt: Attempt) -> ActionReply:
        why = attempt.why or (INTERRUPTED if attempt.status == "interrupted" else "")
        return self._reply(attempt.status, why, outcome=attempt.outcome, attempt=attempt.attempt)

    # -- recovery ----------------------------------------------------------------------------

    def _find_left_running(self) -> list[tuple[Attempt, ActionSpec]]:
        """The actions that were under way when the node died, and about which its driver can ask the device.
        They count as running before the node answers any query."""
        found = []
        if type(self.node).take_up is not Node.take_up:
            for attempt in self._memory.list_attempts():
                spec = self._description.action(attempt.name)
                if attempt.status == "interrupted" and spec is not None and not spec.by_person:
                    self.journal.take_up(attempt)
                    found.append((attempt, spec))
        return found

    async def _go_on(self, attempt: Attempt, spec: ActionSpec) -> None:
        if not self._condition.connected:
            await self._give_up([attempt], f"{INTERRUPTED}, and {self._condition.error}")
            return
        await self._await_end([attempt], spec, self._take_up(attempt), 0, self._admin.stops)

    async def _take_up(self, attempt: Attempt) -> Any:
        return await hand_over(await self.node.take_up(attempt.name, attempt.handle), self._files)

    async def _reset(self, **kwargs: Any) -> Any:
        """The action ``reset``: that of the driver, or a new attempt to connect."""
        result = None
        if self._condition.connected:
            result = await call(self.node.reset, kwargs, self._worker)
        else:
            await self._condition.reconnect()
        await self._condition.mark_busy_until_rest()
        return result

    async def _sync_if_possible(self) -> None:
        try:
            await self.journal.sync()
        except JournalError as error:
            await self._condition.fail(str(error))

    # -- reporting ---------------------------------------------------------------------------

    def _reply(
        self, status: str, why: str = "", attempt: int = 0, outcome: Outcome | None = None
    ) -> ActionReply:
        return ActionReply(status, self._memory.id, cut(why), outcome, attempt)  # type: ignore[arg-type]

    async def _publish_state(self) -> None:
        await self._publish(self._keys.operation(self.module, "state"), self.state())

    async def _publish(self, key: str, message: msgspec.Struct) -> None:
        """Publish a message. A lost publication costs only time, so its failure must not affect actions."""
        try:
            await self._bus.publish(key, _encode(message))
        except Exception as error:
            _log.warning("not_published", module=self.module, key=key, error=describe_error(error))

    def _spawn(self, coroutine: Coroutine[Any, Any, None]) -> asyncio.Task[None]:
        task = asyncio.get_running_loop().create_task(coroutine)
        self._tasks = [*(other for other in self._tasks if not other.done()), task]
        return task

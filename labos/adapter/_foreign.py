"""The common part of all adapters: a LabOS node whose actions another node carries out. An adapter never
starts anything twice by itself. Before a start it writes the foreign handle (or ``sent``, if the protocol has
none) into the journal. So after a crash it is known whether the foreign node can have received the start.
"""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any, ClassVar, TypeVar

from labos.core.amounts import set_duration
from labos.core.ids import local
from labos.core.model import LABWARE_TYPE, PLATE_TYPE, ActionSpec, Description
from labos.errors import DeviceError, OutcomeUnknown
from labos.node.node import INTERRUPTED, ActionMethod, Node, Setup, current_action
from labos.spec.about import add_reset
from labos.spec.parts import Part
from labos.spec.validation import find_first_flaw

SENT = "sent"
"""The handle of a start in a protocol without ids."""

PATIENCE_S = 120.0
"""The default of ``patience_s``."""

LATE_S = 5.0
"""How long an answer may take after the foreign node reports that it is no longer busy."""

NEVER_SENT = "The adapter was restarted before it passed the action on."

T = TypeVar("T")
M = TypeVar("M", bound=Part)


class ForeignNode(Node):
    """Base of the adapters. Subclasses implement how an action is started and how its end is found out.
    Config of all: ``actions`` maps an action to ``{name, args: {ours: theirs}}`` if the foreign node uses
    other names. ``patience_s`` is how long a foreign node without an answer is asked before the outcome
    counts as unknown, and ``poll_s`` is the time between two requests. If a protocol cannot report *busy*,
    the adapter waits at most ``limit_s`` for an answer. After an unknown outcome the device may still move,
    so it counts as busy until that time is over, or until a reset.
    """

    described: ClassVar[Description]

    def __init__(self, setup: Setup) -> None:
        super().__init__(setup)
        config = setup.config
        self.patience_s = float(config.get("patience_s", PATIENCE_S))
        self.poll_s = float(config.get("poll_s", 1.0))
        self._calls: dict[str, Any] = config.get("actions") or {}
        self._settled: dict[str, asyncio.Event] = {}
        self._absent: set[str] = set()
        self._unseen: dict[str, float] = {}

    @classmethod
    def describe(cls) -> Description:
        return cls.described

    # -- what an adapter says ----------------------------------------------------------------

    async def begin(self, spec: ActionSpec, name: str, args: dict[str, Any]) -> Any:
        """Start ``name`` (the foreign name) and wait for its end; returns the result. Raises DeviceError,
        OutcomeUnknown."""
        raise NotImplementedError

    async def find_out(self, spec: ActionSpec, name: str, handle: str) -> Any:
        """Like ``begin``, for an action that was started before the adapter was restarted."""
        raise OutcomeUnknown(f"{INTERRUPTED}, and this protocol keeps no record of actions")

    async def learn(self) -> None:
        """Read the offer of the foreign node, unless it is known; called before each action."""

    async def foreign_description(self) -> Description:
        """The foreign node's description of itself, without effects, which it does not know. Only for
        protocols that have a description."""
        raise NotImplementedError

    # -- the mapping -------------------------------------------------------------------------

    def read_table(self, key: str, model: type[M], written: Any) -> M:
        """A mapping below ``config`` in the form of its model. Raises DeviceError (``none``)."""
        if flaw := find_first_flaw(model, written):
            raise DeviceError(f"In `{key}:`, {flaw}.", effects="none")
        return model.model_validate(written)

    def check_started(self, key: str, find_start: Callable[[str], object]) -> None:
        """Check that a mapping defines how each action is started. Raises DeviceError (``none``)."""
        for spec in self.described.actions:
            if not spec.recovers and find_start(spec.name) is None:
                raise make_not_started_error(key, spec)

    # -- how it is ---------------------------------------------------------------------------

    def note_version(self, version: Any) -> None:
        """Record the version that the foreign node reports at the first connection."""
        self.setup.firmware = str(version or "").strip()

    @property
    def where(self) -> str:
        """The name of the foreign node in messages."""
        return "the foreign node"

    @property
    def reports_busy(self) -> bool:
        """Whether the foreign node reports that it is busy."""
        return True

    def limit_s(self, spec: ActionSpec) -> float:
        """How long an action without any report counts as under way: five times the nominal duration, which
        is only an estimate."""
        return self.patience_s + 5 * spec.duration_s

    async def is_idle(self) -> bool:
        """For a foreign node that cannot report it: whether every action must have ended by now."""
        now = asyncio.get_running_loop().time()
        self._unseen = {action: until for action, until in self._unseen.items() if until > now}
        return not self._unseen

    async def observe(self) -> dict[str, Any]:
        """Nothing, for a protocol without such a query; see ``look``."""
        self.look()
        return {}

    def look(self) -> None:
        """Checks before an observation is reported: a device that may still move has no valid observation.
        Raises DeviceError (``none``)."""
        now = asyncio.get_running_loop().time()
        if any(until > now for until in self._unseen.values()):
            raise DeviceError(
                "The device may still be carrying out an action with unknown outcome.",
                effects="none",
                remedy="If it has stopped, reset the module.",
            )

    def believe_at_rest(self) -> None:
        """Record that a person has seen the device standing still."""
        self._unseen.clear()

    # -- actions -----------------------------------------------------------------------------

    def methods(self) -> dict[str, ActionMethod]:
        return {spec.name: self._method(spec) for spec in self.described.actions}

    def _method(self, spec: ActionSpec) -> ActionMethod:
        async def carry_out(**kwargs: Any) -> Any:
            return await self.carry_out(set_duration(spec, kwargs), kwargs)

        return carry_out

    async def carry_out(self, spec: ActionSpec, kwargs: dict[str, Any]) -> Any:
        """Carry out a LabOS action on the foreign node."""
        args = {arg.name: arg.default for arg in spec.args if not arg.required and arg.default is not None}
        name, names = self._find_call(spec)
        await self.learn()
        if spec.name in self._absent:
            raise DeviceError(f"The foreign node has no action {name!r}.", effects="none")
        args |= kwargs
        # one of LabOS' drivers: a foreign arm does not know arguments that only these get
        if self.described.version:
            ours = {LABWARE_TYPE, PLATE_TYPE} - names.keys()
            args = {key: value for key, value in args.items() if key not in ours}
        args = {names.get(key, key): value for key, value in args.items()}
        return await self._wait_unless_settled(spec, self.begin(spec, name, args))

    async def take_up(self, name: str, handle: str) -> Any:
        if not handle:
            raise DeviceError(NEVER_SENT, effects="none")
        spec = self.described.action(name)
        if spec is None or name == "reset":
            raise OutcomeUnknown(INTERRUPTED)
        return await self._wait_unless_settled(spec, self.find_out(spec, self._find_call(spec)[0], handle))

    async def settle(self, action: str, done: bool) -> None:
        self._unseen.pop(action, None)
        event = self._settled.get(action)
        if event is not None:
            event.set()

    async def answer_to(
        self,
        sending: asyncio.Future[T],
        at_work: Callable[[], Awaitable[bool]],
        *,
        silent_s: float,
        mute_s: float,
        ended: str,
    ) -> T:
        """The answer to a start. During the wait, the foreign node is asked whether it is still ``at_work``,
        because a cut line gives no sign. ``silent_s`` is how long it may give no answer at all. ``mute_s`` is
        how long to wait if it never reports that it is busy. ``ended`` is the knowledge about the effects if
        it is no longer busy. Raises OutcomeUnknown, and what ``sending`` raises."""
        silence, idle_s = Silence(silent_s, self.where), 0.0
        try:
            while True:
                await asyncio.wait({sending}, timeout=self.poll_s)
                if sending.done():
                    return sending.result()
                try:
                    works = await at_work()
                except DeviceError as error:
                    silence.go_on(error)
                    continue
                silence.end()
                idle_s = 0.0 if works else idle_s + self.poll_s
                mute_s = LATE_S if works else mute_s
                if idle_s > mute_s:
                    waited = f"{self.where} has not answered for {idle_s:.0f} s without a sign of work"
                    raise OutcomeUnknown(f"{waited}: {ended}")
        finally:
            sending.cancel()

    async def wait_until(self, ready: Callable[[], Awaitable[bool]], times: int = 1) -> None:
        """Wait until the foreign node is ``ready``, the given number of times in a row. Raises OutcomeUnknown
        if it does not answer."""
        silence, in_a_row = Silence(self.patience_s, self.where), 0
        while True:
            try:
                in_a_row = in_a_row + 1 if await ready() else 0
                if in_a_row >= times:
                    return
                silence.end()
            except DeviceError as error:
                silence.go_on(error)
                in_a_row = 0
            await asyncio.sleep(self.poll_s)

    def place(self, spec: ActionSpec, station: str) -> Any:
        """The foreign node's value for a station: from the workcell file, else its name."""
        ways = self.setup.config.get("representations") or {}
        for key in (station, station.removeprefix(f"{self.setup.name}.")):
            if key in ways:
                return ways[key]
            if self.setup.poses.get(key):
                return self.setup.poses[key]
        return local(station)

    def name_places(self, spec: ActionSpec, args: dict[str, Any]) -> dict[str, Any]:
        """The arguments, with stations replaced by the foreign node's values."""
        return {k: self.place(spec, str(v)) if self.is_station(spec, k) else v for k, v in args.items()}

    def is_station(self, spec: ActionSpec, foreign_arg: str) -> bool:
        return self._type_of(spec, foreign_arg) == "station"

    def is_file(self, spec: ActionSpec, foreign_arg: str) -> bool:
        return self._type_of(spec, foreign_arg) == "file"

    def describe_missing(self, offered: Callable[[str], bool]) -> str:
        """The described actions that the foreign node does not offer, as a sentence; empty if the node can be
        used. A driver may have more actions than the foreign node, which are refused one by one. But actions
        that were written for this particular node must exist."""
        ours = [spec for spec in self.described.actions if not spec.recovers]
        absent = [spec.name for spec in ours if not offered(self._find_call(spec)[0])]
        self._absent = set(absent)
        if not absent or (self.described.version and len(absent) < len(ours)):
            return ""
        return (
            f"The foreign node does not offer {', '.join(absent)}. "
            "Correct `about:`, or map the names under `actions:` in `config:`."
        )

    def _type_of(self, spec: ActionSpec, foreign_arg: str) -> str:
        names = self._find_call(spec)[1]
        return next((arg.type for arg in spec.args if names.get(arg.name, arg.name) == foreign_arg), "")

    def _find_call(self, spec: ActionSpec) -> tuple[str, dict[str, str]]:
        call = self._calls.get(spec.name) or {}
        return str(call.get("name", spec.name)), call.get("args") or {}

    async def _wait_unless_settled(self, spec: ActionSpec, work: Awaitable[Any]) -> Any:
        """The result of the work, unless a person reports the outcome first."""
        action = current_action.get()
        # After a restart it is not known when it began: the time counts from now, so the limit is never too
        # short.
        until = asyncio.get_running_loop().time() + self.limit_s(spec)
        event = self._settled[action] = asyncio.Event()
        tasks = asyncio.ensure_future(work), asyncio.ensure_future(event.wait())
        try:
            await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
            if not tasks[0].done():
                raise OutcomeUnknown("a person has reported its outcome")
            try:
                return tasks[0].result()
            except OutcomeUnknown:
                if not self.reports_busy:
                    self._unseen[action] = until
                raise
        finally:
            for task in tasks:
                task.cancel()
            del self._settled[action]


def make_not_started_error(key: str, spec: ActionSpec) -> DeviceError:
    """The mapping ``key`` lacks an action."""
    return DeviceError(f"`{key}:` does not define how {spec.name!r} is started.", effects="none")


class Silence:
    """How long a foreign node has given no answer; begins with the first failure."""

    def __init__(self, limit_s: float, where: str) -> None:
        self._limit_s, self._where = limit_s, where
        self._since: float | None = None

    def end(self) -> None:
        """End the silence: the node has answered."""
        self._since = None

    def go_on(self, why: Exception) -> None:
        """There was again no answer. Raises OutcomeUnknown if the silence has lasted too long."""
        now = asyncio.get_running_loop().time()
        self._since = now if self._since is None else self._since
        if now - self._since > self._limit_s:
            raise OutcomeUnknown(
                f"{self._where} has not answered for {now - self._since:.0f} s ({why})"
            ) from why


def adapt(adapter: type[ForeignNode], description: Description) -> type[Node]:
    """The adapter as the node class of a module with this description."""
    description = add_reset(description)
    return type(adapter.__name__, (adapter,), {"described": description, "driver": description.driver})


async def read_file(path: Any) -> bytes:
    """The content of a file argument; the node has fetched it. Raises DeviceError (``none``)."""
    try:
        return await asyncio.to_thread(Path(str(path)).read_bytes)
    except OSError as error:
        raise DeviceError(f"The file {path} cannot be read ({error.strerror}).", effects="none") from error

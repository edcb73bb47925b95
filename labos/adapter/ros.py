"""ROS 2 nodes: services, actions and topics, by a mapping (``labos.spec.ros``).

A bridge process with rclpy communicates with them. A service call has no id, and a node that dies never
answers. During the wait for an answer, the node's state topic shows whether the node is still busy; after a
lost answer, the outcome is unknown. A goal of a ROS action has an id that is derived from LabOS' own id. With
it, the result can be requested again, as long as the node keeps it.
"""

from __future__ import annotations

import ast
import asyncio
import contextlib
import hashlib
import json
import tempfile
from collections.abc import Awaitable
from pathlib import Path
from typing import Any

from labos.adapter._decode import LARGEST_JSON, read_json_text
from labos.adapter._foreign import LATE_S, SENT, ForeignNode, Silence, make_not_started_error
from labos.adapter._http import NoResponse
from labos.adapter._placeholders import fill
from labos.adapter._png import encode_png
from labos.adapter._ros import BridgeProcess
from labos.adapter.rest import find_field
from labos.core.model import ActionSpec, Description
from labos.errors import DeviceError, OutcomeUnknown
from labos.node.files import Attachment
from labos.node.node import Setup, current_action
from labos.spec.ros import Call, RosMapping, make_camera_mapping, make_wei_mapping

WAIT_S = 3.0
"""How long to search for a service, because ROS needs some time to find its nodes."""

ANSWER_S = WAIT_S + 10.0
"""The longest time for the answer to a short call, including the search for its service."""

STALE_S = 5.0
"""A state older than this is ignored, because a node with one thread publishes no state while it works."""

ASK_S = 2.0
"""How long to wait for the result of a goal before it is requested again, because the node may have been
restarted."""

CANCELED = 5
"""``action_msgs/msg/GoalStatus``: 4 succeeded, 5 canceled, 6 aborted, 0 an unknown goal."""

NO_RECORD = "the node has ended or lost it, and a ROS service keeps no record of the outcome"
FORGOTTEN = "the node does not know the goal: it was restarted, or has forgotten it"


class RosNode(ForeignNode):
    """Config: ``ros`` (the mapping); ``ros_python``, the Python with rclpy; ``ros_domain``."""

    def __init__(self, setup: Setup) -> None:
        super().__init__(setup)
        self._bridge: BridgeProcess | None = None
        self._starting = asyncio.Lock()
        self._state, self._state_at = "", 0.0

    def read_mapping(self) -> dict[str, Any]:
        """The mapping from the workcell file."""
        return dict(self.setup.config.get("ros") or {})

    @property
    def bridge(self) -> BridgeProcess:
        if self._bridge is None:
            raise DeviceError("The adapter is not connected.", effects="none")
        return self._bridge

    async def connect(self) -> None:
        self.mapping = self.read_table("ros", RosMapping, self.read_mapping())
        self.check_started("ros", self.mapping.call)
        await self._start_bridge()

    async def _start_bridge(self) -> None:
        """Start the bridge process, if none runs. Raises DeviceError."""
        async with self._starting:
            if self._bridge is not None and self._bridge.runs:
                return
            await self.close()
            config = self.setup.config
            bridge = BridgeProcess(str(config.get("ros_python") or ""), config.get("ros_domain"))
            await bridge.start()
            self._bridge, self._state = bridge, ""
            if state := self.mapping.state:
                bridge.watch(state.topic, state.type, self._on_state)

    async def close(self) -> None:
        bridge, self._bridge = self._bridge, None
        if bridge is not None:
            await bridge.close()

    def _on_state(self, message: dict[str, Any]) -> None:
        state = self.mapping.state
        self._state = str(find_field(message, state.field) if state else "").upper()
        self._state_at = asyncio.get_running_loop().time()

    # -- how it is ---------------------------------------------------------------------------

    def _is_in_state(self, words: list[str]) -> bool:
        return any(word.upper() in self._state for word in words)

    @property
    def _is_busy(self) -> bool:
        return self.mapping.state is not None and self._is_in_state(self.mapping.state.busy)

    @property
    def reports_busy(self) -> bool:
        return self.mapping.state is not None

    async def is_idle(self) -> bool:
        """By its state, if the node publishes one."""
        if not self.reports_busy:
            return await super().is_idle()
        return bool(self._state) and not self._is_busy and not self._is_strange

    @property
    def _is_strange(self) -> bool:
        """Whether its state is in no list of the mapping, if the mapping lists states at rest."""
        state = self.mapping.state
        return state is not None and bool(state.idle) and not self._is_in_state([*state.idle, *state.error])

    async def trouble(self) -> str:
        try:
            await self._start_bridge()
        except DeviceError as error:
            return str(error)
        if not await self._is_there():
            return "The node does not answer in ROS. Is it running, in this ROS domain?"
        state = self.mapping.state
        if state is not None and self._is_in_state(state.error):
            return f"The node is in error: {self._state.strip()}. Reset the module."
        if self._state and self._is_strange and not self._is_busy:
            return f"The node says {self._state.strip()!r}, which is not known to mean that it is idle."
        return ""

    async def _is_there(self) -> bool:
        """Whether the node offers its services. Whether a camera sends images is found out only when one is
        taken."""
        calls = [self.mapping.call(spec.name) for spec in self.described.actions if not spec.recovers]
        services = {_service_of(call) for call in calls if call is not None and not call.frame}
        try:
            return all([await self.bridge.is_offered(name, kind) for name, kind in services])
        except (TimeoutError, NoResponse, DeviceError):
            return False

    async def resources(self) -> dict[str, float]:
        from labos.adapter.wei import find_levels

        if self.mapping.resources is None:
            return {}
        return find_levels(_table(await self._ask(self.mapping.resources)))

    # -- recovery ----------------------------------------------------------------------------

    async def reset(self) -> None:
        if self.mapping.reset is not None:
            await self._ask(self.mapping.reset)
        self.believe_at_rest()

    async def stop(self) -> None:
        if self.mapping.stop is None:
            raise DeviceError("`ros:` does not define how the node is stopped.", effects="none")
        await self._ask(self.mapping.stop)

    async def _ask(self, call: Call) -> Any:
        """Make a short call. Raises DeviceError."""
        try:
            calling = self.bridge.call(call.service, call.type, fill(call.fields, {}, "ros"), wait_s=WAIT_S)
            return read_end(call, await asyncio.wait_for(calling, ANSWER_S))
        except TimeoutError as late:
            raise DeviceError(f"{call.service}: no answer within {ANSWER_S:g} s.") from late
        except NoResponse as lost:
            raise DeviceError(f"{call.service}: no answer came ({lost}).") from lost

    # -- actions -----------------------------------------------------------------------------

    async def begin(self, spec: ActionSpec, name: str, args: dict[str, Any]) -> Any:
        call = self._call(spec)
        args = self.name_places(spec, args)
        if call.frame:
            return await self._take_picture(call)
        message = {"action_handle": name, "action_vars": args}
        own = {"args": args, "vars": json.dumps(args), "message": json.dumps(message), "action": name}
        fields = fill(call.fields, {**args, **own, "id": current_action.get()}, "ros")
        if call.action:
            return await self._pursue(spec, call, fields)
        await self.note_handle(SENT)
        began = asyncio.get_running_loop().time()
        calling = self.bridge.call(call.service, call.type, fields, wait_s=WAIT_S)
        return read_end(call, await self._answer(call, calling, self.limit_s(spec), began))

    async def find_out(self, spec: ActionSpec, name: str, handle: str) -> Any:
        call = self._call(spec)
        if call.action:
            return await self._fetch_result(spec, call, handle)
        loop = asyncio.get_running_loop()
        until = loop.time() + self.limit_s(spec)
        while self._is_busy or (not await self.is_idle() and loop.time() < until):
            if not await self._is_there():
                break
            await asyncio.sleep(self.poll_s)
        raise OutcomeUnknown(f"the adapter was restarted meanwhile; {NO_RECORD}")

    def _call(self, spec: ActionSpec) -> Call:
        call = self.mapping.call(spec.name)
        if call is None:
            raise make_not_started_error("ros", spec)
        return call

    async def _answer(self, call: Call, calling: Awaitable[Any], idle_limit_s: float, began: float) -> Any:
        """The answer to a call. During the wait, the adapter checks the node, because a node that died never
        answers. Raises DeviceError, OutcomeUnknown."""
        loop = asyncio.get_running_loop()
        silent_s = idle_s = 0.0
        waiting = asyncio.ensure_future(calling)
        try:
            while True:
                await asyncio.wait({waiting}, timeout=self.poll_s)
                if waiting.done():
                    return waiting.result()
                silent_s = 0.0 if await self._is_offered(call) else silent_s + self.poll_s
                fresh = self._state_at > max(began, loop.time() - STALE_S)
                if fresh and self._state:
                    idle_s = 0.0 if self._is_busy else idle_s + self.poll_s
                    idle_limit_s = LATE_S if self._is_busy else idle_limit_s
                elif not self.reports_busy:
                    idle_s += self.poll_s
                if idle_s > idle_limit_s:
                    raise OutcomeUnknown(f"{call.service} has not answered for {idle_s:.0f} s: {NO_RECORD}")
                if silent_s > self.patience_s:
                    raise OutcomeUnknown(f"{call.service} has been gone from ROS for {silent_s:.0f} s")
        except NoResponse as lost:
            raise OutcomeUnknown(f"{lost}; {NO_RECORD}") from lost
        finally:
            waiting.cancel()

    async def _is_offered(self, call: Call) -> bool:
        try:
            return await self.bridge.is_offered(*_service_of(call))
        except (TimeoutError, NoResponse, DeviceError):
            return False

    # -- goals of ROS actions ----------------------------------------------------------------

    async def _pursue(self, spec: ActionSpec, call: Call, goal: dict[str, Any]) -> Any:
        """Send a goal with its own id, and wait for its result."""
        known = make_goal_id(current_action.get())
        await self.note_handle(known)
        fields = {"goal_id": {"uuid": list(bytes.fromhex(known))}, "goal": goal}
        sending = self.bridge.call(*_service_of(call), fields, wait_s=WAIT_S)
        try:
            answer = await asyncio.wait_for(sending, ANSWER_S)
        except (TimeoutError, NoResponse):
            return await self._fetch_result(spec, call, known)
        if not answer.get("accepted"):
            raise DeviceError(f"{call.action} does not accept the goal.", effects="none")
        return await self._fetch_result(spec, call, known)

    async def _fetch_result(self, spec: ActionSpec, call: Call, known: str) -> Any:
        """Ask for the result of a goal until there is one. Raises DeviceError, OutcomeUnknown."""
        kind, fields = f"{call.type}:GetResultService", {"goal_id": {"uuid": list(bytes.fromhex(known))}}
        silence, loop = Silence(self.patience_s, call.action), asyncio.get_running_loop()
        working = loop.time()
        while True:
            try:
                asking = self.bridge.call(f"{call.action}/_action/get_result", kind, fields, wait_s=WAIT_S)
                answer = await asyncio.wait_for(asking, WAIT_S + ASK_S)
            except TimeoutError:  # it continues
                silence.end()
                working = loop.time() if self._is_busy else working
                if (waited := loop.time() - working) > self.limit_s(spec):
                    text = f"{call.action} has not sent the result of the goal for {waited:.0f} s"
                    raise OutcomeUnknown(f"{text} without a sign of work") from None
                continue
            except (DeviceError, NoResponse) as gone:
                silence.go_on(gone)
                await self.trouble()  # which starts a bridge that has ended
                await asyncio.sleep(self.poll_s)
                continue
            return self._read_goal_end(call, answer)

    def _read_goal_end(self, call: Call, answer: dict[str, Any]) -> Any:
        match answer.get("status"):
            case 4:
                return read_end(call, answer["result"])
            case 5 | 6 as status:
                word = "canceled" if status == CANCELED else "aborted"
                error = find_field(answer["result"], call.error) if call.error else ""
                raise DeviceError(f"{call.action}: the goal was {word}{f': {error}' if error else ''}.")
        raise OutcomeUnknown(FORGOTTEN)

    # -- pictures ----------------------------------------------------------------------------

    async def _take_picture(self, call: Call) -> Any:
        with tempfile.TemporaryDirectory(prefix="labos-") as folder:
            raw = Path(folder) / "raw"
            shape = await self.bridge.fetch_frame(call.frame, raw, max(self.poll_s, WAIT_S + 7.0))
            picture = await asyncio.to_thread(lambda: encode_png(raw.read_bytes(), **shape))
        return {"files": {"image": Attachment("image.png", picture)}}

    # -- what it says of itself --------------------------------------------------------------

    async def foreign_description(self) -> Description:
        from labos.adapter.wei import describe

        if self.mapping.about is None:
            raise DeviceError("`ros:` names no service that describes the node.", effects="none")
        about = _table(await self._ask(self.mapping.about))
        if isinstance(about.get("actions"), dict):  # old nodes report only their names
            about["actions"] = [{"name": name} for name in about["actions"]]
        return describe(about, "wei_ros_node")


class WeiRosNode(RosNode):
    """Config: ``ros_node_address``, the node's name; ``ros`` has names that differ from the defaults."""

    def read_mapping(self) -> dict[str, Any]:
        return {**make_wei_mapping(_node_name(self.setup.config)), **super().read_mapping()}


class WeiRosCamera(RosNode):
    """Config: ``ros_node_address``, the camera's name; any action takes an image."""

    def read_mapping(self) -> dict[str, Any]:
        return {**make_camera_mapping(_node_name(self.setup.config)), **super().read_mapping()}


def _node_name(config: dict[str, Any]) -> str:
    return str(config.get("ros_node_address") or config.get("ros_node") or "").rstrip("/")


def _service_of(call: Call) -> tuple[str, str]:
    """The service that starts it, and its type."""
    if call.action:
        return f"{call.action}/_action/send_goal", f"{call.type}:SendGoalService"
    return call.service, call.type


def make_goal_id(action: str) -> str:
    """The id of a goal (16 bytes), derived from LabOS' id of the action and always the same."""
    return hashlib.sha256(action.encode()).hexdigest()[:32]


def read_end(call: Call, answer: Any) -> Any:
    """The result in an answer. Raises DeviceError if it reports a failure."""
    result = find_field(answer, call.result) if call.result else answer
    if not call.status or (status := find_field(answer, call.status)) in call.done:
        return result
    error = find_field(answer, call.error) if call.error else ""
    raise DeviceError(f"The node answers {status!r}{f': {error}' if error else ''}.")


def _table(answer: Any) -> dict[str, Any]:
    """A table in the text of an answer: as JSON, or in Python's notation, which WEI's nodes use."""
    found: Any = answer
    for read in (read_json_text, ast.literal_eval):
        if isinstance(found, str) and len(found) <= LARGEST_JSON:
            with contextlib.suppress(ValueError, SyntaxError, RecursionError, MemoryError):
                found = read(found)
    if not isinstance(found, dict):
        raise DeviceError(f"The answer is not a table: {str(answer)[:200]!r}.", effects="none")
    return found

"""The condition of a node (IDLE, BUSY with an activity, or ERROR), and its connection to the device."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Coroutine
from typing import Any

import structlog

from labos.core.model import ActionSpec
from labos.errors import DeviceError
from labos.node._outcome import describe_error
from labos.node.limits import cut
from labos.node.node import Node
from labos.node.protocol import NodeStatus, Outcome

AWAITING_REST = "waiting for the device to stop"

_log = structlog.get_logger(__name__)


class DeviceCondition:
    """``doing`` is the activity of the device: an exclusive action's id, or a text. ``error`` is the error
    until a recovery. ``connected``: whether the device answered. ``changed`` reports the state; ``spawn``
    starts background tasks."""

    def __init__(
        self,
        node: Node,
        *,
        idle_poll_s: float,
        changed: Callable[[], Awaitable[None]],
        spawn: Callable[[Coroutine[Any, Any, None]], object],
    ) -> None:
        self.doing = "starting"
        self.error = ""
        self.connected = False
        self._trouble = ""
        self._node = node
        self._module = f"{node.setup.workcell}/{node.setup.name}"
        self._idle_poll_s = idle_poll_s
        self._changed, self._spawn = changed, spawn

    @property
    def status(self) -> NodeStatus:
        if self.error:
            return "ERROR"
        return "BUSY" if self.doing else "IDLE"

    async def connect(self) -> None:
        """Connect the device. If the device does not answer, the node is in ERROR."""
        self.doing = "connecting to the device"
        self.error = ""
        try:
            await self._node.connect()
        except Exception as error:
            self.doing = ""
            await self.fail(f"The device is not connected: {describe_error(error)}")
            return
        self.connected = True
        await self.settle()

    async def reconnect(self) -> None:
        """Connect the device as part of a recovery. Raises DeviceError."""
        try:
            await self._node.connect()
        except Exception as error:
            raise DeviceError(
                f"The device is not connected: {describe_error(error)}", effects="none"
            ) from error
        self.connected = True

    async def look(self) -> None:
        """Ask the device for its error. It becomes the node's error, and ends by itself. If the node is in an
        error already, that error is not changed."""
        if not self.connected:
            return
        try:
            trouble = cut(await self._node.trouble() or "")
        except Exception as error:
            trouble = cut(f"The device does not answer: {describe_error(error)}")
        if self.error not in ("", self._trouble) or trouble == self.error:
            return
        self._trouble = trouble
        if trouble:
            await self.fail(trouble)
        else:
            self.error = ""
            await self._changed()

    async def mark_busy_until_rest(self) -> None:
        """Be BUSY until the device stands still, in a background task."""
        if not await self._is_idle():
            self._wait_for_idle()

    def release(self, doing: str) -> None:
        """The activity has ended, unless another one began meanwhile."""
        if self.doing == doing:
            self.doing = ""

    async def fail(self, error: str) -> None:
        """Put the node itself into an error."""
        self.error = cut(error)
        _log.error("node_in_error", module=self._module, error=self.error)
        await self._changed()

    def explain_cannot_begin(self, spec: ActionSpec, doing: str) -> str:
        """Why the action may not begin now. ``doing`` is the name of the action that runs."""
        if self.error and not (spec.recovers and (self.connected or spec.name == "reset")):
            return f"{self._module} is in error: {self.error}"
        # This recovery may be needed for the device to become idle.
        if spec.exclusive and self.doing and not (spec.recovers and self.doing == AWAITING_REST):
            return f"{self._module} is busy: {doing}."
        return ""

    def judge(self, spec: ActionSpec, outcome: Outcome) -> bool:
        """Apply the outcome of an action to the condition. Returns whether it ended an error of the
        module."""
        if outcome.succeeded and spec.recovers:
            self.error = ""
            return True
        if not outcome.succeeded and (spec.recovers or outcome.effects in ("unknown", "partial")):
            self.error = cut(f"{spec.name}: {outcome.error}")
        return False

    async def settle(self) -> None:
        """Be BUSY until the device was observed standing still."""
        self.doing = AWAITING_REST
        if await self._is_idle():
            self.doing = ""
        else:
            self._wait_for_idle()
        await self._changed()

    def _wait_for_idle(self) -> None:
        self.doing = AWAITING_REST
        self._spawn(self._await_idle())

    async def _await_idle(self) -> None:
        while True:
            await asyncio.sleep(self._idle_poll_s)
            if await self._is_idle():
                break
        # A recovery may have begun or ended meanwhile.
        self.release(AWAITING_REST)
        await self._changed()

    async def _is_idle(self) -> bool:
        try:
            return await self._node.is_idle()
        except Exception as error:
            _log.warning("device_not_answering", module=self._module, error=describe_error(error))
            return False

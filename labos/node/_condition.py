"""The condition a node is in: IDLE, BUSY with something, or in ERROR; and its device's connection."""

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

AWAITING_REST = "waiting for the device to stand still"

_log = structlog.get_logger(__name__)


class DeviceCondition:
    """``doing`` is what keeps the device busy: an exclusive action's id, or words; ``error`` what is
    wrong, until a recovery; ``connected`` whether the device answered. ``changed`` tells the state,
    ``spawn`` starts what goes on by itself."""

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
        """Connect the device; one that is not there leaves the node in ERROR."""
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
        """Ask the device what is wrong with it. What it says becomes the node's error and ends by
        itself, unless the node is in an error already, which it does not touch."""
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
        """BUSY until the device stands still, without keeping anybody waiting."""
        if not await self._is_idle():
            self._wait_for_idle()

    def release(self, doing: str) -> None:
        """What kept the device busy has ended, unless something else began meanwhile."""
        if self.doing == doing:
            self.doing = ""

    async def fail(self, error: str) -> None:
        """Something is wrong with the node itself."""
        self.error = cut(error)
        _log.error("node_in_error", module=self._module, error=self.error)
        await self._changed()

    def explain_cannot_begin(self, spec: ActionSpec, doing: str) -> str:
        """Why the action may not begin now; ``doing`` is how to name what runs."""
        if self.error and not (spec.recovers and (self.connected or spec.name == "reset")):
            return f"{self._module} is in error: {self.error}"
        # The device may need this very recovery to come to rest.
        if spec.exclusive and self.doing and not (spec.recovers and self.doing == AWAITING_REST):
            return f"{self._module} is busy: {doing}."
        return ""

    def judge(self, spec: ActionSpec, outcome: Outcome) -> bool:
        """What the end of an action means; True if it brought the module out of an error."""
        if outcome.succeeded and spec.recovers:
            self.error = ""
            return True
        if not outcome.succeeded and (spec.recovers or outcome.effects in ("unknown", "partial")):
            self.error = cut(f"{spec.name}: {outcome.error}")
        return False

    async def settle(self) -> None:
        """BUSY until the device is seen to stand still."""
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
        # A recovery may have begun, or ended, meanwhile.
        self.release(AWAITING_REST)
        await self._changed()

    async def _is_idle(self) -> bool:
        try:
            return await self._node.is_idle()
        except Exception as error:
            _log.warning("device_not_answering", module=self._module, error=describe_error(error))
            return False

"""Requests to a node besides its actions. None of them moves the device, except a stop.

Everything that moves is an action, which is journalled and carried out at most once. A stop is never fenced,
and needs neither the journal nor the log. The node reports who stopped the module, and when, until it is
reset.
"""

from __future__ import annotations

from collections.abc import Awaitable, Callable
from typing import Any

import msgspec
import structlog

from labos.clock import Clock
from labos.core.modules import describe_stop
from labos.errors import BadInput, LabosError, NodeError, Unreadable
from labos.node._admission import Admission
from labos.node._outcome import describe_error
from labos.node.limits import NAME_LIMIT, cut, cut_name, find_flaw, is_name, read
from labos.node.node import Node
from labos.node.protocol import AdminReply, AdminRequest

NEVER_FENCED = ("stop", "estop")

Command = Callable[[dict[str, Any]], Awaitable[Any]]

_log = structlog.get_logger(__name__)
_encode = msgspec.json.Encoder().encode
_request = msgspec.json.Decoder(AdminRequest)


class _Command(msgspec.Struct):
    """The part of a command that a stop needs."""

    command: str


_command = msgspec.json.Decoder(_Command)


class Admin:
    """The commands of ``admin``. ``admission`` fences, and ``synced`` waits for the journal. ``fail`` puts
    the node into an error, ``rewind`` rewinds the journal, and ``shut_down`` asks the node to end.
    ``carrying`` names the action that carries labware now. ``trace`` begins or ends the transcript of the
    device's wires, and names its file. ``stops`` counts stops, so that an action that was only accepted
    before a stop does not begin after it."""

    def __init__(
        self,
        module: str,
        node: Node,
        clock: Clock,
        *,
        admission: Admission,
        synced: Callable[[], Awaitable[None]],
        fail: Callable[[str], Awaitable[None]],
        rewind: Callable[[int], None],
        shut_down: Callable[[], None],
        carrying: Callable[[], str],
        trace: Callable[[bool], str] | None = None,
    ) -> None:
        self.stops = 0
        self.stopped_at = 0
        self.stopped_by = ""
        self.variables: dict[str, Any] = {}
        self._module, self._node, self._clock = module, node, clock
        self._admission, self._synced, self._fail = admission, synced, fail
        self._rewind_journal, self._end = rewind, shut_down
        self._carrying, self._switch_trace = carrying, trace

    async def on_request(self, payload: bytes) -> bytes:
        """Answer a request to ``admin``."""
        try:
            request = read(payload, _request)
        except Unreadable as error:
            stop = _stop_in(payload)
            if stop is None:
                return _encode(AdminReply(False, describe_error(error)))
            request = stop
        return _encode(await self._answer(request))

    def list_commands(self) -> dict[str, Command]:
        """The commands by name."""
        return {
            "stop": self._stop,
            "estop": self._stop_in_emergency,
            "observe": self._observe,
            "shutdown": self._shut_down,
            "settled": self._settle,
            "rewind": self._rewind,
            "trace": self._trace,
        }

    def note_recovery(self) -> None:
        """The module was reset: the emergency has ended."""
        self.stopped_at, self.stopped_by = 0, ""

    async def _answer(self, request: AdminRequest) -> AdminReply:
        handler = self.list_commands().get(request.command)
        if handler is None:
            known = ", ".join(sorted(self.list_commands()))
            what = cut(request.command, NAME_LIMIT)
            return AdminReply(False, f"{self._module} has no command {what!r}; it has {known}.")
        try:
            if request.command not in NEVER_FENCED:
                if flaw := find_flaw(request.args):
                    raise BadInput(f"The arguments of {request.command} cannot be accepted: {flaw}.")
                self._admission.admit(request.lab, request.epoch)
                await self._synced()
            return AdminReply(True, result=await handler(request.args))
        except Exception as error:
            if not isinstance(error, LabosError):
                _log.exception("command_failed", module=self._module, command=request.command)
            return AdminReply(False, describe_error(error))

    async def _stop(self, args: dict[str, Any]) -> None:
        self.stops += 1
        await self._node.stop()

    async def _stop_in_emergency(self, args: dict[str, Any]) -> int:
        by = cut_name(args.get("by"))
        if not self.stopped_at or by != self.stopped_by:  # several requests of one person are one stop
            self.stopped_at, self.stopped_by = self._clock.now_ns(), by
        try:
            await self._stop(args)
        finally:
            await self._fail(describe_stop(self.stopped_by))
        return self.stopped_at

    async def _trace(self, args: dict[str, Any]) -> str:
        if self._switch_trace is None:
            raise NodeError(f"{self._module} keeps no transcript of its wires.")
        return self._switch_trace(args.get("on") is True)

    async def _observe(self, args: dict[str, Any]) -> dict[str, Any]:
        if doing := self._carrying():
            raise NodeError(
                f"{self._module} is moving labware ({doing}), so an observation now would soon be out of "
                "date."
            )
        seen: dict[str, Any] = msgspec.to_builtins(await self._node.observe(), str_keys=True)
        if flaw := find_flaw(seen):
            raise NodeError(f"The observation of {self._module} cannot be sent: {flaw}.")
        self.variables = {name: value for name, value in seen.items() if name != "labware"}
        return seen

    async def _shut_down(self, args: dict[str, Any]) -> None:
        self._end()

    async def _settle(self, args: dict[str, Any]) -> None:
        action, done = args.get("action"), args.get("done", False)
        if not isinstance(action, str) or not is_name(action) or not isinstance(done, bool):
            raise BadInput("`settled` needs the id of an action, and whether it is done: true or false.")
        await self._node.settle(action, done)

    async def _rewind(self, args: dict[str, Any]) -> None:
        self._rewind_journal(self._admission.check_position(args.get("position")))
        await self._synced()


def _stop_in(payload: bytes) -> AdminRequest | None:
    """The stop in a message that is otherwise unreadable: a stop does not need the rest of the message."""
    try:
        command = _command.decode(payload).command
    except (msgspec.MsgspecError, ValueError, RecursionError):
        return None
    return AdminRequest("", 0, command) if command in NEVER_FENCED else None

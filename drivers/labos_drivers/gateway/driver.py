"""Drives an instrument through a gateway on its PC. ``server.py`` describes the protocol."""

from __future__ import annotations

import json
import secrets
import time
from collections.abc import Mapping
from typing import Any, ClassVar, NamedTuple

from labos.errors import DeviceError, Garbled, LinkError, NotConnected, OutcomeUnknown
from labos.link import HttpLink, HttpReply
from labos.node import Setup
from labos.node.node import note_handle
from labos_drivers._wired import DeviceOnWire, Wired, during_motion, off_loop

ANSWER_S, POLL_S, LOST_S = 10.0, 1.0, 60.0
"""How long a gateway may be out of reach while its instrument works."""


REFUSALS = (409, 422, 503)
"""Answers to a start after which nothing has moved."""


class Start(NamedTuple):
    """The name of an action, and the gateway's journal that will record it."""

    journal: str
    name: str

    @property
    def handle(self) -> str:
        """The handle that the node journals before the start."""
        return f"{self.journal}:{self.name}"


class GatewayDriver(Wired):
    """Starts each action under a new name, and asks for its end by this name. Except for ``reset``, the node
    journals the name before the start. A name is started at most once, even if messages are lost."""

    deadlines = ("answer", "lost")
    where = ("url", "http://192.168.0.30:2100")
    instrument: ClassVar[str] = ""
    link: HttpLink

    def __init__(self, setup: Setup, address: str, simulator: DeviceOnWire | None = None) -> None:
        super().__init__(setup, address, simulator)
        self._journal = ""
        self.link = HttpLink(
            address,
            name=setup.name,
            identify=lambda _: self._recognise(),
            expected=self._describe_gateway(self.instrument),
        )

    @property
    def _answer_s(self) -> float:
        return self.limit_s("answer", ANSWER_S)

    async def call(self, action: str, **args: Any) -> Any:
        """Carry out an action; returns its result. Raises DeviceError, OutcomeUnknown."""
        start = await self.name_start()
        await note_handle(start.handle)
        return await self.carry_out(start, action, args)

    @off_loop
    def name_start(self) -> Start:
        """A new name for an action that has not been started. Raises NotConnected, WrongDevice."""
        self.link.open()
        return Start(self._journal, secrets.token_hex(8))

    @off_loop
    def carry_out(self, start: Start, action: str, args: Mapping[str, Any]) -> Any:
        """Start an action and wait for its end; returns its result. Raises DeviceError, OutcomeUnknown."""
        with self.motion():
            return self._carry_out(start, action, args)

    @off_loop
    def follow(self, handle: str) -> Any:
        """Wait for the end of an action that may have been started with this handle; returns its result.
        Raises DeviceError if it failed or was never started; then it can no longer start. Raises
        OutcomeUnknown if the gateway does not know the outcome."""
        journal, _, name = handle.rpartition(":")
        start = Start(journal, name)
        with self.motion():
            with self.assume_motion():
                entry = self._poll_action("DELETE", start)
            return self._await_end(start, entry)

    @off_loop
    def reset(self) -> None:
        """End a stop and carry out the gateway's own action ``reset``. Raises DeviceError, OutcomeUnknown."""
        self.resume()
        self.link.open()
        self._carry_out(Start(self._journal, secrets.token_hex(8)), "reset", {})

    @during_motion
    def stop(self) -> None:
        """Stop the instrument, and start nothing until a reset. Raises DeviceError if it moves and cannot be
        stopped from its PC."""
        self._halted.set()
        if not self._ask("POST", "/stop").get("stopped") and self.moving:
            raise DeviceError(
                f"{self.name}: its own software takes no stop; it ends what it has begun.",
                remedy="Use the button or switch on the device.",
            )

    @during_motion
    def is_idle(self) -> bool:
        """Whether the gateway reports that the instrument is idle; without this report it counts as busy."""
        return self._ask("GET", "/state").get("busy") is False

    @during_motion
    def observe(self) -> dict[str, Any]:
        seen = self._ask("GET", "/state").get("seen")
        return dict(seen) if isinstance(seen, dict) else {}

    # -- one action --------------------------------------------------------------------------

    def _carry_out(self, start: Start, action: str, args: Mapping[str, Any]) -> Any:
        self.check_not_stopped()
        order = {"action": action, "args": dict(args), "journal": start.journal}
        try:
            reply = self.link.exchange("PUT", f"/actions/{start.name}", json=order, timeout_s=self._answer_s)
            answer = self._parse_reply(reply)
        except LinkError as error:
            if error.effects == "none":
                raise
            # The gateway may or may not have received it. After the DELETE, a late request starts nothing.
            with self.assume_motion():
                entry = self._poll_action("DELETE", start)
        else:
            if reply.status in REFUSALS:
                self._forget_another(answer)
                raise self.make_refusal(
                    f"{action} is refused: {answer.get('error')}",
                    str(answer.get("remedy") or "Wait, or look at the instrument's own software."),
                )
            entry = self._check_reply(reply)
        return self._await_end(start, entry)

    def _await_end(self, start: Start, entry: dict[str, Any]) -> Any:
        with self.assume_motion():
            while entry.get("status") == "running":
                time.sleep(POLL_S)
                entry = self._poll_action("GET", start)
        match entry.get("status"):
            case "succeeded":
                return entry.get("result")
            case "void" if entry.get("journal") == start.journal:
                raise self.make_refusal("the gateway never heard of the action")
            case "void":
                self._forget_another(entry)
                raise OutcomeUnknown(f"{self.name}: the gateway has lost the journal in which it stood.")
            case "failed":
                effects = entry.get("effects")
                raise DeviceError(
                    f"{self.name}: {entry.get('action')} failed: {entry.get('error')}",
                    effects=effects if effects in ("all", "none", "partial") else "unknown",
                    remedy=str(entry.get("remedy") or "Look at the instrument, then reset the module."),
                )
            case "interrupted":
                raise OutcomeUnknown(f"{self.name}: {entry.get('error')}")
        raise Garbled(f"{self.name}: {entry!r} is no state of an action.")

    def _forget_another(self, answer: dict[str, Any]) -> None:
        """Close the link if the gateway has another journal than before. The next connection then reads the
        name of its journal."""
        if answer.get("journal") != self._journal:
            self.link.close()

    def _poll_action(self, method: str, start: Start) -> dict[str, Any]:
        """The state of an action. The method ``DELETE`` voids the action if the gateway does not know it. A
        gateway that cannot be reached is asked again until the deadline ``lost``."""
        limit_s = self.limit_s("lost", LOST_S)
        return self.ask_again(lambda: self._ask(method, f"/actions/{start.name}"), limit_s, POLL_S)

    # -- one answer --------------------------------------------------------------------------

    def _ask(self, method: str, path: str) -> dict[str, Any]:
        return self._check_reply(self.link.exchange(method, path, timeout_s=self._answer_s))

    def _check_reply(self, reply: HttpReply) -> dict[str, Any]:
        """The body of a successful reply. Raises DeviceError for any other reply."""
        body = self._parse_reply(reply)
        if not reply.ok:
            raise DeviceError(f"{self.name}: the gateway answers {reply.status}: {body.get('error')}.")
        return body

    def _parse_reply(self, reply: HttpReply) -> dict[str, Any]:
        body = reply.json()
        if not isinstance(body, dict):
            raise Garbled(f"{self.name}: {reply.body[:80]!r} is no answer of a gateway.")
        return body

    def _recognise(self) -> str:
        reply = self.link.get("/", timeout_s=self._answer_s)
        try:
            body = json.loads(reply.body)
        except ValueError:
            body = None
        if not isinstance(body, dict) or body.get("gateway") != 1 or not isinstance(body.get("journal"), str):
            raise NotConnected(f"{self.name}: {reply.body[:60]!r} is no gateway of version 1.")
        self._journal = body["journal"]
        self.check_unit(body.get("serial"))
        self.note_firmware(body.get("firmware"))
        return self._describe_gateway(str(body.get("instrument")))

    @staticmethod
    def _describe_gateway(instrument: str) -> str:
        return f"a gateway to {instrument}"


class GatedDriver(GatewayDriver):
    """The driver of an instrument with a lid or a carrier. The two actions of ``gate`` open and close it."""

    gate: ClassVar[tuple[str, str]] = ("open_lid", "close_lid")

    async def open_gate(self) -> None:
        await self.call(self.gate[0])

    async def close_gate(self) -> None:
        await self.call(self.gate[1])

"""WEI's TCP nodes: one JSON object as the request and one as the answer, on a separate connection.

``{"action_handle", "action_vars"}`` is answered by ``{"action_response", "action_msg", "action_log"}`` when
the action is done. There is no framing: the end of the object is the end of the message. There are no ids, no
state and no history. Therefore a start is sent once, and if the answer is lost or does not come, the outcome
is unknown, because a busy device cannot be distinguished from a stuck one.
"""

from __future__ import annotations

import asyncio
import json
from typing import Any, ClassVar

from labos.adapter._decode import TooDeep, read_json_text
from labos.adapter._foreign import SENT, ForeignNode
from labos.adapter._tcp import LARGEST, Address
from labos.core.model import ActionSpec
from labos.errors import DeviceError, OutcomeUnknown
from labos.node.node import Setup

SUCCEEDED = ("succeeded", "0")
FAILED = ("failed", "cancelled", "-1")
NOT_READY = ("not_ready",)


class WeiJsonNode(ForeignNode):
    """Base of the adapters for nodes that answer a JSON object with another one at the end of the action.
    ``hosts`` and ``ports`` are the keys of ``config`` for the node's address."""

    hosts: ClassVar[tuple[str, ...]]
    ports: ClassVar[tuple[str, ...]]

    def __init__(self, setup: Setup) -> None:
        super().__init__(setup)
        self.address = Address(setup.config, self.hosts, self.ports)
        self._exchanging = False

    async def connect(self) -> None:
        self.address.check()

    @property
    def where(self) -> str:
        return str(self.address)

    async def knock(self) -> None:
        """Check whether a program listens there. Raises DeviceError (``none``)."""
        raise NotImplementedError

    async def exchange(self, message: bytes, limit_s: float) -> dict[str, Any]:
        """Connect, journal that the message will be sent, and send it; returns the answer, if it comes within
        ``limit_s``. Raises DeviceError (``none``) before the message is sent, and afterwards OutcomeUnknown
        or TimeoutError."""
        raise NotImplementedError

    @property
    def reports_busy(self) -> bool:
        return False

    async def trouble(self) -> str:
        """Check whether a program listens there. A busy node may accept no other connection."""
        if self._exchanging:
            return ""
        try:
            await self.knock()
        except DeviceError as error:
            return str(error)
        return ""

    async def reset(self) -> None:
        """The protocol has no reset; this ends when the node listens. The person who asks for it has seen
        that the device stands still."""
        if trouble := await self.trouble():
            raise DeviceError(trouble, effects="none")
        self.believe_at_rest()

    async def stop(self) -> None:
        raise DeviceError("The protocol of WEI's TCP and ZeroMQ nodes has no stop.", effects="none")

    async def begin(self, spec: ActionSpec, name: str, args: dict[str, Any]) -> Any:
        message = {"action_handle": name, "action_vars": self.name_places(spec, args)}
        limit_s = self.limit_s(spec)
        self._exchanging = True
        try:
            return _end(name, await self.exchange(json.dumps(message).encode(), limit_s))
        except TimeoutError as error:
            raise OutcomeUnknown(f"{self.where} has not answered {name} for {limit_s:.0f} s") from error
        finally:
            self._exchanging = False


class WeiTcpNode(WeiJsonNode):
    """Config: ``tcp_node_address``, ``tcp_node_port``."""

    hosts = ("tcp_node_address", "tcp_address")
    ports = ("tcp_node_port", "tcp_port")

    async def knock(self) -> None:
        _, writer = await self.address.open(self.patience_s)
        writer.close()

    async def exchange(self, message: bytes, limit_s: float) -> dict[str, Any]:
        reader, writer = await self.address.open(self.patience_s)
        try:
            await self.note_handle(SENT)
            async with asyncio.timeout(limit_s):
                writer.write(message)
                await writer.drain()
                return await _read_object(reader)
        except TimeoutError:
            raise
        except OSError as error:
            raise OutcomeUnknown(f"the line was cut before the answer came ({error})") from error
        finally:
            writer.close()


async def _read_object(reader: asyncio.StreamReader) -> dict[str, Any]:
    """Read a JSON object. Raises OSError, OutcomeUnknown."""
    data = b""
    while len(data) <= LARGEST:
        piece = await reader.read(65536)
        if not piece:
            raise OutcomeUnknown(f"the line was closed after {len(data)} bytes of an incomplete answer")
        data += piece
        if not data.rstrip().endswith(b"}"):
            continue
        try:
            answer = read_json_text(data)
        except TooDeep:
            break
        except ValueError:
            continue
        if isinstance(answer, dict):
            return answer
        break
    raise OutcomeUnknown(f"the received data is not an answer: {data[:100]!r}")


def _end(name: str, answer: dict[str, Any]) -> Any:
    """The result. Raises DeviceError, OutcomeUnknown."""
    status = str(answer.get("action_response")).rpartition(".")[2].lower()
    words = str(answer.get("action_log") or answer.get("action_msg") or "")
    if status in SUCCEEDED:
        return answer.get("action_msg")
    if status in NOT_READY:
        raise DeviceError(f"{name}: {words or 'the foreign node is not ready'}", effects="none")
    if status in FAILED:
        raise DeviceError(f"{name}: {words or status}")
    raise OutcomeUnknown(f"the foreign node answered {status!r}, which is not an outcome of an action")

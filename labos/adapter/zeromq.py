"""WEI's ZeroMQ nodes: the JSON of its TCP nodes, over a request socket. ZeroMQ stores messages that cannot be
sent yet and sends them when a program listens, which may be long after the lab has stopped waiting for the
action. Therefore a message is sent only after a connection exists. Each message has its own socket, which is
closed and loses unsent data.
"""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncGenerator
from typing import Any

from labos.adapter._channels import report_missing_package
from labos.adapter._decode import read_json_text
from labos.adapter._foreign import SENT
from labos.adapter._keepalive import choose_timings
from labos.adapter._tcp import CONNECT_S, LARGEST
from labos.adapter.tcp import WeiJsonNode
from labos.errors import DeviceError, OutcomeUnknown
from labos.node.node import Setup


class WeiZmqNode(WeiJsonNode):
    """Config: ``zmq_node_address``, ``zmq_node_port``."""

    hosts = ("zmq_node_address",)
    ports = ("zmq_node_port",)

    def __init__(self, setup: Setup) -> None:
        super().__init__(setup)
        self._context: Any = None

    async def connect(self) -> None:
        await super().connect()
        try:
            import zmq
            import zmq.asyncio
            import zmq.utils.monitor
        except ImportError as error:
            raise report_missing_package(error, "zmq") from error
        await self.close()
        self._zmq: Any = zmq
        self._context = zmq.asyncio.Context()

    async def close(self) -> None:
        context, self._context = self._context, None
        if context is not None:
            context.destroy(linger=0)

    async def knock(self) -> None:
        async with self._connect():
            pass

    async def exchange(self, message: bytes, limit_s: float) -> dict[str, Any]:
        async with self._connect() as (socket, monitor):
            await self.note_handle(SENT)
            try:
                await socket.send(message, flags=self._zmq.NOBLOCK)
            except self._zmq.Again as error:
                raise DeviceError("The line was cut before it was sent.", effects="none") from error
            answer = asyncio.ensure_future(socket.recv())
            broken = asyncio.ensure_future(self._see(monitor, self._zmq.EVENT_DISCONNECTED))
            try:
                done, _ = await asyncio.wait(
                    {answer, broken}, timeout=limit_s, return_when=asyncio.FIRST_COMPLETED
                )
                if not done:
                    raise TimeoutError
                if not answer.done():
                    raise OutcomeUnknown("the line was cut before the answer came")
                return _decode_object(answer.result())
            except self._zmq.ZMQError as error:
                raise OutcomeUnknown(f"no answer came ({error})") from error
            finally:
                answer.cancel()
                broken.cancel()

    @contextlib.asynccontextmanager
    async def _connect(self) -> AsyncGenerator[tuple[Any, Any], None]:
        """A socket with a connection, and the monitor of its events. Raises DeviceError (``none``)."""
        zmq = self._zmq
        if self._context is None:
            raise DeviceError("The adapter is not connected.", effects="none")
        socket = self._context.socket(zmq.REQ)
        socket.setsockopt(zmq.LINGER, 0)
        socket.setsockopt(zmq.IMMEDIATE, 1)
        socket.setsockopt(zmq.TCP_KEEPALIVE, 1)
        names = zmq.TCP_KEEPALIVE_IDLE, zmq.TCP_KEEPALIVE_INTVL, zmq.TCP_KEEPALIVE_CNT
        for name, value in zip(names, choose_timings(self.patience_s), strict=True):
            socket.setsockopt(name, value)
        socket.setsockopt(zmq.MAXMSGSIZE, LARGEST)
        monitor = socket.get_monitor_socket(
            zmq.EVENT_HANDSHAKE_SUCCEEDED | zmq.EVENT_CONNECT_RETRIED | zmq.EVENT_DISCONNECTED
        )
        try:
            try:
                socket.connect(f"tcp://{self.address}")
                seeing = self._see(monitor, zmq.EVENT_HANDSHAKE_SUCCEEDED, zmq.EVENT_CONNECT_RETRIED)
                if await asyncio.wait_for(seeing, CONNECT_S) != zmq.EVENT_HANDSHAKE_SUCCEEDED:
                    raise ConnectionRefusedError("no process listens")
            except (OSError, TimeoutError, zmq.ZMQError) as error:
                raise self.address.make_no_answer_error(error) from error
            yield socket, monitor
        finally:
            socket.disable_monitor()
            monitor.close(linger=0)
            socket.close(linger=0)

    async def _see(self, monitor: Any, *events: int) -> int:
        """Wait for one of these events of the connection."""
        while True:
            message = await self._zmq.utils.monitor.recv_monitor_message(monitor)
            if message["event"] in events:
                return int(message["event"])


def _decode_object(answer: bytes) -> dict[str, Any]:
    """Raises OutcomeUnknown."""
    try:
        decoded = read_json_text(answer)
    except ValueError:
        decoded = None
    if not isinstance(decoded, dict):
        raise OutcomeUnknown(f"the received data is not an answer: {answer[:100]!r}")
    return decoded

"""Answers leave at once: a small packet does not wait until the one before it was acknowledged."""

from __future__ import annotations

import asyncio
import socket

from labos.http.server import listen


def test_a_connection_sends_small_packets_at_once() -> None:
    async def body() -> bool:
        told: asyncio.Future[bool] = asyncio.get_running_loop().create_future()

        async def serve(_: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
            line = writer.get_extra_info("socket")
            told.set_result(bool(line.getsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY)))
            writer.close()

        server = await asyncio.start_server(serve, sock=listen("127.0.0.1", 0))
        async with server:
            port = server.sockets[0].getsockname()[1]
            _, writer = await asyncio.open_connection("127.0.0.1", port)
            try:
                return await asyncio.wait_for(told, 10.0)
            finally:
                writer.close()

    assert asyncio.run(body())

"""A request that has to be sent again is the same request."""

from __future__ import annotations

import gc
import socket
import threading
from typing import Any

import pytest

from labos.client import LabClient

BODY = b'{"run":"R1","a":[]}'
ANSWER = b"HTTP/1.1 201 Created\r\ncontent-type: application/json\r\ncontent-length: 19\r\n\r\n" + BODY


def test_a_request_that_was_broken_off_is_sent_again_with_all_its_headers() -> None:
    """The server dies after it has read the first one; its key makes the second one the same request."""
    heard: list[str] = []

    def serve(server: socket.socket) -> None:
        for number in range(3):
            line, _ = server.accept()
            with line:
                read = b""
                while b"\r\n\r\n" not in read:
                    read += line.recv(65536)
                heard.append(read.decode().lower())
                if number == 2:
                    line.sendall(ANSWER)

    with socket.create_server(("127.0.0.1", 0)) as server:
        serving = threading.Thread(target=serve, args=(server,), daemon=True)
        serving.start()
        with LabClient(f"http://127.0.0.1:{server.getsockname()[1]}") as client:
            assert client.submit("pcr", user="ada", request="key-1") == "R1"
        serving.join(10)
    assert len(heard) == 3
    for each in heard:
        assert "content-type: application/json" in each
        assert "idempotency-key: key-1" in each


def test_a_client_that_is_closed_while_it_connects_leaves_no_connection_open(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    connecting, is_closed, connect = threading.Event(), threading.Event(), socket.create_connection
    opened: list[int] = []

    def connect_late(*given: Any, **options: Any) -> socket.socket:
        connecting.set()
        assert is_closed.wait(30)
        found = connect(*given, **options)
        opened.append(found.fileno())
        return found

    def serve(server: socket.socket) -> None:
        line, _ = server.accept()
        with line:
            read = b""
            while not read.endswith(b"}"):
                read += line.recv(65536)
            line.sendall(ANSWER)
            ended.append(line.recv(1))  # nothing comes: it is the end of the connection

    ended: list[bytes] = []
    monkeypatch.setattr(socket, "create_connection", connect_late)
    with socket.create_server(("127.0.0.1", 0)) as server:
        serving = threading.Thread(target=serve, args=(server,), daemon=True)
        serving.start()
        client = LabClient(f"http://127.0.0.1:{server.getsockname()[1]}")
        asking = threading.Thread(target=client.submit, args=("pcr",), kwargs={"user": "ada"}, daemon=True)
        asking.start()
        assert connecting.wait(30)
        client.close()
        is_closed.set()
        asking.join(30)
        serving.join(30)
    gc.collect()
    assert ended == [b""]
    assert len(opened) == 1

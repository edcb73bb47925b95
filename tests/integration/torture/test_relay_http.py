"""The line in the middle of HTTP: what becomes of an answer is what becomes of all of it."""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Callable, Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import pytest

from labos.errors import Garbled, HalfReply, LinkError, LinkLost, NoReply, NotConnected
from labos.link import HttpLink
from labos.torture.relay import Mode
from labos.torture.relay_http import HttpRelay, open_relay

LONG_S, SHORT_S = 20.0, 0.3


class Clock(BaseHTTPRequestHandler):
    """Counts its answers, and says each in two pieces."""

    protocol_version = "HTTP/1.1"
    count = 0

    def do_GET(self) -> None:
        type(self).count += 1
        body = json.dumps({"count": self.count}).encode()
        self.send_response(200)
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        self.wfile.flush()
        self.wfile.write(body)

    def log_message(self, format: str, *args: Any) -> None:
        """Nothing is written to the terminal."""


@pytest.fixture
def relay(tmp_path: Path) -> Iterator[HttpRelay]:
    Clock.count = 0
    server = ThreadingHTTPServer(("127.0.0.1", 0), Clock)
    server.daemon_threads = True
    threading.Thread(target=server.serve_forever, args=(0.02,), daemon=True).start()
    relay = open_relay(f"http://127.0.0.1:{server.server_port}", tmp_path)
    assert isinstance(relay, HttpRelay)
    yield relay
    relay.close()
    server.shutdown()
    server.server_close()


@pytest.fixture
def link(relay: HttpRelay) -> Iterator[HttpLink]:
    link = HttpLink(relay.address)
    yield link
    link.close()


def count(link: HttpLink, timeout_s: float = LONG_S) -> int:
    return int(link.get("/", timeout_s=timeout_s).json()["count"])


@pytest.mark.parametrize(
    ("mode", "error"), [("cut", HalfReply | LinkLost), ("garble", Garbled), ("lose", NoReply)]
)
def test_one_answer_is_spoiled_whole(relay: HttpRelay, link: HttpLink, mode: Mode, error: Any) -> None:
    assert count(link) == 1
    relay.spoil(mode, times=1)
    with pytest.raises(LinkError) as told:
        count(link, SHORT_S if mode == "lose" else LONG_S)
    assert isinstance(told.value, error)
    assert count(link) == 3


def test_noise_is_http_or_none(relay: HttpRelay, link: HttpLink) -> None:
    relay.spoil("garble")
    assert link.get("/", timeout_s=LONG_S).status == 200  # another one answers in its place
    with pytest.raises(Garbled):
        link.get("/", timeout_s=LONG_S)


def test_an_answer_that_is_held_back_comes_late(relay: HttpRelay, link: HttpLink) -> None:
    relay.spoil("hold")
    answers: list[int] = []
    asking = threading.Thread(target=lambda: answers.append(count(link)))
    asking.start()
    _until(lambda: relay.spoiled_count == 1)
    assert answers == []
    relay.restore()
    asking.join(LONG_S)
    assert answers == [1]


@pytest.mark.parametrize("how", ["unplug", "off"])
def test_without_cable_or_power_nobody_takes_a_connection(relay: HttpRelay, link: HttpLink, how: str) -> None:
    assert count(link) == 1
    target = f"http://127.0.0.1:{relay._target[1]}"
    relay.unplug() if how == "unplug" else relay.reach("")
    link.close()
    with pytest.raises(NotConnected):
        count(link)
    relay.plug()
    relay.reach(target)
    assert count(link) == 2


def _until(reached: Callable[[], bool]) -> None:
    deadline = time.monotonic() + LONG_S
    while not reached() and time.monotonic() < deadline:
        time.sleep(0.005)
    assert reached()

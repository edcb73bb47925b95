"""HTTP against a real server that misbehaves on demand."""

from __future__ import annotations

import json
import threading
import time
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import pytest

from labos.errors import Garbled, HalfReply, LinkLost, NoReply, NotConnected, WrongDevice
from labos.link import HttpLink, ScriptedHttp, keep_transcript

asked: list[str] = []
go_on = threading.Event()


class Device(BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.1"

    def do_GET(self) -> None:
        asked.append(self.path)
        match self.path:
            case "/slow":
                time.sleep(0.5)
            case "/home":
                go_on.wait(20.0)
            case "/drip":
                self.send_response(200)
                self.send_header("Content-Length", "100")
                self.end_headers()
                for _ in range(4):
                    self.wfile.write(b"x")
                    time.sleep(0.1)
                self.close_connection = True
                return
            case "/broken":
                self.wfile.write(b"HTTP/1.1 200 OK\r\nContent-Length: 100\r\n\r\nhalf")
                self.close_connection = True
                return
            case "/hang-up":
                self.close_connection = True
                return
            case "/noise":
                self.wfile.write(b"*ready:00,00,00\r\n\r\n")
                self.close_connection = True
                return
        self.say(
            404 if self.path == "/nothing" else 200, b"no json" if self.path == "/text" else b'{"t": 22}'
        )

    def do_POST(self) -> None:
        asked.append(self.path)
        body = self.rfile.read(int(self.headers["Content-Length"]))
        self.say(201, json.dumps({"got": json.loads(body)}).encode())

    def say(self, status: int, body: bytes) -> None:
        self.send_response(status)
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        try:
            self.wfile.write(body)
        except OSError:
            pass  # it was too slow, and nobody listens

    def log_message(self, *_: object) -> None:
        pass


@pytest.fixture
def url() -> Iterator[str]:
    asked.clear()
    go_on.clear()
    server = ThreadingHTTPServer(("127.0.0.1", 0), Device)
    thread = threading.Thread(target=server.serve_forever, args=(0.02,), daemon=True)
    thread.start()
    yield f"http://127.0.0.1:{server.server_port}"
    server.shutdown()
    server.server_close()


@pytest.fixture
def link(url: str) -> Iterator[HttpLink]:
    link = HttpLink(url)
    yield link
    link.close()


def test_asks_and_hears(link: HttpLink) -> None:
    assert link.get("/t").json() == {"t": 22}
    reply = link.post("/runs", json={"protocol": "a"})
    assert (reply.status, reply.ok, reply.json()) == (201, True, {"got": {"protocol": "a"}})
    assert not link.get("/nothing").ok


@pytest.mark.parametrize(
    ("path", "kind"),
    [
        ("/slow", NoReply),
        ("/drip", HalfReply),
        ("/broken", HalfReply),
        ("/hang-up", LinkLost),
        ("/noise", Garbled),
    ],
)
def test_what_goes_wrong_is_named_and_asked_once(link: HttpLink, path: str, kind: type[Exception]) -> None:
    with pytest.raises(kind) as told:
        link.get(path, timeout_s=0.25)
    assert type(told.value) is kind
    assert [path] == asked
    assert link.get("/t").json() == {"t": 22}


def test_what_is_no_json(link: HttpLink) -> None:
    with pytest.raises(Garbled, match="no json"):
        link.get("/text").json()


def test_nobody_there() -> None:
    with pytest.raises(NotConnected) as told:
        HttpLink("http://127.0.0.1:9").get("/t", timeout_s=1)
    assert told.value.effects == "none"


def test_another_device_at_the_same_address(url: str) -> None:
    link = HttpLink(url, identify=lambda link: str(link.get("/t").json()["t"]), expected="17")
    with pytest.raises(WrongDevice, match="17 was expected, but 22 answers"):
        link.post("/runs", json={})
    assert asked == ["/t"]


def test_a_stop_does_not_wait_for_a_long_question(link: HttpLink) -> None:
    answers: list[object] = []
    homing = threading.Thread(target=lambda: answers.append(link.get("/home", timeout_s=20.0).json()))
    homing.start()
    while "/home" not in asked:
        time.sleep(0.005)
    assert link.post("/stop", json={}).status == 201
    with pytest.raises(LinkLost):
        link.get("/hang-up")  # the next question connects anew; who waits still gets an answer
    assert link.get("/t").ok
    assert answers == []
    go_on.set()
    homing.join(20.0)
    assert answers == [{"t": 22}]


def test_a_transcript_replays(link: HttpLink, tmp_path: Path) -> None:
    path = tmp_path / "talk.txt"
    with keep_transcript(path):
        link.get("/t")
        link.post("/runs", json={"a": 1})
        with pytest.raises(NoReply):
            link.get("/slow", timeout_s=0.1)
    again = HttpLink("http://anywhere", script=ScriptedHttp(path))
    assert again.get("/t").json() == {"t": 22}
    assert again.post("/runs", json={"a": 1}).status == 201
    with pytest.raises(NoReply):
        again.get("/slow")

"""A request that two programs could read differently is refused, and its connection closed: nobody hides a
request in the body of another one."""

from __future__ import annotations

import socket
from collections.abc import Iterator

import h11
import pytest

from labos.bootstrap import LabThread
from labos.http.framing import StrictConnection
from labos.settings import Settings

HIDDEN = b"GET /health HTTP/1.1\r\nhost: localhost\r\n\r\n"
JSON = b"host: localhost\r\ncontent-type: application/json\r\n"
ESTOP = b"POST /api/v1/estop HTTP/1.1\r\n"


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Iterator[LabThread]:
    settings = Settings.make(tmp_path_factory.mktemp("lab"), simulate=True)
    with LabThread(settings, nodes="none") as running:
        yield running


def say(lab: LabThread, *pieces: bytes) -> bytes:
    """What the server answers until it closes the connection."""
    host, _, port = lab.url.removeprefix("http://").partition(":")
    found = bytearray()
    with socket.create_connection((host, int(port)), timeout=20) as connection:
        for piece in pieces:
            connection.sendall(piece)
        try:
            while got := connection.recv(65536):
                found += got
        except ConnectionResetError:
            pass
    return bytes(found)


def frame_chunks(*more: bytes) -> bytes:
    return ESTOP + JSON + b"transfer-encoding: chunked\r\n" + b"".join(more)


AMBIGUOUS = {
    "length and chunks": frame_chunks(b"content-length: 6\r\n\r\n0\r\n\r\n"),
    "chunks and length": ESTOP + JSON + b"Content-Length: 6\r\nTransfer-Encoding: chunked\r\n\r\n0\r\n\r\n",
    "two lengths": ESTOP + JSON + b"content-length: 2\r\ncontent-length: 40\r\n\r\n{}",
    "two lengths in one": ESTOP + JSON + b"content-length: 2, 40\r\n\r\n{}",
    "a length with a sign": ESTOP + JSON + b"content-length: +2\r\n\r\n{}",
    "a length in hexadecimal": ESTOP + JSON + b"content-length: 0x2\r\n\r\n{}",
    "chunks twice": frame_chunks(b"transfer-encoding: identity\r\n\r\n0\r\n\r\n"),
    "other chunks": ESTOP + JSON + b"transfer-encoding: xchunked\r\n\r\n0\r\n\r\n",
    "chunks in HTTP/1.0": frame_chunks(b"\r\n0\r\n\r\n").replace(b"HTTP/1.1", b"HTTP/1.0"),
    "a space before the colon": ESTOP + JSON + b"content-length : 2\r\n\r\n{}",
    "a continued header": ESTOP + JSON + b"x: a\r\n content-length: 2\r\n\r\n",
    "a continued coding": ESTOP + JSON + b"transfer-encoding:\r\n chunked\r\n\r\n0\r\n\r\n",
    "lines that end with LF": b"GET /health HTTP/1.1\nhost: localhost\n\n",
    "one line that ends with LF": b"GET /health HTTP/1.1\r\nhost: localhost\nx: y\r\n\r\n",
    "a head that ends with LF": b"GET /health HTTP/1.1\r\nhost: localhost\r\n\n",
    "a head that begins with LF": b"\nGET /health HTTP/1.1\r\nhost: localhost\r\n\r\n",
    "a bare CR": b"GET /health HTTP/1.1\r\nhost: localhost\r\nx: a\rcontent-length: 5\r\n\r\n",
    "two hosts": b"GET /health HTTP/1.1\r\nhost: localhost\r\nhost: evil.example\r\n\r\n",
}


@pytest.mark.parametrize("request_", AMBIGUOUS.values(), ids=AMBIGUOUS)
def test_an_ambiguous_request_is_refused_and_nothing_behind_it_is_read(
    lab: LabThread, request_: bytes
) -> None:
    answer = say(lab, request_ + HIDDEN)
    assert answer.split(b"\r\n")[0] == b"HTTP/1.1 400 Bad Request", answer
    assert b"application/problem+json" in answer
    assert b"connection: close" in answer.lower()
    assert answer.count(b"HTTP/1.1 ") == 1, answer


@pytest.mark.parametrize(
    "body",
    [
        b"2;\nx\r\n{}\r\n0\r\n\r\n",
        b"2;a\rb\r\n{}\r\n0\r\n\r\n",
        b"2\n{}\n0\n\n",
        b"2\r\n{}xx0\r\n\r\n",
        b"-2\r\n{}\r\n0\r\n\r\n",
        b"0x2\r\n{}\r\n0\r\n\r\n",
        b"2\r\n{}\r\n0\r\n\n",
        b"2\r\n{}\r\n0\r\nx: a\n\r\n",
        b"2\r\n{}\r\n0\r\nx: a\r\n b\r\n\r\n",
    ],
)
def test_chunks_that_can_be_read_in_two_ways_end_the_connection(lab: LabThread, body: bytes) -> None:
    answer = say(lab, frame_chunks(b"\r\n"), body + HIDDEN)
    assert b"HTTP/1.1 200" not in answer, answer


def test_a_fault_is_found_wherever_the_bytes_are_cut() -> None:
    def answers(raw: bytes, cut: int) -> str:
        connection = StrictConnection()
        for piece in (raw[:cut], raw[cut:]):
            connection.receive_data(piece)
            try:
                event = connection.next_event()
            except h11.RemoteProtocolError:
                return "refused"
            if isinstance(event, h11.Request):
                return "read"
        return "waits"

    good = b"GET / HTTP/1.1\r\nhost: a\r\nx: b\r\n\r\n"
    for cut in range(1, len(good)):
        assert answers(good, cut) == "read", cut
    for bad in (
        good.replace(b"host: a\r\n", b"host: a\n"),
        good.replace(b"x: b\r\n", b"x: b\r\n c\r\n"),
        good[:-2] + b"\n",
        good.replace(b"x: b", b"content-length: 1\r\ntransfer-encoding: chunked"),
    ):
        for cut in range(1, len(bad)):
            assert answers(bad, cut) == "refused", (bad, cut)


def test_what_is_clear_is_answered_also_in_one_piece_and_byte_by_byte(lab: LabThread) -> None:
    last = HIDDEN.replace(b"\r\n\r\n", b"\r\nconnection: close\r\n\r\n")
    assert say(lab, HIDDEN + last).count(b"HTTP/1.1 200 OK") == 2
    assert say(lab, *(last[n : n + 1] for n in range(len(last)))).count(b"HTTP/1.1 200 OK") == 1
    pieces = (frame_chunks(b"connection: close\r\n\r\n"), b"2;a=b\r\n{}\r\n", b"0\r\nx: a\r\n\r\n")
    assert b"HTTP/1.1 4" in (found := say(lab, *pieces))
    assert b"bad_input" in found  # the body was read: it lacks its fields

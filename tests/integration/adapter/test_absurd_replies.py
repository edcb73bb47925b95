"""Foreign nodes that answer what no node should: an error of the device, and the adapter lives on."""

from __future__ import annotations

import asyncio
import gzip
import io
import zipfile
from collections.abc import Awaitable, Callable
from typing import Any

import httpx
import pytest

from labos.adapter import _http
from labos.adapter._decode import LARGEST_JSON, read_json_text
from labos.adapter._http import HttpClient, NoResponse, read_json
from labos.adapter.protobuf import _parse_json
from labos.adapter.ros import _table
from labos.adapter.sila.features import Named, read_feature, unwrap
from labos.adapter.tcp import _read_object as tcp_object
from labos.adapter.wei import _read_header, _unzip
from labos.adapter.zeromq import _decode_object as zmq_object
from labos.errors import DeviceError, OutcomeUnknown

DEEP = b"[" * 100_000 + b"]" * 100_000
ABSURD = (DEEP, b'{"a":' * 50_000, b"\xff\xfe", b'{"a":"\xff"}', b"9" * 10_000, b"", b'"' + b"x" * 500)


def make_response(body: bytes, headers: dict[str, str] | None = None, status: int = 200) -> httpx.Response:
    request = httpx.Request("GET", "http://device/state")
    return httpx.Response(status, headers=headers, content=body, request=request)


def with_server(
    replies: list[bytes],
    use: Callable[[HttpClient], Awaitable[None]],
    headers: bytes = b"",
    status: bytes = b"200 OK",
) -> None:
    """A device that answers each request with the next body, in pieces."""

    async def main() -> None:
        left = list(replies)

        async def answer(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
            await reader.readuntil(b"\r\n\r\n")
            body = left.pop(0)
            writer.write(b"HTTP/1.1 200 OK\r\n" + headers)
            writer.write(b"Content-Length: %d\r\nConnection: close\r\n\r\n" % len(body))
            try:
                for start in range(0, len(body), 65536):
                    writer.write(body[start : start + 65536])
                    await writer.drain()
            except ConnectionError:
                pass  # the other side has heard enough
            writer.close()

        server = await asyncio.start_server(answer, "127.0.0.1", 0)
        port = server.sockets[0].getsockname()[1]
        http = HttpClient(f"http://127.0.0.1:{port}", patience_s=5.0)
        try:
            await use(http)
        finally:
            await http.close()
            server.close()

    asyncio.run(main())


@pytest.mark.parametrize("text", ABSURD)
def test_what_cannot_be_read_is_a_value_error(text: bytes) -> None:
    with pytest.raises(ValueError, match=r"."):
        read_json_text(text)
    with pytest.raises(ValueError, match="16777216 are read"):
        read_json_text(b" " * (LARGEST_JSON + 1))


def test_an_http_answer_that_cannot_be_read_is_an_error_of_the_device() -> None:
    async def use(http: HttpClient) -> None:
        for _ in ABSURD:
            with pytest.raises(DeviceError) as caught:
                await http.ask("/state")
            assert len(str(caught.value)) < 1_000

    with_server(list(ABSURD), use)
    for body in ABSURD:
        for status in (400, 500):
            with pytest.raises(DeviceError) as caught:
                read_json(make_response(body, status=status))
            assert len(str(caught.value)) < 1_000


def test_an_http_answer_without_an_end_is_not_kept_in_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(_http, "LARGEST_ANSWER", 1_000_000)

    async def use(http: HttpClient) -> None:
        with pytest.raises(NoResponse, match="more than 1000000 bytes were received"):
            await http.send("POST", "/action")
        with pytest.raises(DeviceError, match="more than 1000000 bytes were received") as caught:
            await http.ask("/state")
        assert caught.value.effects == "none"

    with_server([b"x" * 3_000_000] * 2, use)
    packed = gzip.compress(b"0" * 50_000_000)
    assert len(packed) < 100_000
    with_server([packed] * 2, use, headers=b"Content-Encoding: gzip\r\n")


def test_a_packed_answer_is_read_as_before() -> None:
    async def use(http: HttpClient) -> None:
        assert await http.ask("/state") == {"status": "idle"}

    with_server([gzip.compress(b'{"status":"idle"}')], use, headers=b"Content-Encoding: gzip\r\n")


def test_headers_and_archives_of_wei() -> None:
    for status, effects in (("StepStatus.SUCCEEDED", "all"), ("failed", "unknown")):
        answer = make_response(b"", {"x-wei-status": status, "x-wei-data": "[" * 50_000})
        with pytest.raises(DeviceError, match="cannot be read as JSON") as caught:
            _read_header(answer, "x-wei-data")
        assert caught.value.effects == effects
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("scan.tif", b"0" * 300_000_000)
    assert len(packed.getvalue()) < 1_000_000
    with pytest.raises(DeviceError, match="more than") as caught:
        _unzip(packed.getvalue(), "scan.tif")
    assert caught.value.effects == "all"


@pytest.mark.parametrize("answer", [DEEP, b'{"a":' + DEEP + b"}", b"[]", b"\xff", b"9" * 10_000 + b"}"])
def test_one_object_over_tcp_and_zeromq(answer: bytes) -> None:
    async def main() -> None:
        reader = asyncio.StreamReader()
        reader.feed_data(answer)
        reader.feed_eof()
        with pytest.raises(OutcomeUnknown):
            await tcp_object(reader)

    asyncio.run(main())
    with pytest.raises(OutcomeUnknown):
        zmq_object(answer)


def test_texts_in_answers() -> None:
    deep = DEEP.decode()
    with pytest.raises(DeviceError, match="not a table"):
        _table(deep)
    with pytest.raises(DeviceError, match="not a table"):
        _table("(" * 5_000)
    assert _parse_json(deep) == deep


@pytest.mark.parametrize("inside", ["<DataType>" + "<List><DataType>" * 5_000, "<DataType/>", ""])
def test_a_feature_definition_that_cannot_be_read(inside: str) -> None:
    closing = "</DataType></List>" * 5_000 + "</DataType>" if "List" in inside else ""
    text = (
        '<Feature Originator="org" FeatureVersion="1.0"><Identifier>F</Identifier><Property>'
        f"<Identifier>P</Identifier>{inside}{closing}</Property></Feature>"
    )
    with pytest.raises(DeviceError, match=r"cannot be read|too deep"):
        read_feature(text)


def test_a_data_type_that_is_itself() -> None:
    types: dict[str, Any] = {"A": Named("B"), "B": Named("A")}
    assert len(list(unwrap(Named("A"), types))) == 3

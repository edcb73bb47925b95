"""SiLA servers that do what the tried ones do not: a gRPC server of the tests, byte by byte."""

from __future__ import annotations

import asyncio
import base64
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from labos.adapter.sila import client, node
from labos.adapter.sila.describe import actions_of
from labos.adapter.sila.features import read_feature
from labos.core.model import Description
from tests.foreign.make import ROOT
from tests.integration.adapter.bench import Bench
from tests.integration.adapter.scenario import play

grpc = pytest.importorskip("grpc", reason="needs labos-sdl[sila]")

run = partial(play, limit_s=60.0)
TEXT = (ROOT / "tests" / "foreign" / "shaker.sila.xml").read_text()
FEATURE = read_feature(TEXT)
DESCRIPTION = Description(driver="sila_node", version="", description="", actions=actions_of([FEATURE]))
ARGS = {"speed": 300, "duration": 0.3, "label": "", "mode": "Gentle"}


def field(number: int, content: bytes) -> bytes:
    """A field of a message that holds bytes, a text or a message."""
    length, size = len(content), b""
    while length > 0x7F:
        size += bytes([length & 0x7F | 0x80])
        length >>= 7
    return bytes([number << 3 | 2]) + size + bytes([length]) + content


TEXT_OF = {
    "Get_ImplementedFeatures": FEATURE.identifier,
    "GetFeatureDefinition": TEXT,
    "Get_ServerUUID": "0d0f4ba7-56a7-4a0c-8d9a-3a8e6e1c2f11",
}
CONFIRMED = field(1, field(1, b"0d0f4ba7-56a7-4a0c-8d9a-3a8e6e1c2f12"))
NOT_FINISHED = base64.b64encode(field(4, bytes([1 << 3, 2]))).decode()
FINISHED = bytes([1 << 3, 2])
SILENT = "no answer ever comes"


class Odd(grpc.GenericRpcHandler):  # type: ignore[misc]
    """Describes itself as the shaker; what it answers to single calls is said: bytes, or a refusal."""

    def __init__(self, **answers: Any) -> None:
        self.answers = {"ShakePlate": CONFIRMED, "ShakePlate_Info": FINISHED, **answers}
        self.started = 0

    def service(self, details: Any) -> Any:
        name = details.method.rpartition("/")[2]
        if name in TEXT_OF:
            told = field(1, field(1, TEXT_OF[name].encode()))
            return grpc.unary_unary_rpc_method_handler(partial(self.tell, told))
        self.started += name == "ShakePlate"
        answer = self.answers.get(name)
        if name.endswith("_Info"):
            return grpc.unary_stream_rpc_method_handler(partial(self.stream, answer))
        return grpc.unary_unary_rpc_method_handler(partial(self.tell, answer))

    async def tell(self, answer: Any, request: bytes, context: Any) -> bytes:
        if answer == SILENT:
            await asyncio.Event().wait()
        if isinstance(answer, str):
            await context.abort(grpc.StatusCode.ABORTED, answer)
        if not isinstance(answer, bytes):
            await context.abort(answer or grpc.StatusCode.UNIMPLEMENTED, "not to you")
        return bytes(answer)

    async def stream(self, answer: Any, request: bytes, context: Any) -> AsyncIterator[bytes]:
        yield await self.tell(answer, request, context)


@asynccontextmanager
async def serve(odd: Odd) -> AsyncIterator[dict[str, Any]]:
    server = grpc.aio.server()
    server.add_generic_rpc_handlers((odd,))
    port = server.add_insecure_port("127.0.0.1:0")
    await server.start()
    try:
        yield {"sila_address": f"127.0.0.1:{port}", "sila_insecure": True, "patience_s": 0.5}
    finally:
        await server.stop(0.1)


def find_end(folder: Path, odd: Odd, how: str) -> Any:
    """What the node says of an action on it when it is ``finished`` or ``interrupted``."""
    told: list[Any] = []

    async def scenario(here: Bench) -> None:
        async with serve(odd) as where:
            node = await here.adapter("sila_node", DESCRIPTION, **where)
            await here.idle()
            await here.start("a1", "shake_plate", **ARGS)
            told.append(await here.status("a1", how))
            await node.close()
        assert odd.started == 1

    run(folder, scenario)
    return told[0]


@pytest.mark.parametrize("question", ["ShakePlate_Info", "ShakePlate_Result"])
def test_a_question_that_is_refused_says_nothing_of_the_motion(tmp_path: Path, question: str) -> None:
    refused = {question: grpc.StatusCode.PERMISSION_DENIED}
    odd = Odd(**{"ShakePlate_Result": field(1, b""), **refused})
    assert "not to you" in find_end(tmp_path, odd, "interrupted").why


def test_a_server_that_contradicts_itself_is_not_asked_for_ever(tmp_path: Path) -> None:
    """It says that the execution has finished, and then that it has not."""
    outcome = find_end(tmp_path, Odd(ShakePlate_Result=NOT_FINISHED), "interrupted")
    assert "has not answered" in outcome.why


def test_a_start_that_is_refused_has_moved_nothing(tmp_path: Path) -> None:
    outcome = find_end(tmp_path, Odd(ShakePlate=grpc.StatusCode.UNAUTHENTICATED), "finished").outcome
    assert (outcome.succeeded, outcome.effects) == (False, "none")
    assert "not to you" in outcome.error


@pytest.mark.parametrize(
    "confirmation", [b"", field(1, b""), b"\xff"], ids=["empty", "no UUID", "no message"]
)
def test_a_start_without_a_uuid_is_unknown(tmp_path: Path, confirmation: bytes) -> None:
    assert "UUID" in find_end(tmp_path, Odd(ShakePlate=confirmation), "interrupted").why


def test_responses_that_cannot_be_read_are_those_of_something_done(tmp_path: Path) -> None:
    outcome = find_end(tmp_path, Odd(ShakePlate_Result=b"\xff"), "finished").outcome
    assert (outcome.succeeded, outcome.effects) == (False, "all")
    assert "its responses cannot be read" in outcome.error


@pytest.mark.parametrize("question", ["ShakePlate", "ShakePlate_Info", "ShakePlate_Result"])
def test_a_server_that_falls_silent_ends_as_unknown(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, question: str
) -> None:
    """It answers other questions still; what it was asked about the motion it never answers."""
    for module, name in ((client, "READ_S"), (node, "START_S"), (node, "WATCH_S")):
        monkeypatch.setattr(module, name, 0.3)
    why = find_end(tmp_path, Odd(**{"ShakePlate_Result": field(1, b""), question: SILENT}), "interrupted").why
    assert "127.0.0.1:" in why, why
    assert f"{question}: no answer within 0.3 s" in why.replace("ShakingController/", ""), why

"""The adapter of protobuf over TCP, with a server in a process of its own that speaks by generated code
(``grpcio-tools`` 1.85.1)."""

from __future__ import annotations

import asyncio
import subprocess
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import pytest
import yaml

from labos.adapter import describe_foreign
from labos.adapter._protobuf import SCHEMA
from labos.core.model import ActionSpec, Arg, Description
from labos.settings import free_port
from tests.integration.adapter.bench import Bench
from tests.integration.adapter.scenario import LABEL, SPEED, TIME, play
from tests.integration.bus.contract import until
from tests.support.foreign import python_of
from tests.support.lab_process import labos
from tests.support.protobuf import PROTO, ProtobufProcess
from tests.support.proxy import Proxy

pytest.importorskip("google.protobuf", reason="needs labos-sdl[protobuf]")

run = partial(play, limit_s=90.0)
SHAKE = ActionSpec(name="shake", args=(SPEED, TIME, LABEL), duration_s=0.1)
RUN = ActionSpec(name="run", args=(Arg(name="protocol", type="file"),))
DESCRIPTION = Description(
    driver="tcp_node", version="", description="", actions=(SHAKE, RUN, ActionSpec(name="jam"))
)


@pytest.fixture(scope="module")
def node(tmp_path_factory: pytest.TempPathFactory) -> Iterator[ProtobufProcess]:
    process = ProtobufProcess("protobuf", tmp_path_factory.mktemp("protobuf"), free_port())
    try:
        yield process.start()
    finally:
        process.kill()


@pytest.fixture
def proxy(node: ProtobufProcess) -> Iterator[Proxy]:
    proxy = Proxy(node.port)
    yield proxy
    proxy.close()


def where(port: int) -> dict[str, Any]:
    return {"tcp_node_address": "127.0.0.1", "tcp_node_port": port}


def test_actions_files_state_levels_and_reset(node: ProtobufProcess, tmp_path: Path) -> None:
    async def scenario(here: Bench) -> None:
        server = await here.adapter("tcp_node", DESCRIPTION, **where(node.port))
        await here.idle()
        await here.start("a1", "shake", speed=300, label="everyday")
        done = await here.outcome("a1")
        assert (done.succeeded, done.effects, done.result) == (True, "all", {"turns": 60.0})
        assert (await here.start("a1", "shake", speed=300, label="everyday")).outcome == done
        await here.start("a2", "run", {"p.yaml": b"steps: 3"}, protocol="p.yaml")
        kept = (await here.outcome("a2")).result["files"]["log"]
        assert here.blobs.get(kept["sha256"]) == b"all well"
        assert node.truth("text")[-1]["text"] == "steps: 3"
        await here.start("a3", "jam")
        failed = await here.outcome("a3")
        assert (failed.succeeded, failed.effects) == (False, "unknown")
        assert "The plate is stuck." in failed.error
        assert (await here.kernel.recover("a4")).succeeded
        await here.idle()
        assert (await here.kernel.admin("observe")).result == {"speed": 0}
        assert await server.node.resources() == {"oil": 12.5}
        assert "there is no stop" in (await here.kernel.admin("stop")).why
        assert len(node.truth("shake", label="everyday")) == 1

    run(tmp_path, scenario)


def test_the_shipped_schema_is_what_protoc_makes_of_the_text(tmp_path: Path) -> None:
    made = tmp_path / "made.binpb"
    command = ["-m", "grpc_tools.protoc", f"-I{PROTO.parent}", f"--descriptor_set_out={made}", PROTO.name]
    subprocess.run([python_of("protobuf"), *command], check=True, timeout=60)
    assert made.read_bytes() == SCHEMA.read_bytes()


@pytest.mark.full
def test_it_says_what_it_offers(node: ProtobufProcess) -> None:
    said = labos("node", "about", "tcp_node", f"127.0.0.1:{node.port}")
    assert said.returncode == 0, said.stderr
    assert yaml.safe_load(said.stdout)["config"] == where(node.port)
    (shake,) = asyncio.run(describe_foreign("tcp_node", where(node.port))).actions
    assert (shake.description, shake.result) == ("Shake the plate.", "any")
    assert [(arg.name, arg.type, arg.default) for arg in shake.args] == [
        ("speed", "int", None),
        ("time_s", "float", 0.2),
    ]


@pytest.mark.full
@pytest.mark.parametrize("early", [False, True], ids=["answer lost", "line cut"])
def test_a_lost_answer_is_asked_for_by_id(
    node: ProtobufProcess, proxy: Proxy, tmp_path: Path, early: bool
) -> None:
    label = f"lost {early}"

    async def scenario(here: Bench) -> None:
        await here.adapter("tcp_node", DESCRIPTION, **where(proxy.port))
        await here.idle()
        proxy.lose_next(b"shake", early=early)
        await here.start("a11" if early else "a12", "shake", speed=2, time_s=1.0, label=label)
        assert (await here.outcome("a11" if early else "a12")).result == {"turns": 2.0}
        assert proxy.lost == 1
        assert len(node.truth("shake", label=label)) == 1

    run(tmp_path, scenario)


@pytest.mark.full
@pytest.mark.parametrize("forgetful", [False, True], ids=["it keeps a record", "it keeps none"])
def test_the_node_is_killed_in_mid_action(tmp_path: Path, forgetful: bool) -> None:
    node = ProtobufProcess("protobuf", tmp_path / "node", free_port())
    node.forgetful = forgetful
    node.start()

    async def scenario(here: Bench) -> None:
        await here.adapter("tcp_node", DESCRIPTION, **{**where(node.port), "patience_s": 60.0})
        await here.idle()
        await here.start("a1", "shake", speed=5, time_s=30.0, label="died")
        await until(lambda: len(node.truth("shake", label="died")) == 1, 20)
        node.kill()
        node.start()
        assert "does not know the action" in (await here.status("a1", "interrupted")).why
        await here.idle()
        assert (await here.start("a1", "shake", speed=5, time_s=30.0, label="died")).status == "interrupted"
        await here.start("a2", "shake", speed=6, time_s=0.0, label="died")
        assert (await here.outcome("a2")).succeeded
        assert [told["speed"] for told in node.truth("shake", label="died")] == [5, 6]

    try:
        run(tmp_path, scenario)
    finally:
        node.kill()


@pytest.mark.full
def test_a_node_that_answers_at_the_end_is_waited_for_while_it_works(tmp_path: Path) -> None:
    node = ProtobufProcess("protobuf", tmp_path / "node", free_port())
    node.forgetful = True
    node.start()

    async def scenario(here: Bench) -> None:
        await here.adapter("tcp_node", DESCRIPTION, **{**where(node.port), "patience_s": 0.5})
        await here.idle()
        await here.start("a1", "shake", speed=5, time_s=4.0, label="long")
        assert (await here.outcome("a1")).result == {"turns": 20.0}

    try:
        run(tmp_path, scenario)
    finally:
        node.kill()


@pytest.mark.full
def test_the_adapter_is_killed_in_mid_action(node: ProtobufProcess, tmp_path: Path) -> None:
    async def scenario(here: Bench) -> None:
        config = {**where(node.port), "patience_s": 20.0}
        first = await here.process("tcp_node", DESCRIPTION, **config)
        await here.idle()
        await here.start("a21", "shake", speed=4, time_s=6.0, label="killed")
        await until(lambda: len(node.truth("shake", label="killed")) == 1, 20)
        first.kill()
        await here.await_node_gone()
        await here.process("tcp_node", DESCRIPTION, **config)
        assert (await here.outcome("a21", 40)).result == {"turns": 24.0}
        assert len(node.truth("shake", label="killed")) == 1

    run(tmp_path, scenario)


@pytest.mark.full
def test_what_is_no_message_is_an_error_and_moves_nothing(tmp_path: Path) -> None:
    """A server that speaks something else, here HTTP."""
    told: list[bytes] = []

    async def answer(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        told.append(await reader.read(100))
        writer.write(b"HTTP/1.1 400 Bad Request\r\n\r\n")
        writer.close()

    async def scenario(here: Bench) -> None:
        async with await asyncio.start_server(answer, "127.0.0.1", 0) as server:
            await here.adapter("tcp_node", DESCRIPTION, **where(server.sockets[0].getsockname()[1]))
            await here.in_error("no answer came")

    run(tmp_path, scenario)
    assert told

"""The adapter of WEI's TCP nodes. WEI ships no such node, only the client of its own; the node of these
tests is a real TCP server with its own truth, and WEI's client drives it too."""

from __future__ import annotations

import json
import socketserver
import subprocess
import threading
import time
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from labos.core.model import ActionSpec, Arg, Description
from tests.integration.adapter.bench import Bench
from tests.integration.adapter.scenario import play
from tests.support.foreign import python_of
from tests.support.proxy import Proxy

run = partial(play, limit_s=60.0)
DESCRIPTION = Description(
    driver="wei_tcp_node",
    version="",
    description="",
    actions=(ActionSpec(name="measure", args=(Arg(name="assay", type="str"),)),),
)

WEI_CLIENT = """
import sys
from types import SimpleNamespace as Table
from wei.core.interfaces.tcp_interface import TcpInterface
module = Table(config={"tcp_node_address": "127.0.0.1", "tcp_node_port": int(sys.argv[1])})
print(*TcpInterface.send_action(Table(action="measure", args={"assay": "by WEI"}), module))
"""


class Reader(socketserver.ThreadingTCPServer):
    """A plate reader that WEI's client can drive."""

    daemon_threads = True

    def __init__(self) -> None:
        self.measured: list[str] = []
        self.pieces = 1
        super().__init__(("127.0.0.1", 0), _Handler)
        threading.Thread(target=self.serve_forever, daemon=True).start()

    @property
    def port(self) -> int:
        return int(self.server_address[1])


class _Handler(socketserver.BaseRequestHandler):
    server: Reader

    def handle(self) -> None:
        data = b""
        while piece := self.request.recv(65536):
            data += piece
            try:
                told = json.loads(data)
            except ValueError:
                continue
            answer = json.dumps(self._act(told["action_handle"], told["action_vars"])).encode()
            step = max(1, len(answer) // self.server.pieces)
            for start in range(0, len(answer), step):
                self.request.sendall(answer[start : start + step])
                time.sleep(0.01)
            return

    def _act(self, handle: str, told: dict[str, Any]) -> dict[str, Any]:
        if told["assay"] == "jam":
            return {"action_response": "failed", "action_msg": "", "action_log": "The drawer is stuck."}
        self.server.measured.append(told["assay"])
        return {"action_response": "succeeded", "action_msg": f"/data/{told['assay']}.csv", "action_log": ""}


@pytest.fixture
def reader() -> Iterator[Reader]:
    with Reader() as device:
        yield device
        device.shutdown()


def test_measures_fails_and_loses_an_answer(reader: Reader, tmp_path: Path) -> None:
    proxy = Proxy(reader.port)
    reader.pieces = 3

    async def scenario(here: Bench) -> None:
        config = {"tcp_node_address": "127.0.0.1", "tcp_node_port": proxy.port}
        await here.adapter("wei_tcp_node", DESCRIPTION, **config)
        await here.idle()
        await here.start("a1", "measure", assay="blue")
        assert (await here.outcome("a1")).result == "/data/blue.csv"
        proxy.lose_next(b"measure")
        await here.start("a2", "measure", assay="lost")
        assert "line was" in (await here.status("a2", "interrupted")).why
        assert (await here.start("a2", "measure", assay="lost")).status == "interrupted"
        await here.idle()
        await here.start("a3", "measure", assay="jam")
        failed = await here.outcome("a3")
        assert (failed.succeeded, failed.effects) == (False, "unknown")
        assert "The drawer is stuck." in failed.error
        assert reader.measured == ["blue", "lost"]
        assert (await here.kernel.recover("a4")).succeeded
        proxy.close()
        await here.in_error("does not answer")

    run(tmp_path, scenario)


@pytest.mark.full
def test_weis_own_client_drives_the_same_node(reader: Reader) -> None:
    python = python_of("wei")
    done = subprocess.run(
        [python, "-c", WEI_CLIENT, str(reader.port)], capture_output=True, text=True, timeout=60, check=False
    )
    assert done.stdout.splitlines()[-1].strip() == "succeeded /data/by WEI.csv", done.stderr
    assert reader.measured == ["by WEI"]

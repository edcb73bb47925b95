"""A node's metrics over real HTTP: what it has done, how it is, and an address that is taken."""

from __future__ import annotations

import asyncio
import socket
from collections.abc import Iterator

import httpx
import pytest

from labos.errors import BadInput
from labos.node.protocol import NodeStatus, Outcome, StateReport
from labos.telemetry.node import MetricsServer, NodeMetrics
from tests.support.prometheus import promtool
from tests.unit.telemetry.test_series import read


@pytest.fixture
def shown() -> Iterator[MetricsServer]:
    server = MetricsServer(NodeMetrics("sealer", "1", simulated=True), "127.0.0.1", 0)
    yield server
    server.close()


class Sealer:
    """A node that is what it is told."""

    status: NodeStatus = "BUSY"

    def state(self) -> StateReport:
        return StateReport(status=self.status, journal="j", instance="i", running=["A1"])


def test_actions_and_states_are_shown(shown: MetricsServer) -> None:
    def ask() -> str:
        return httpx.get(f"http://{shown.address}/metrics", headers={"accept": "text/plain"}).text

    async def body() -> str:
        shown.metrics.watch(Sealer().state, asyncio.get_running_loop())
        return await asyncio.to_thread(ask)

    shown.metrics.on_end("seal", Outcome(True, "all", started_ns=10**9, ended_ns=5 * 10**9))
    shown.metrics.on_end("seal", Outcome(False, "none", error="jam"))
    shown.metrics.on_end("seal", None)
    text = asyncio.run(body())
    found = read(text)
    for outcome in ("succeeded", "failed", "unknown"):
        assert found["labos_node_actions_total", (("action", "seal"), ("outcome", outcome))] == 1
    assert found["labos_node_action_duration_seconds_sum", (("action", "seal"),)] == 4.0
    assert found["labos_node_state", (("state", "busy"),)] == 1
    assert found["labos_node_state", (("state", "idle"),)] == 0
    assert found["labos_node_actions_running", ()] == 1
    assert promtool("check", "metrics", given=text) == ""
    # Its loop is gone: it shows what it said last.
    assert read(ask())["labos_node_state", (("state", "busy"),)] == 1


def test_an_address_that_is_taken_is_named() -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        with pytest.raises(BadInput, match=f"127.0.0.1:{port} for metrics cannot be used"):
            MetricsServer(NodeMetrics("sealer", "1", simulated=True), "127.0.0.1", port)

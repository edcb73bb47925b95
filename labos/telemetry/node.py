"""The metrics of a node's process, and the small server at which Prometheus asks for them.

They have no labels of the module: the collector knows which module it asks.
"""

from __future__ import annotations

import asyncio
import contextlib
import platform
import socket
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from typing import Protocol

from prometheus_client import (
    CollectorRegistry,
    Metric,
    PlatformCollector,
    ProcessCollector,
    start_http_server,
)

from labos.errors import BadInput
from labos.node.protocol import Outcome, StateReport
from labos.telemetry.series import (
    ACTION_BOUNDS_S,
    CounterMetric,
    Distribution,
    GaugeMetric,
    MetricGroup,
    MetricRegistry,
)
from labos.version import VERSION

NODE_STATES = ("IDLE", "BUSY", "ERROR")
PATIENCE_S = 2.0
"""So long the node may take to say how it is; a node that says nothing shows what it said last."""

ACTIONS = 200
"""So many actions of a driver have series of their own."""


class AnsweringNode(Protocol):
    """A node that can be asked how it is."""

    def state(self) -> StateReport: ...


class NodeMetrics(MetricGroup):
    """``on_end`` is told by the node's server; how the node is, ``watch`` says where to ask."""

    def __init__(self, driver: str, version: str, *, simulated: bool) -> None:
        self.info = GaugeMetric(
            "labos_node_info",
            "1; the labels identify the driver. bench is real or simulated.",
            ("driver", "version", "bench", "labos", "python"),
        )
        self.state = GaugeMetric(
            "labos_node_state",
            f"1 for the state that the node is in, 0 for the others: {', '.join(NODE_STATES).lower()}.",
            ("state",),
        )
        self.running = GaugeMetric("labos_node_actions_running", "Actions that the device is carrying out.")
        self.unacknowledged = GaugeMetric(
            "labos_node_actions_unacknowledged",
            "Ended actions whose end the lab's log has not acknowledged yet.",
        )
        self.actions = CounterMetric(
            "labos_node_actions_total",
            "Actions that have ended on the node; outcome is succeeded, failed or unknown.",
            ("action", "outcome"),
            most=3 * ACTIONS,
        )
        self.action_s = Distribution(
            "labos_node_action_duration_seconds",
            "Time that the device took for an action.",
            ("action",),
            bounds=ACTION_BOUNDS_S,
            most=ACTIONS,
        )
        bench = "simulated" if simulated else "real"
        self.info.set(1, (driver, version, bench, VERSION, platform.python_version()))
        self.registry = MetricRegistry(self.families)
        self._ask: Callable[[], StateReport] | None = None

    def watch(self, node: AnsweringNode, loop: asyncio.AbstractEventLoop) -> None:
        """Ask this node how it is, in the loop that it lives in."""

        def ask() -> StateReport:
            told: Future[StateReport] = Future()
            loop.call_soon_threadsafe(lambda: told.set_result(node.state()))  # RuntimeError if it is closed
            return told.result(PATIENCE_S)

        self._ask = ask

    def on_end(self, action: str, outcome: Outcome | None) -> None:
        """An action has ended, with None where nobody knows how."""
        if outcome is None:
            self.actions.add((action, "unknown"))
            return
        self.actions.add((action, "succeeded" if outcome.succeeded else "failed"))
        if outcome.started_ns:
            self.action_s.observe((outcome.ended_ns - outcome.started_ns) / 1e9, (action,))

    def collect(self) -> Iterator[Metric]:
        """What ``prometheus_client`` asks for."""
        if self._ask is not None:
            with contextlib.suppress(TimeoutError, RuntimeError):
                self._update(self._ask())
        yield from self.registry.collect()

    def _update(self, now: StateReport) -> None:
        self.state.replace({(name.lower(),): float(name == now.status) for name in NODE_STATES})
        self.running.set(len(now.running))
        self.unacknowledged.set(len(now.finished) + len(now.interrupted))


class MetricsServer:
    """Serves a node's metrics in a thread of its own, as long as the process lives or until ``close``."""

    def __init__(self, metrics: NodeMetrics, host: str, port: int) -> None:
        """``port`` 0 is a free one. Raises BadInput if the address cannot be used."""
        self.metrics = metrics
        registry = CollectorRegistry()
        registry.register(metrics)
        ProcessCollector(registry=registry)
        PlatformCollector(registry=registry)
        try:
            self._server, self._thread = start_http_server(port, host, registry)
        except OSError as error:
            raise BadInput(
                f"The address {host}:{port} for metrics cannot be used: {error.strerror or error}.",
                remedy="Stop the other process, or choose another port with --metrics-port.",
            ) from None
        everywhere = host in ("0.0.0.0", "::", "")
        self.address = f"{socket.gethostname() if everywhere else host}:{self._server.server_port}"

    def close(self) -> None:
        self._server.shutdown()
        self._server.server_close()
        self._thread.join()

"""The metrics of a node's process, and the small server for Prometheus. They have no labels for the module,
because each node has its own address.
"""

from __future__ import annotations

import asyncio
import contextlib
import platform
import socket
from collections.abc import Callable, Iterator
from concurrent.futures import Future

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
"""The longest time to wait for the node's state; without an answer, the previous state is shown."""

ACTIONS = 200
"""The number of a driver's actions with their own series."""


class NodeMetrics(MetricGroup):
    """The node's server calls ``on_end``; ``watch`` says how to ask it for its state."""

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

    def watch(self, state: Callable[[], StateReport], loop: asyncio.AbstractEventLoop) -> None:
        """Ask the node for its ``state``, in its own event loop."""

        def ask() -> StateReport:
            answer: Future[StateReport] = Future()
            loop.call_soon_threadsafe(lambda: answer.set_result(state()))  # RuntimeError if it is closed
            return answer.result(PATIENCE_S)

        self._ask = ask

    def on_end(self, action: str, outcome: Outcome | None) -> None:
        """An action has ended; None: its outcome is unknown."""
        if outcome is None:
            self.actions.add((action, "unknown"))
            return
        self.actions.add((action, "succeeded" if outcome.succeeded else "failed"))
        if outcome.started_ns:
            self.action_s.observe((outcome.ended_ns - outcome.started_ns) / 1e9, (action,))

    def collect(self) -> Iterator[Metric]:
        """The metrics in the form for ``prometheus_client``."""
        if self._ask is not None:
            with contextlib.suppress(TimeoutError, RuntimeError):
                self._update(self._ask())
        yield from self.registry.collect()

    def _update(self, now: StateReport) -> None:
        self.state.replace({(name.lower(),): float(name == now.status) for name in NODE_STATES})
        self.running.set(len(now.running))
        self.unacknowledged.set(len(now.finished) + len(now.interrupted))


class MetricsServer:
    """Serves a node's metrics in its own thread, until ``close`` or the end of the process."""

    def __init__(self, metrics: NodeMetrics, host: str, port: int) -> None:
        """``port`` 0: any free port. Raises BadInput if the address cannot be used."""
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

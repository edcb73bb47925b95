"""The metrics of an API process."""

from __future__ import annotations

import msgspec

from labos.telemetry.process_metrics import describe_process
from labos.telemetry.series import ComputedCounter, GaugeMetric, MetricGroup, MetricRegistry
from labos.telemetry.signing import Signing


class ApiReadings(msgspec.Struct, frozen=True):
    """The state of an API process. ``here``, ``by_kernel`` and ``away`` count requests: answered here,
    answered by the kernel, and not answered because the kernel was away. ``kernel_s`` is the total time that
    the kernel took."""

    lab: str
    name: str
    process: str
    position: int
    recorded_at: float
    kernel_there: bool
    here: int
    by_kernel: int
    away: int
    kernel_s: float


class ApiMetrics:
    """Updated at each scrape."""

    def __init__(self) -> None:
        self.of_process = _ApiGroup()
        self.signing = Signing()
        self.registry = MetricRegistry([*self.of_process.families, *self.signing.families])

    def text(self, now: ApiReadings) -> str:
        """Everything, in Prometheus' text format."""
        self.of_process.update(now)
        return self.registry.text() + describe_process()


class _ApiGroup(MetricGroup):
    def __init__(self) -> None:
        self.info = GaugeMetric(
            "labos_api_info",
            "1; the labels identify the lab and the API process.",
            ("id", "name", "api"),
        )
        self.position = GaugeMetric(
            "labos_api_log_position", "The last position of the log that this API process knows."
        )
        self.recorded_at = GaugeMetric(
            "labos_api_log_time_seconds", "The time of that event (UNIX time, by the clock of the kernel)."
        )
        self.kernel_there = GaugeMetric(
            "labos_api_kernel_available", "1 while the kernel answers this API process, else 0."
        )
        self.requests = ComputedCounter(
            "labos_api_requests_total",
            "Requests of users to this API process; answered_by is api, kernel, or nobody while the kernel "
            "is away.",
            ("answered_by",),
        )
        self.kernel_s = ComputedCounter(
            "labos_api_kernel_seconds_total", "Time that the kernel took for the requests that it answered."
        )

    def update(self, now: ApiReadings) -> None:
        self.info.set(1, (now.lab, now.name, now.process))
        self.take(now)
        self.requests.set(now.here, ("api",))
        self.requests.set(now.by_kernel, ("kernel",))
        self.requests.set(now.away, ("nobody",))

"""The metrics of an API process."""

from __future__ import annotations

from labos.telemetry.process_metrics import Signing, describe_process
from labos.telemetry.series import ComputedCounter, GaugeMetric, MetricGroup, MetricRegistry


class ApiMetrics(MetricGroup):
    """The metrics of the process itself, and those of signing in; updated at each scrape."""

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
        self.signing = Signing()
        self.registry = MetricRegistry([*self.families, *self.signing.families])

    def text(self) -> str:
        """Everything, in Prometheus' text format."""
        return self.registry.text() + describe_process()

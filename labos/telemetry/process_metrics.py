"""Metrics of kernel, log, store, bus and disk, from given readings; and those of signing in."""

from __future__ import annotations

import platform
from collections.abc import Callable
from functools import cache

from prometheus_client import CollectorRegistry, PlatformCollector, ProcessCollector, generate_latest

from labos.telemetry.series import ComputedCounter, CounterMetric, GaugeMetric, MetricGroup
from labos.version import VERSION


@cache
def _make_collectors() -> CollectorRegistry:
    registry = CollectorRegistry()
    ProcessCollector(registry=registry)
    PlatformCollector(registry=registry)
    return registry


def describe_process() -> str:
    """The system's metrics of this process, in Prometheus' text format."""
    return generate_latest(_make_collectors()).decode()


_GAUGES = {
    "pace": ("labos_lab_pace_ratio", "The speed-up factor of simulated instruments; 1 in a real lab."),
    "epoch": ("labos_kernel_epoch", "The kernel's epoch: one more at each start."),
    "started_at": ("labos_kernel_start_time_seconds", "The start of this kernel (UNIX time)."),
    "suspended": (
        "labos_kernel_suspended",
        "1 while nothing starts because planning fails: a fault of LabOS.",
    ),
    "available": ("labos_log_available", "0 while the log cannot be written and is being read again."),
    "durable": ("labos_log_position", "The position of the last event on disk."),
    "unwritten": ("labos_log_unwritten_events", "Events that are decided but not yet on disk."),
    "checked": ("labos_log_checked_events", "Events whose chain was checked since the kernel started."),
    "damaged": ("labos_log_damaged", "1 if the check of the log has found damage."),
    "store_bytes": ("labos_store_size_bytes", "Size of the database's files (SQLite only)."),
    "disk_free": ("labos_disk_free_bytes", "Free room on the disk of the lab's folder."),
    "disk_size": ("labos_disk_size_bytes", "Size of the disk of the lab's folder."),
}
_COUNTERS = {
    "queries": ("labos_bus_queries_total", "Queries that the kernel has sent on the bus."),
    "unanswered": ("labos_bus_queries_unanswered_total", "Queries on the bus without an answer."),
    "published": ("labos_bus_publications_total", "Messages that the kernel has published on the bus."),
    "dropped": (
        "labos_bus_dropped_total",
        "Messages that were dropped because too many waited to be handled.",
    ),
    "left_out": (
        "labos_bus_announcements_left_out_total",
        "Events that were not announced on the bus because it was too slow; they are in the log.",
    ),
    "spans": ("labos_trace_spans_total", "Spans of traces that were made for an OpenTelemetry receiver."),
    "spans_sent": ("labos_trace_spans_sent_total", "Spans of traces that the receiver has accepted."),
    "faults": (
        "labos_kernel_faults_total",
        "Turns of the kernel that failed and were taken back, and other faults of LabOS.",
    ),
}
"""The metrics that show a reading, by its name."""


class ProcessMetrics(MetricGroup):
    """The metrics of a kernel's process that are not about the bench."""

    def __init__(self) -> None:
        self.build = GaugeMetric(
            "labos_build_info", "1; the labels give the versions.", ("version", "python")
        )
        self.lab_info = GaugeMetric(
            "labos_lab_info",
            "1; the labels identify the lab. bench is real or simulated.",
            ("id", "name", "bench"),
        )
        self.show(GaugeMetric, _GAUGES)
        self.show(ComputedCounter, _COUNTERS)
        self.build.set(1, (VERSION, platform.python_version()))

    def update(self, lab: str, name: str, simulated: bool, **readings: float | None) -> None:
        """Take readings of the kernel's process, by the names of the metrics. ``store_bytes`` is None if the
        database cannot report it cheaply."""
        self.lab_info.replace({(lab, name, "simulated" if simulated else "real"): 1.0})
        self.take(available=1, **readings)

    def lose(self) -> None:
        """Record that the log cannot be written; the other metrics keep their values."""
        self.take(available=0)


class Signing(MetricGroup):
    """Accepted and refused sign-ins and requests over HTTP, counted as they happen."""

    def __init__(self) -> None:
        self.tries = CounterMetric(
            "labos_sign_ins_total",
            "Attempts to sign in; outcome is right, wrong or too_many.",
            ("outcome",),
            most=3,
        )
        self.refused = CounterMetric(
            "labos_requests_refused_total",
            "Refused requests; reason is not_signed_in or forbidden.",
            ("reason",),
            most=2,
        )
        for outcome in ("right", "wrong", "too_many"):
            self.tries.begin((outcome,))
        for reason in ("not_signed_in", "forbidden"):
            self.refused.begin((reason,))

    def watch(self, on_try: list[Callable[[str], None]], on_refusal: list[Callable[[str], None]]) -> None:
        """Count the results of the parts that admit users."""
        on_try.append(lambda outcome: self.tries.add((outcome,)))
        on_refusal.append(lambda reason: self.refused.add((reason,)))

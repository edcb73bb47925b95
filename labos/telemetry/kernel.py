"""All metrics of a kernel's process, in one registry."""

from __future__ import annotations

from collections.abc import Callable

from labos.core.state import LabState
from labos.telemetry.event_metrics import EventMetrics
from labos.telemetry.process_metrics import ProcessMetrics, Signing, describe_process
from labos.telemetry.series import BoundedNames, GaugeMetric, MetricRegistry
from labos.telemetry.state_metrics import StateMetrics, UnattendedMetrics

WORKFLOWS, USERS = 50, 100
"""The numbers of workflows and users with their own series; later ones are ``other``."""


class KernelMetrics:
    """The metrics of one kernel. ``of_events`` is a listener of the kernel; the others are updated at each
    scrape."""

    def __init__(self, state: Callable[[], LabState]) -> None:
        workflows, users = BoundedNames(WORKFLOWS), BoundedNames(USERS)
        self.of_events = EventMetrics(state, workflows, users)
        self.of_state = StateMetrics(workflows, users)
        self.of_unattended_time = UnattendedMetrics()
        self.of_process = ProcessMetrics()
        self.signing = Signing()
        self.series = GaugeMetric("labos_metrics_series", "The number of series in the last answer.")
        self.took_s = GaugeMetric(
            "labos_metrics_duration_seconds", "Time that it took to make the last answer."
        )
        groups = (self.of_process, self.of_state, self.of_events, self.of_unattended_time, self.signing)
        families = [family for group in groups for family in group.families]
        self.registry = MetricRegistry([*families, self.series, self.took_s])

    def text(self) -> str:
        """Everything, in Prometheus' text format."""
        text = self.registry.text() + describe_process()
        self.series.set(self.registry.counts)
        return text

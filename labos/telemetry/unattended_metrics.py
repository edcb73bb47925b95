"""Time without human intervention as metrics; ``docs/time-without-human-intervention.md`` defines it."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import TYPE_CHECKING

from labos.telemetry.series import ComputedCounter, GaugeMetric, Labels, MetricGroup

if TYPE_CHECKING:
    from labos.services.twh import Twh


class UnattendedMetrics(MetricGroup):
    """The figures of the lab (scope ``lab``, no workcell) and of each workcell. They exist as soon as the log
    was read from its beginning."""

    def __init__(self) -> None:
        gauge = partial(GaugeMetric, labels=("scope", "workcell"), most=250)
        counter = partial(ComputedCounter, labels=("scope", "workcell"), most=250)
        self.current_s = gauge("labos_twh_current_seconds", "Working time since the last human intervention.")
        self.longest_s = gauge(
            "labos_twh_longest_seconds", "The longest working time without a human intervention so far."
        )
        self.working = gauge(
            "labos_twh_working", "1 while the clock runs: a run is under way and does not wait for a person."
        )
        self.clock_s = counter(
            "labos_twh_clock_seconds_total", "Total working time, with and without people."
        )
        self.planned = counter(
            "labos_planned_touches_total",
            "Planned work of people, which does not end a stretch without intervention.",
        )
        self.interventions = ComputedCounter(
            "labos_human_interventions_total",
            "Interventions that ended a stretch, by cause: the kind of question, or the type of the event "
            "that a person caused.",
            ("cause",),
            most=100,
        )

    def update(self, lab: Twh, workcells: Mapping[str, Twh], causes: Mapping[str, int]) -> None:
        """Take the figures of all scopes at one moment."""
        scopes: dict[Labels, Twh] = {("lab", ""): lab}
        scopes.update({("workcell", name): twh for name, twh in workcells.items()})
        self.current_s.replace({key: twh.current.worked_ns / 1e9 for key, twh in scopes.items()})
        self.longest_s.replace({key: twh.longest.worked_ns / 1e9 for key, twh in scopes.items()})
        self.working.replace({key: float(twh.working) for key, twh in scopes.items()})
        self.clock_s.replace({key: twh.clock_ns / 1e9 for key, twh in scopes.items()})
        self.planned.replace({key: float(twh.planned) for key, twh in scopes.items()})
        self.interventions.replace({(cause,): float(count) for cause, count in causes.items()})

"""Accepted and refused sign-ins and requests over HTTP."""

from __future__ import annotations

from collections.abc import Callable

from labos.telemetry.series import CounterMetric, MetricGroup


class Signing(MetricGroup):
    """Counted as it happens."""

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

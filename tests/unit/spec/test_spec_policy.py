"""Policy files: what holds for whoever is no operator."""

from __future__ import annotations

import pytest

from labos.core.policy import BookingLimits
from labos.errors import LabosError
from labos.spec.policy import parse_policy


@pytest.mark.parametrize(
    ("said", "meant"),
    [
        ("", BookingLimits()),
        ("bookings: {}", BookingLimits(None, 24.0, 14)),
        ("bookings: {hours: 12, days_ahead: 30}", BookingLimits(12.0, 24.0, 30)),
        ("bookings: {hours: 36}", BookingLimits(36.0, 36.0, 14)),
        ("bookings: {hours: 0.5, total_hours: 4}", BookingLimits(0.5, 4.0, 14)),
        ("bookings: {total_hours: 100}", BookingLimits(None, 100.0, 14)),
    ],
)
def test_limits_of_bookings(said: str, meant: BookingLimits) -> None:
    assert parse_policy(f"labos: 1\n{said}\n").policy.bookings == meant


@pytest.mark.parametrize(
    ("said", "wrong"),
    [
        ("{hours: 0}", "bookings.hours"),
        ("{hours: -1}", "bookings.hours"),
        ("{hours: .nan}", "not a finite number"),
        ("{hours: .inf}", "not a finite number"),
        ("{hours: 1e9}", "bookings.hours"),
        ("{hours: many}", "bookings.hours"),
        ("{total_hours: 0}", "bookings.total_hours"),
        ("{days_ahead: 0}", "bookings.days_ahead"),
        ("{days_ahead: 1.5}", "bookings.days_ahead"),
        ("{days_ahead: 1000}", "bookings.days_ahead"),
        ("{hours: 12, total_hours: 8}", "One booking may have 12 hours, but all bookings together only 8"),
        ("{hour: 12}", "hour"),
        ("[12]", "bookings"),
        ("12", "bookings"),
    ],
)
def test_faults_are_told_at_their_place(said: str, wrong: str) -> None:
    with pytest.raises(LabosError) as error:
        parse_policy(f"labos: 1\nbookings: {said}\n", "policy.yaml")
    assert "policy.yaml:2:" in str(error.value)
    assert wrong in str(error.value)

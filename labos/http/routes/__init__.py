"""Every operation of the API, once: its route, its description and its reference page are derived from it."""

from __future__ import annotations

from labos.http.operation import Operation
from labos.http.routes import (
    accounts,
    approvals,
    bench,
    bookings,
    campaigns,
    finding,
    forecasts,
    lab,
    log,
    modules,
    people,
    planning,
    runs,
    signatures,
    words,
)

PREFIX = "/api/v1"

OPERATIONS: tuple[Operation, ...] = (
    *lab.OPERATIONS,
    *accounts.OPERATIONS,
    *log.OPERATIONS,
    *finding.OPERATIONS,
    *words.OPERATIONS,
    *forecasts.OPERATIONS,  # before runs: /runs/forecast is not a run
    *planning.OPERATIONS,  # before runs: /runs/check is not a run
    *runs.OPERATIONS,
    *campaigns.OPERATIONS,
    *signatures.OPERATIONS,
    *approvals.OPERATIONS,
    *modules.OPERATIONS,
    *bookings.OPERATIONS,
    *bench.OPERATIONS,
    *people.OPERATIONS,
)

__all__ = ["OPERATIONS", "PREFIX"]

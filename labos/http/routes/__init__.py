"""Every operation of the API, once: its routes, its description and its reference page are made from this."""

from __future__ import annotations

from labos.http.operation import Operation
from labos.http.routes import accounts, bench, bookings, campaigns, lab, log, modules, people, runs

PREFIX = "/api/v1"

OPERATIONS: tuple[Operation, ...] = (
    *lab.OPERATIONS,
    *accounts.OPERATIONS,
    *log.OPERATIONS,
    *runs.OPERATIONS,
    *campaigns.OPERATIONS,
    *modules.OPERATIONS,
    *bookings.OPERATIONS,
    *bench.OPERATIONS,
    *people.OPERATIONS,
)

__all__ = ["OPERATIONS", "PREFIX"]

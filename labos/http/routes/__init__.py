"""Every operation of the API, once: its route, its description and its reference page are derived from it."""

from __future__ import annotations

from types import ModuleType

import msgspec

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

HEADINGS: dict[ModuleType, str] = {
    lab: "lab",
    accounts: "accounts",
    log: "log",
    finding: "log",
    words: "log",
    forecasts: "runs",  # before runs: /runs/forecast is not a run
    planning: "workcells",  # before runs: /runs/check is not a run
    runs: "runs",
    campaigns: "campaigns",
    signatures: "runs",
    approvals: "approvals",
    modules: "modules",
    bookings: "bookings",
    bench: "bench",
    people: "people",
}
"""The modules with operations, in the order of the routes; each with the heading for those that name none."""


def list_operations(module: ModuleType) -> list[Operation]:
    """The operations of a module, in its order."""
    found = (each for each in vars(module).values() if isinstance(each, Operation))
    return [msgspec.structs.replace(each, tag=each.tag or HEADINGS[module]) for each in found]


OPERATIONS = tuple(each for module in HEADINGS for each in list_operations(module))

"""The operations of the API as methods of the client: written by tests/docs/client_code.py."""

from __future__ import annotations

from labos.client._generated.accounts import GeneratedAccounts
from labos.client._generated.approvals import GeneratedApprovals
from labos.client._generated.bench import GeneratedBench
from labos.client._generated.bookings import GeneratedBookings
from labos.client._generated.campaigns import GeneratedCampaigns
from labos.client._generated.finding import GeneratedFinding
from labos.client._generated.forecasts import GeneratedForecasts
from labos.client._generated.lab import GeneratedLab
from labos.client._generated.modules import GeneratedModules
from labos.client._generated.people import GeneratedPeople
from labos.client._generated.planning import GeneratedPlanning
from labos.client._generated.runs import GeneratedRuns
from labos.client._generated.signatures import GeneratedSignatures
from labos.client._generated.words import GeneratedWords


class GeneratedCalls(
    GeneratedLab,
    GeneratedAccounts,
    GeneratedFinding,
    GeneratedForecasts,
    GeneratedPlanning,
    GeneratedRuns,
    GeneratedSignatures,
    GeneratedCampaigns,
    GeneratedApprovals,
    GeneratedModules,
    GeneratedBookings,
    GeneratedBench,
    GeneratedPeople,
    GeneratedWords,
):
    """One method for each operation."""

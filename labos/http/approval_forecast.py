"""The forecast for a proposal that is approved now."""

from __future__ import annotations

import msgspec

from labos.core.approvals import Proposal
from labos.core.decide.targets import cells_of
from labos.errors import BadInput
from labos.http.campaigns import ConsumableEstimate, find_left
from labos.http.service import LabService
from labos.planning.lab_forecast import LabForecast


class ProposalForecast(msgspec.Struct, frozen=True):
    """The forecast for a proposal: its start and end, the times when a person is needed, the runs that it
    delays, the obstacles, and for each consumable the amount that its plan needs and the amount that is
    left."""

    forecast: LabForecast
    consumables: dict[str, ConsumableEstimate]


async def forecast_proposal(service: LabService, proposal: Proposal) -> ProposalForecast:
    """Raises BadInput for an experiment, as its requests are not known in advance; Refused."""
    if proposal.kind == "experiment":
        raise BadInput(
            f"There is no forecast for the experiment {proposal.subject}, because its application decides "
            "during the experiment.",
            remedy="Each of its runs waits for an approval. Check those.",
        )
    (cell,) = cells_of(service.kernel.state, proposal.subject)
    needed = proposal.demand.consumables
    consumables = {
        kind: ConsumableEstimate(amount, find_left(service, cell, kind)) for kind, amount in needed.items()
    }
    return ProposalForecast(await service.forecasts.forecast_proposal(proposal.subject), consumables)

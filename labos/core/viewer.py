"""Who looks at campaigns that not everybody sees, and which of them they see."""

from __future__ import annotations

from typing import Literal

import msgspec

Visibility = Literal["lab", "group", "private"]
"""Who sees a campaign, besides its user and the operators of its workcell: everybody, the user's group, or
nobody."""


class RestrictedCampaign(msgspec.Struct, frozen=True):
    """Whose a campaign is that not everybody sees, and who does."""

    user: str
    workcell: str
    visibility: Visibility


class Viewer(msgspec.Struct, frozen=True):
    """Somebody who looks at campaigns, and sees those of their own (``person``), those that groups see of
    ``peers``, and all in the workcells ``cells``."""

    person: str
    peers: tuple[str, ...] = ()
    cells: tuple[str, ...] = ()

    def sees(self, campaign: RestrictedCampaign) -> bool:
        return (
            campaign.user == self.person
            or campaign.workcell in self.cells
            or (campaign.visibility == "group" and campaign.user in self.peers)
        )

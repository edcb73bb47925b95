"""A user who reads campaigns with restricted visibility, and which of them this user can see."""

from __future__ import annotations

from typing import Literal

import msgspec

Visibility = Literal["lab", "group", "private"]
"""The users who can see a campaign, besides its user and the operators of its workcell: everybody, the user's
group, or nobody."""


class RestrictedCampaign(msgspec.Struct, frozen=True):
    """The user of a campaign with restricted visibility, and who can see it."""

    user: str
    workcell: str
    visibility: Visibility


class Viewer(msgspec.Struct, frozen=True):
    """A user who reads campaigns. The user can see their own campaigns (``person``), group campaigns of
    ``peers``, and all campaigns in the workcells ``cells``."""

    person: str
    peers: tuple[str, ...] = ()
    cells: tuple[str, ...] = ()

    def sees(self, campaign: RestrictedCampaign) -> bool:
        return (
            campaign.user == self.person
            or campaign.workcell in self.cells
            or (campaign.visibility == "group" and campaign.user in self.peers)
        )

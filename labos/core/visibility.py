"""Who sees a campaign that is not shown to everybody.

Its user sees it, the operators of its workcell do, who have to look after its runs, and where it says so the
members of its user's group. In a lab without users everybody sees everything.
"""

from __future__ import annotations

from labos.core.ids import CampaignId
from labos.core.lab import WHOLE_LAB
from labos.core.roles import rank_role_in
from labos.core.state import LabState
from labos.core.users import LABOS, find_person, rank
from labos.core.viewer import Viewer


def find_viewer(state: LabState, actor: str) -> Viewer | None:
    """What a user (or a service account for one) sees; None if they see everything."""
    if state.users.is_open or actor == LABOS:
        return None
    person, needed = find_person(actor), rank("operator")
    if rank_role_in(state, person, WHOLE_LAB) >= needed:
        return None
    group = state.shares.group_of.get(person, "")
    peers = (name for name, of in state.shares.group_of.items() if group and of == group)
    cells = (cell for cell in state.lab.workcells if rank_role_in(state, person, cell) >= needed)
    return Viewer(person, tuple(sorted(peers)), tuple(sorted(cells)))


def find_hidden(state: LabState, viewer: Viewer | None) -> frozenset[CampaignId]:
    """The campaigns that somebody does not see."""
    if viewer is None:
        return frozenset()
    restricted = state.campaigns.restricted.items()
    return frozenset(name for name, campaign in restricted if not viewer.sees(campaign))

"""The users who can see a campaign with restricted visibility.

Its user can see it, and so can the operators of its workcell, who take care of its runs. If the visibility is
``group``, the members of the user's group can see it too. In a lab without users, everybody can see
everything.
"""

from __future__ import annotations

from labos.core.ids import CampaignId
from labos.core.lab import WHOLE_LAB
from labos.core.roles import rank_role_in
from labos.core.state import LabState
from labos.core.users import LABOS, find_person, rank
from labos.core.viewer import Viewer


def find_viewer(state: LabState, actor: str) -> Viewer | None:
    """The view of a user (or of a service account for a user); None if they can see everything."""
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
    """The campaigns that a viewer cannot see."""
    if viewer is None:
        return frozenset()
    restricted = state.campaigns.restricted.items()
    return frozenset(name for name, campaign in restricted if not viewer.sees(campaign))

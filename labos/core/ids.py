"""Types for names and ids, so that the type checker does not mix them up."""

from __future__ import annotations

from typing import NewType

LabId = NewType("LabId", str)
RunId = NewType("RunId", str)
ExperimentId = NewType("ExperimentId", str)
CampaignId = NewType("CampaignId", str)
ActionId = NewType("ActionId", str)
LabwareId = NewType("LabwareId", str)
InterventionId = NewType("InterventionId", str)

ModuleName = NewType("ModuleName", str)
"""``workcell/module``: unique in the lab."""

StationName = NewType("StationName", str)
"""``workcell/module.station``: unique in the lab."""

Owner = NewType("Owner", str)
"""``run:<id>``, ``experiment:<id>``, ``user:<name>``, ``shared``, or empty for no owner."""

NOBODY = Owner("")
SHARED = Owner("shared")


def run_owner(run: RunId) -> Owner:
    return Owner(f"run:{run}")


def experiment_owner(experiment: ExperimentId) -> Owner:
    return Owner(f"experiment:{experiment}")


def user_owner(user: str) -> Owner:
    return Owner(f"user:{user}")


def split_owner(owner: str) -> tuple[str, str]:
    """The kind of an owner (``run``, ``experiment``, ``user``, ``shared``, or empty) or of the subject of a
    role (``user``, ``group``), and its id or name."""
    kind, _, name = owner.partition(":")
    return kind, name


def workcell_of(name: ModuleName | StationName) -> str:
    """The workcell in which a module or station stands."""
    return name.partition("/")[0]


def local(name: str) -> str:
    """The name without its workcell."""
    return name.rpartition("/")[2]

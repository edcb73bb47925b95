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


def find_owning_run(owner: str) -> RunId:
    """The run that owns something; empty if no run does."""
    kind, name = split_key(owner)
    return RunId(name if kind == "run" else "")


def module_key(module: ModuleName) -> str:
    return f"module:{module}"


def station_key(station: StationName) -> str:
    return f"station:{station}"


def deck_key(claim: str) -> str:
    """All places of a deck that only one at a time may use."""
    return f"deck:{claim}"


def zone_key(zone: str) -> str:
    return f"zone:{zone}"


def access_key(cell: str) -> str:
    return f"access:{cell}"


def run_key(run: RunId) -> str:
    return f"run:{run}"


def split_key(key: str) -> tuple[str, str]:
    """The kind and the name in an owner (``run``, ``experiment``, ``user``, ``shared``, or empty), in the
    subject of a role (``user``, ``group``) or in the key of something that changes (``module``, ``station``,
    …). Without a colon there is no name."""
    kind, _, name = key.partition(":")
    return kind, name


def level_key(module: ModuleName, resource: str) -> str:
    """The level of what a module uses up."""
    return f"{module}:{resource}"


def split_level_key(key: str) -> tuple[ModuleName, str]:
    """The module and what it uses up."""
    module, _, resource = key.rpartition(":")
    return ModuleName(module), resource


def workcell_of(name: ModuleName | StationName) -> str:
    """The workcell in which a module or station stands."""
    return name.partition("/")[0]


def module_of(station: StationName) -> ModuleName:
    """The module that gives a station its name; empty if none does."""
    return ModuleName(split_place(station)[0])


def split_place(name: str) -> tuple[str, str]:
    """The module in a station's name, and the name that it has there: ``module.station``. Without a point
    there is no module."""
    module, _, station = name.rpartition(".")
    return module, station


def split_written_place(text: str) -> tuple[str, str]:
    """The module with which a written place begins, and the rest: ``module.positions.station``. Without a
    point there is no rest."""
    module, _, rest = text.partition(".")
    return module, rest


def local(name: str) -> str:
    """The name without its workcell."""
    return name.rpartition("/")[2]

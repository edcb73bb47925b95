"""The part of a module's entry about actions that it carries out for several runs at once."""

from __future__ import annotations

from labos.core.effects import Needs, Reads, Requires, Sets
from labos.core.ids import local
from labos.core.model import ActionSpec, Description, StationSpec, Together
from labos.spec.findings import Remarks, suggest_name
from labos.spec.models import ModuleEntry
from labos.spec.source import Path_
from labos.spec.stations import Stations


def read_together(
    entry: ModuleEntry, description: Description, stations: Stations, path: Path_, remarks: Remarks
) -> Together | None:
    """The actions of a module for several runs at once, from its entry; None if there are none. Faults are
    reported."""
    written = entry.together
    if written is None:
        return None
    at = (*path, "together")
    names: list[str] = []
    for index, name in enumerate(written.actions):
        action = description.action(name)
        if action is None:
            known = {each.name: True for each in description.actions}
            remedy = suggest_name(name, known, "action")
            remarks.error(f"{entry.name} has no action {name!r}.", (*at, "actions", index), remedy)
            continue
        fault = _find_fault(action)
        if fault:
            message = f"{name!r} of {entry.name} cannot be done for several runs at once: it {fault}."
            remarks.error(message, (*at, "actions", index), "Leave it out.")
        names.append(action.name)
    own = [place for place in stations.by_name.values() if local(place.module) == entry.name]
    _check_places(entry.name, own, at, remarks)
    return Together(tuple(dict.fromkeys(names)), written.wait)


def _find_fault(action: ActionSpec) -> str:
    """Why an action cannot be done for several runs at once; empty if it can."""
    if action.by_person:
        return "is done by a person"
    if not action.exclusive:
        return "does not occupy the module"
    needs = False
    for effect in action.effects:
        needs = needs or isinstance(effect, Needs)
        if isinstance(effect, Sets) and effect.of != "labware":
            return f"leaves {effect.variable} of the module changed"
        if not isinstance(effect, Needs | Reads | Requires | Sets):
            return f"does more than change labware in its place ({effect.__struct_config__.tag})"
    return "" if needs else "needs no labware"


def _check_places(name: str, own: list[StationSpec], at: Path_, remarks: Remarks) -> None:
    """Check that labware of several runs can be in a module, and that no arm reaches in while it works."""
    if sum(place.capacity for place in own if not place.hotel) < 2:
        remarks.error(f"{name} has no room for labware of several runs.", at, "Leave `together` out.")
    for place in own:
        short = local(place.name)
        if place.claim:
            message = f"Labware at {short} blocks {name} for other runs, so actions cannot be done together."
            remedy = f"Write `{short}: {{independent: true}}` below `stations:`."
            remarks.error(message, at, remedy)
        elif place.stands_apart and not place.hotel:
            message = f"Arms reach into {short} at any time, also while {name} is at work."
            remedy = f"Define what has to be open: `{short}: {{access: {{lid: open}}}}` below `stations:`."
            remarks.error(message, at, remedy)

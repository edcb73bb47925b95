"""Foreign files, converted to LabOS' own form before they are used.

A dialect keeps the places of the data that it moves, so that an error still names the line in the original
file. Data that LabOS does not use gives a warning.
"""

from __future__ import annotations

from typing import Literal

from labos.errors import SpecError
from labos.spec.dialects import _madsci_workcell, _madsci_workflow, opentrons, wei
from labos.spec.dialects.wei import NOBODYS as NOBODYS
from labos.spec.findings import FindingList
from labos.spec.source import Place, Source

Dialect = Literal["labos", "wei", "madsci", "opentrons"]
Kind = Literal["workcell", "workflow", "labware"]

OWN_KEYS = {"stations", "stock", "labware"}
"""Keys that only LabOS' own workcell files have."""

_NO_SPECS = {
    "services": "It looks like a Docker Compose file, which has no information about the bench.",
    "commands": "A protocol file cannot be loaded directly: name it in an argument of a step.",
    "node_name": "A MADSci node file adds nothing to the workcell's settings.yaml.",
    "representation_templates": "MADSci locations are read with the settings.yaml beside them.",
    "location_templates": "MADSci locations are read with the settings.yaml beside them.",
    "workcell_server_url": "These MADSci settings name no nodes: add `workcell_nodes:`.",
    "manager_type": "LabOS reads only the file of MADSci's workcell manager; put `locations:` into it.",
}
"""Keys that show the kind of another file, with a remedy."""


def detect_kind(source: Source) -> tuple[Kind, Dialect]:
    """The kind and the dialect of a file. Raises SpecError for a file of no known kind."""
    found = find_kind(source)
    if found is None:
        raise make_unknown_error(source)
    return found


def find_kind(source: Source) -> tuple[Kind, Dialect] | None:
    """As ``detect_kind``, but None for a file of no known kind. Raises SpecError for unfinished drafts."""
    data = source.data
    own = "labos" in data
    if "labware" in data and "modules" not in data:  # a workcell also names its labware files
        return "labware", "labos"
    if opentrons.is_labware(source):
        return "labware", "opentrons"
    if "actions" in data and "modules" in data and not own:
        raise source.error(
            "Steps under `actions:` are a draft that no version of WEI runs.",
            ("actions",),
            key=True,
            remedy="Write them under `flowdef:` or `steps:`, with module, action and args.",
        )
    if "flowdef" in data:
        return "workflow", "labos" if own else "wei"
    if "steps" in data:
        return "workflow", "madsci" if _madsci_workflow.is_workflow(source) else "labos"
    if _madsci_workcell.is_workcell(source):
        return "workcell", "madsci"
    if "modules" in data:
        return "workcell", "labos" if own or OWN_KEYS & data.keys() else "wei"
    return None


def make_unknown_error(source: Source) -> SpecError:
    """The error for a file of no known kind."""
    keys = ", ".join(f"`{key}`" for key in list(source.data)[:5])
    why = next((why for key, why in _NO_SPECS.items() if key in source.data), "Check which file was meant.")
    return source.error(f"This is neither a workcell, a workflow nor labware; it holds {keys}.", remedy=why)


def convert_workcell(source: Source, report: FindingList) -> tuple[Source, Dialect]:
    """A workcell file in LabOS' own form, and the dialect it was written in. Raises SpecError."""
    data = source.data
    if "labos" in data or OWN_KEYS & data.keys():
        return _check_own(source), "labos"
    _warn_of_doubles(source, report)
    if _madsci_workcell.is_workcell(source):
        return _madsci_workcell.rewrite_workcell(source, report), "madsci"
    return wei.rewrite_workcell(source, report), "wei"


def convert_workflow(source: Source, report: FindingList) -> tuple[Source, Dialect]:
    """A workflow file in LabOS' own form, and the dialect it was written in. Raises SpecError."""
    data = source.data
    if "labos" not in data and "flowdef" in data:
        _warn_of_doubles(source, report)
        return wei.rewrite_workflow(source, report), "wei"
    if _madsci_workflow.is_workflow(source):
        _warn_of_doubles(source, report)
        return _madsci_workflow.rewrite_workflow(source, report), "madsci"
    return _check_own(source), "labos"


def convert_labware(source: Source, report: FindingList) -> tuple[Source, Dialect]:
    """A labware file in LabOS' own form, and the dialect it was written in. Raises SpecError."""
    if opentrons.is_labware(source):
        return opentrons.rewrite_labware(source, report), "opentrons"
    return _check_own(source), "labos"


def _check_own(source: Source) -> Source:
    """Check that LabOS' own files have no key twice."""
    if source.doubles:
        raise source.doubles[0]
    return source


def _warn_of_doubles(source: Source, report: FindingList) -> None:
    """Foreign programs read files with PyYAML, which uses the last one of equal keys."""
    for double in source.doubles:
        report.add_warning(
            f"{double.message} The last one is used, as in the program for which the file was written.",
            Place(double.line, double.column),
            field=double.field,
            remedy="Remove the others.",
        )

"""Reads labware files."""

from __future__ import annotations

from pathlib import Path

from labos.spec.dialects import labware_form
from labos.spec.findings import Report, SpecErrors
from labos.spec.library import find_spec, list_specs
from labos.spec.models import LabwareFile, LabwareType
from labos.spec.source import Source, read
from labos.spec.validation import validate


def load_labware(source: Source | str | Path) -> dict[str, LabwareType]:
    """The labware types of a file, by name. Raises SpecError or SpecErrors."""
    source = source if isinstance(source, Source) else read(source)
    report = Report(source.file)
    form, _ = labware_form(source, report)
    file = validate(LabwareFile, form, report)
    if file is None:
        raise SpecErrors(report.sorted())
    return dict(file.labware)


def packaged_labware() -> dict[str, LabwareType]:
    """The labware types that come with LabOS, by name."""
    found: dict[str, LabwareType] = {}
    for name in list_specs("labware"):
        found |= load_labware(find_spec("labware", name))
    return found

"""Foreign files, rewritten into LabOS' own form before anything else looks at them.

A dialect keeps the places of what it moves, so that an error still names the line in the file
as it was written. What LabOS does not use becomes a warning.
"""

from __future__ import annotations

from typing import Literal

from labos.spec.dialects import wei
from labos.spec.findings import Report
from labos.spec.source import Source

Dialect = Literal["labos", "wei"]


def workcell_form(source: Source, report: Report) -> tuple[Source, Dialect]:
    """A workcell file in LabOS' own form, and the dialect it was written in."""
    data = source.data
    if "labos" in data or "stations" in data or "stock" in data:
        return source, "labos"
    if any(key in data for key in ("workcell_nodes", "nodes", "workcell_directory")):
        raise source.error(
            "This looks like a MADSci workcell, which LabOS does not read yet.",
            remedy="Write the nodes as `modules:` with name, model and config.",
        )
    return wei.workcell(source, report), "wei"


def workflow_form(source: Source, report: Report) -> tuple[Source, Dialect]:
    """A workflow file in LabOS' own form, and the dialect it was written in."""
    data = source.data
    if "labos" in data:
        return source, "labos"
    if "flowdef" in data:
        return wei.workflow(source, report), "wei"
    steps = data.get("steps")
    if isinstance(steps, list) and any(isinstance(step, dict) and "node" in step for step in steps):
        raise source.error(
            "This looks like a MADSci workflow, which LabOS does not read yet.",
            ("steps",),
            remedy="Write `module:` for `node:` and put locations under `args:`.",
        )
    return source, "labos"

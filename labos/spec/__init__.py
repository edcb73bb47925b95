"""Files that describe the lab (workcells, workflows, labware), and the results of compiling them.

Workcell file → ``CompiledWorkcell`` (``load_workcell``); workflow file, payload and workcell → ``Compiled``
(``compile_workflow``). Every fault names file, line, column, field and a remedy.
"""

from labos.spec.bench import BenchFile, Stock, make_default_stock
from labos.spec.durations import parse_duration
from labos.spec.findings import Finding, SpecErrors
from labos.spec.labware import load_labware
from labos.spec.library import find_spec, find_specs_folder, list_specs
from labos.spec.models import LabwareType
from labos.spec.source import Source
from labos.spec.source import parse as parse_source
from labos.spec.source import read as read_source
from labos.spec.stations import Stations, resolve_station
from labos.spec.workcell import (
    CompiledWorkcell,
    compile_workcell,
    load_workcell,
    parse_workcell,
    validate_workcell,
)
from labos.spec.workflow import Compiled, compile_workflow, parse_workflow, read_workflow, validate_workflow

__all__ = [
    "BenchFile",
    "Compiled",
    "CompiledWorkcell",
    "Finding",
    "LabwareType",
    "Source",
    "SpecErrors",
    "Stations",
    "Stock",
    "compile_workcell",
    "compile_workflow",
    "find_spec",
    "find_specs_folder",
    "list_specs",
    "load_labware",
    "load_workcell",
    "make_default_stock",
    "parse_duration",
    "parse_source",
    "parse_workcell",
    "parse_workflow",
    "read_source",
    "read_workflow",
    "resolve_station",
    "validate_workcell",
    "validate_workflow",
]

"""What a robot needs for its deck besides the protocol: labware offsets, and the lab's labware definitions.

The offsets are measured on this robot with Labware Position Check of its App. Without them, its pipettes go
to the nominal position of labware, and not to its real position.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from labos.errors import BadInput

URI = re.compile(r"[\w.-]+/[\w.-]+/\d+")
SLOTS = frozenset(str(number) for number in range(1, 13))
LARGEST_OFFSET_MM = 20.0
LARGEST_DEFINITION = 1024 * 1024
OFFSET_KEYS = frozenset({"labware", "slot", "x", "y", "z"})


def read_offsets(name: str, config: Mapping[str, Any]) -> list[dict[str, Any]]:
    """``labware_offsets:`` of the configuration, in the form for ``POST /runs``. Raises BadInput."""
    configured = config.get("labware_offsets") or []
    if not isinstance(configured, list):
        raise BadInput(f"{name}: `labware_offsets` is not a list.", remedy=_EXAMPLE)
    return [
        _parse_offset(f"{name}: `labware_offsets[{number}]`", entry)
        for number, entry in enumerate(configured)
    ]


def read_definitions(name: str, config: Mapping[str, Any]) -> list[tuple[str, bytes]]:
    """Name and content of each file of ``labware_definitions:``. The entry lists paths of JSON files, or of
    folders of them, on the node's computer. Raises BadInput."""
    configured = config.get("labware_definitions") or []
    paths = [configured] if isinstance(configured, str) else configured
    if not isinstance(paths, list) or not all(isinstance(path, str) for path in paths):
        raise BadInput(f"{name}: `labware_definitions` is not a list of paths.")
    files: dict[str, bytes] = {}
    for path in map(Path, paths):
        for file in sorted(path.glob("*.json")) if path.is_dir() else [path]:
            files[file.name] = _read_definition(name, file)
    return list(files.items())


_EXAMPLE = (
    "Write each as {labware: opentrons/corning_96_wellplate_360ul_flat/2, slot: 1, x: 0.1, y: 0, z: -0.2} "
    "(mm)."
)


def _parse_offset(where: str, entry: Any) -> dict[str, Any]:
    if not isinstance(entry, Mapping) or set(entry) - OFFSET_KEYS or not {"labware", "slot"} <= set(entry):
        raise BadInput(f"{where} is not an offset.", remedy=_EXAMPLE)
    uri, slot = str(entry["labware"]), str(entry["slot"])
    if not URI.fullmatch(uri) or slot not in SLOTS:
        raise BadInput(f"{where}: {uri!r} in slot {slot!r} is not labware in a slot.", remedy=_EXAMPLE)
    vector = {axis: entry.get(axis, 0.0) for axis in "xyz"}
    for axis, value in vector.items():
        if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
            raise BadInput(f"{where}: {axis} is not a number.", remedy=_EXAMPLE)
        if abs(value) > LARGEST_OFFSET_MM:
            raise BadInput(f"{where}: {axis} is {value:g} mm; {LARGEST_OFFSET_MM:g} are allowed.")
    return {"definitionUri": uri, "location": {"slotName": slot}, "vector": vector}


def _read_definition(name: str, file: Path) -> bytes:
    try:
        content = file.read_bytes()
        definition = json.loads(content) if len(content) <= LARGEST_DEFINITION else None
    except (OSError, ValueError, RecursionError) as error:
        raise BadInput(f"{name}: the labware definition {file} cannot be read: {error}.") from error
    if not isinstance(definition, dict) or "wells" not in definition or "parameters" not in definition:
        raise BadInput(
            f"{name}: {file} is not a labware definition.",
            remedy="Use the JSON file of Opentrons' Labware Creator (schema version 2).",
        )
    return content

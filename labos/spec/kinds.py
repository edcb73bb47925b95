"""The labware types that a workcell file names, and whether they have descriptions."""

from __future__ import annotations

from collections.abc import Collection, Iterator

from labos.core.bench import split_item
from labos.spec.findings import Remarks, suggest_similar
from labos.spec.models import ANY, WorkcellFile
from labos.spec.source import Path_


def warn_of_unknown(file: WorkcellFile, known: Collection[str], remarks: Remarks) -> None:
    """A type without a description can be used, but may be a typing error: a warning is given once, at its
    first place."""
    seen = {*known, ""}
    for kind, path, key in _list_named(file):
        if kind not in seen:
            seen.add(kind)
            remedy = "Describe it in a labware file, and name that under `labware:`."
            if meant := suggest_similar(kind, known):
                remedy = f"{meant} Else describe it in a labware file that `labware:` names."
            message = f"Nobody describes the labware type {kind!r}: its wells and grips are not checked."
            remarks.add_warning(message, path, remedy, key=key)


def _list_named(file: WorkcellFile) -> Iterator[tuple[str, Path_, bool]]:
    """Each type, its place, and whether it is a key there."""
    for place, entry in file.stations.items():
        for number, kind in enumerate(entry.accepts or ()):
            yield kind, ("stations", place, "accepts", number), False
        for arm, grips in entry.reach.items():
            for kind in grips if isinstance(grips, dict) else ():
                yield kind, ("stations", place, "reach", arm, kind), True
    for arm, places in file.locations.items():
        for place, poses in places.items():
            for kind in poses if isinstance(poses, dict) else ():
                if kind != ANY:
                    yield kind, ("locations", arm, place, kind), True
    for place, counts in (file.stock or {}).items():
        for item in counts:
            for kind in split_item(item):
                yield kind, ("stock", place, item), True

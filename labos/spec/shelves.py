"""Poses of hotels: files have the pose of the first shelf and a step; LabOS uses one pose per shelf."""

from __future__ import annotations

from labos.spec.findings import Remarks
from labos.spec.models import PoseEntry, ShelfPoses, WorkcellFile


def expand_shelves(file: WorkcellFile, remarks: Remarks) -> WorkcellFile:
    """The file with a location for each shelf instead of those for whole hotels."""
    locations: dict[str, dict[str, PoseEntry]] = {}
    for owner, places in file.locations.items():
        known = locations[owner] = {}
        for place, written in places.items():
            path = ("locations", owner, place)
            entry = file.stations.get(place)
            shelves = entry.shelves if entry is not None else None
            if not isinstance(written, ShelfPoses):
                known[place] = written
            elif shelves is None:
                message = f"{place} has no shelves, but {owner} has a pose for its first shelf."
                remarks.error(message, path, f"Give it `shelves:` under `stations: {place}:`, or one pose.")
            elif len(written.first) != len(written.step):
                message = f"The first shelf has {len(written.first)} values, the step {len(written.step)}."
                remarks.error(
                    message, (*path, "step"), "Give the same number: 0 for a value that does not change."
                )
            else:
                known |= {f"{place}.{number}": written.find_pose(number) for number in range(1, shelves + 1)}
    return file.model_copy(update={"locations": locations})

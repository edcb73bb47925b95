"""The bench in a dry run, from the view of one run."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from copy import deepcopy
from typing import Any, Self

from labos.core.bench import split_item
from labos.core.ids import ModuleName, StationName, local
from labos.core.model import LabwareSpec, ModuleSpec, StationSpec
from labos.spec.stations import Stations

AddFinding = Callable[[int, str, str], None]
"""Called with the index of a step, its fault, and a remedy."""

UNKNOWN: Any = object()


class Piece:
    """One piece of labware of the run. ``item`` is its type, with the type of its lid if it has one."""

    def __init__(self, item: str, *, fresh: bool) -> None:
        self.kind, lid = split_item(item)
        self.fresh = fresh
        """Whether it came from a stack; the variables of other labware are not known."""
        self.variables: dict[str, Any] = {}
        self.at_first: dict[str, Any] = {}
        """The values that its variables must have at the start of the run."""
        self.lid = Piece(lid, fresh=fresh) if lid else None
        self.volumes_ul: dict[str, float] = {}
        self.parked: StationName | None = None
        """The station where its lid was put."""

    def find_variable(self, name: str) -> Any:
        if name == "lidded" and (self.lid is not None or self.fresh):
            return self.lid is not None
        return self.variables.get(name, False if self.fresh else UNKNOWN)


class Paper:
    """The labware of a run, the states of doors, and the labware that must be there when the run starts."""

    def __init__(
        self,
        stations: Stations,
        modules: Mapping[ModuleName, ModuleSpec],
        labware: Mapping[str, LabwareSpec],
        stock: Mapping[StationName, str],
        counts: dict[StationName, int] | None,
        error: AddFinding,
        warning: AddFinding,
    ) -> None:
        self.stations, self.modules, self.labware = stations, modules, labware
        self.stock, self.counts, self.error, self.warning = stock, counts, error, warning
        self.at: dict[StationName, list[Piece]] = {}
        self.inputs: list[StationName] = []
        self.missing: list[StationName] = []
        self.taken: list[tuple[StationName, Piece]] = []
        """The labware that must be there at the start: at a station, or in a module with several stations."""
        self.left: set[StationName] = set()
        """Stations from which labware of the run was taken away. It is not recorded if steps have conditions:
        the dry run carries out both of two steps that exclude each other."""
        self.variables = {name: dict(module.rest) for name, module in modules.items()}
        self.taught = {arm for station in stations.by_name.values() for arm in station.reach}

    def copy(self, error: AddFinding) -> Self:
        """A copy of the present bench for a trial; faults go to ``error``."""
        counts = None if self.counts is None else dict(self.counts)
        other = type(self)(self.stations, self.modules, self.labware, self.stock, counts, error, error)
        other.at, other.variables = deepcopy((self.at, self.variables), {id(UNKNOWN): UNKNOWN})
        other.inputs, other.left = list(self.inputs), set(self.left)
        return other

    def mark(self) -> object:
        """A value that is different for different states of the bench."""
        here = [
            (
                place,
                piece.kind,
                piece.lid is not None,
                sorted((n, repr(v)) for n, v in piece.variables.items()),
            )
            for place, pieces in self.at.items()
            for piece in pieces
        ]
        return repr((sorted(here), sorted((name, sorted(v.items())) for name, v in self.variables.items())))

    def list_outputs(self) -> tuple[StationName, ...]:
        """The stations with the run's labware at its end; one entry per piece."""
        return tuple(name for name, pieces in self.at.items() for _ in pieces)

    def list_stations(self, module: ModuleName) -> list[StationSpec]:
        """The stations at which a module works on labware."""
        return [station for station in self.stations.list_for(module) if station.kind != "gripper"]

    def find_labware_at(self, index: int, place: StationName, but: Collection[Piece] = ()) -> Piece | None:
        """The run's piece at a place, except ``but``. If there is none, one that must be there from the
        start."""
        pieces = self.at.setdefault(place, [])
        left = [piece for piece in pieces if piece not in but]
        if left:
            return left[-1]
        station = self.stations[place]
        if station.kind == "waste":
            self.error(index, f"Labware cannot be taken out of {local(place)}.", "Name another station.")
            return None
        if (place in self.inputs or place in self.left) and not station.is_storage:
            self.error(
                index,
                f"The labware of this run is no longer at {local(place)}.",
                "An earlier step moved it away; name its present station, or move labware there first.",
            )
            return None
        self.inputs.append(place)
        piece = Piece(self.stock.get(place, ""), fresh=station.kind == "stack")
        pieces.append(piece)
        self.taken.append((place, piece))
        return piece

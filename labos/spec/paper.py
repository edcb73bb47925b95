"""The bench on paper, as far as one run knows it."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from copy import deepcopy
from typing import Any, Self

from labos.core.bench import split_item
from labos.core.ids import ModuleName, StationName, local
from labos.core.model import Description, LabwareSpec, ModuleSpec, StationSpec
from labos.spec.stations import Stations

Tell = Callable[[int, str, str], None]
"""Called with the index of a step, what is wrong with it, and a remedy."""

UNKNOWN: Any = object()


class Piece:
    """One piece of labware of the run. ``item`` is its type, and that of its lid if it has one."""

    def __init__(self, item: str, *, fresh: bool) -> None:
        self.kind, lid = split_item(item)
        self.fresh = fresh
        """Whether it came from a stack; of other labware the variables are not known."""
        self.variables: dict[str, Any] = {}
        self.at_first: dict[str, Any] = {}
        """What its variables must have been when the run began."""
        self.lid = Piece(lid, fresh=fresh) if lid else None
        self.volumes_ul: dict[str, float] = {}
        self.parked: StationName | None = None
        """Where its lid was put."""

    def find_variable(self, name: str) -> Any:
        if name == "lidded" and (self.lid is not None or self.fresh):
            return self.lid is not None
        return self.variables.get(name, False if self.fresh else UNKNOWN)


class Paper:
    """Where labware of a run stands, how doors are, and what must stand there when the run starts."""

    def __init__(
        self,
        stations: Stations,
        modules: Mapping[ModuleName, ModuleSpec],
        descriptions: Mapping[ModuleName, Description],
        labware: Mapping[str, LabwareSpec],
        stock: Mapping[StationName, str],
        counts: dict[StationName, int] | None,
        error: Tell,
        warning: Tell,
    ) -> None:
        self.stations, self.modules, self.descriptions = stations, modules, descriptions
        self.labware = labware
        self.stock, self.counts, self.error, self.warning = stock, counts, error, warning
        self.at: dict[StationName, list[Piece]] = {}
        self.inputs: list[StationName] = []
        self.missing: list[StationName] = []
        self.taken: list[tuple[StationName, Piece]] = []
        """What must stand there at the start, or be in a module that has several stations."""
        self.left: set[StationName] = set()
        """Where labware of the run stood, and was taken away. Not kept where conditions decide about steps:
        of two that exclude each other both go through here."""
        self.variables = {name: dict(module.rest) for name, module in modules.items()}
        self.taught = {arm for station in stations.by_name.values() for arm in station.reach}

    def copy(self, error: Tell) -> Self:
        """The bench as it stands now, to try out something else on; faults go to ``error``."""
        counts = None if self.counts is None else dict(self.counts)
        known = (self.stations, self.modules, self.descriptions, self.labware)
        other = type(self)(*known, self.stock, counts, error, error)
        other.at, other.variables = deepcopy((self.at, self.variables), {id(UNKNOWN): UNKNOWN})
        other.inputs, other.left = list(self.inputs), set(self.left)
        return other

    def mark(self) -> object:
        """What tells one state of the bench from another."""
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
        """Where the run's labware stands at its end; once a piece."""
        return tuple(name for name, pieces in self.at.items() for _ in pieces)

    def list_stations(self, module: ModuleName) -> list[StationSpec]:
        """Where a module works on labware."""
        return [station for station in self.stations.list_for(module) if station.kind != "gripper"]

    def find_labware_at(self, index: int, place: StationName, but: Collection[Piece] = ()) -> Piece | None:
        """The run's piece at a place, none of ``but``; one that must stand there from the start, if there is
        none."""
        pieces = self.at.setdefault(place, [])
        left = [piece for piece in pieces if piece not in but]
        if left:
            return left[-1]
        station = self.stations[place]
        if station.kind == "waste":
            self.error(index, f"Nothing can be taken out of {local(place)}.", "Name another station.")
            return None
        if (place in self.inputs or place in self.left) and not station.is_storage:
            self.error(
                index,
                f"There is no labware of this run at {local(place)} any more.",
                "An earlier step took it away; name where it is now, or move some there first.",
            )
            return None
        self.inputs.append(place)
        piece = Piece(self.stock.get(place, ""), fresh=station.kind == "stack")
        pieces.append(piece)
        self.taken.append((place, piece))
        return piece

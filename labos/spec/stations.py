"""Finds the station to which a written place refers."""

from __future__ import annotations

from collections.abc import Iterable

from labos.core.ids import ModuleName, StationName, local, split_place
from labos.core.model import StationSpec, Workcell
from labos.errors import SpecError
from labos.spec.findings import suggest_name


def strip_place(text: str) -> str:
    """A place without the words that files of WEI have between module and station."""
    for middle in (".positions.", ".locations."):
        text = text.replace(middle, ".", 1)
    return text


class Stations:
    """The stations of a workcell, by all their names.

    A place may be written as ``module.station``, ``module.positions.station``, ``workcell/module.station``,
    or by an alias. Its last part alone is enough if it is unique for the acting module. The module's name is
    enough if it has only one station. Capital and small letters are distinguished only where both exist.
    """

    def __init__(self, workcell: str, stations: Iterable[StationSpec]) -> None:
        self.workcell = workcell
        self.by_name = {station.name: station for station in stations}
        self._known: dict[str, set[StationName]] = {}
        owned: dict[str, list[StationName]] = {}
        for station in self.by_name.values():
            if station.hotel:
                continue  # a shelf has only its full name
            written = local(station.name)
            owner, last = split_place(written)
            if owner:
                owned.setdefault(owner, []).append(station.name)
            for alias in station.aliases:
                for name in (alias, f"{owner}.{alias}"):
                    self._known.setdefault(name.lower(), set()).add(station.name)
            self._known.setdefault(last.lower(), set()).add(station.name)
        for owner, names in owned.items():
            places = [name for name in names if self.by_name[name].kind != "gripper"]
            if len(places) == 1:
                self._known.setdefault(owner.lower(), set()).add(places[0])
        self._exact = {local(name): name for name in self.by_name}
        self._lower: dict[str, set[StationName]] = {}
        for written, name in self._exact.items():
            self._lower.setdefault(written.lower(), set()).add(name)

    def __getitem__(self, name: StationName) -> StationSpec:
        return self.by_name[name]

    def __contains__(self, name: object) -> bool:
        return name in self.by_name

    def find(self, text: str, module: str = "") -> StationName:
        """The station's full name. Short names of stations of ``module`` (local name) take precedence. Raises
        SpecError."""
        written = text.strip()
        home, slash, rest = written.partition("/")
        if slash:
            if home != self.workcell:
                raise SpecError(
                    f"The station {text!r} is not in the workcell {self.workcell!r}.",
                    remedy="Name a station of this workcell.",
                )
            written = rest
        found = self.list_matches(written, module)
        if len(found) == 1:
            return found[0]
        if found:
            names = ", ".join(map(local, found))
            raise SpecError(f"The station {text!r} is ambiguous: {names}.", remedy="Write its full name.")
        raise SpecError(
            f"There is no station {text!r} in workcell {self.workcell!r}.",
            remedy=suggest_name(strip_place(written), self._exact, "station"),
        )

    def find_known(self, text: object, module: str = "") -> StationName | None:
        """As ``find``, but None if the text is not the name of one station."""
        try:
            return self.find(text, module) if isinstance(text, str) else None
        except SpecError:
            return None

    def list_matches(self, written: str, module: str = "") -> list[StationName]:
        """The stations to which a place without its workcell may refer, sorted. Only the nearest meaning
        counts; empty if there is none."""
        written = strip_place(written.strip())
        names = [written]
        if module and "." not in written:
            names.insert(0, f"{module}.{written}")
        for name in names:
            if name in self._exact:
                return [self._exact[name]]
            for known in (self._lower, self._known):
                if len(found := known.get(name.lower(), ())) == 1:
                    return list(found)
        return sorted(self._known.get(written.lower(), ()))

    def list_for(self, module: ModuleName) -> list[StationSpec]:
        """The stations of a module; of a hotel not its shelves."""
        return [s for s in self.by_name.values() if s.module == module and not s.hotel]

    def list_shelves(self, hotel: StationName) -> list[StationName]:
        """The shelves of a hotel, lowest first; none for other stations."""
        return [station.name for station in self.by_name.values() if station.hotel == hotel]


def resolve_station(workcell: Workcell, text: str, module: str = "") -> StationName:
    """The station to which a written place refers. Raises SpecError with the nearest names."""
    return Stations(workcell.name, workcell.stations).find(text, module)

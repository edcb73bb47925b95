"""What somebody saw at a station, whatever the log believes."""

from __future__ import annotations

from labos.core.ids import LabwareId, StationName
from labos.core.registry import Event, event


@event("station.observed")
class StationObserved(Event, frozen=True):
    """A sensor or a person looked at a station. ``count`` is how many pieces stand there (0: it is
    empty; null: at least one), ``labware`` and ``type`` what was recognised; ``by`` is the module or
    the person that looked. What follows from it stands behind it as events of its own."""

    station: StationName
    by: str
    count: int | None = None
    labware: LabwareId = LabwareId("")
    type: str = ""

    def stream(self) -> str:
        return self.station

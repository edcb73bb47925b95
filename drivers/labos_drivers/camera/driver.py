"""Takes pictures with a real camera, and says what can be told from them."""

from __future__ import annotations

from pathlib import PurePosixPath
from typing import Any

from labos.errors import DeviceError
from labos.node import Attachment, Setup
from labos_drivers._wired import Behind, Wired, off_loop
from labos_drivers.camera import vision
from labos_drivers.camera.source import source_of
from labos_drivers.camera.vision import Picture

OWN = "plate_station"
View = tuple[float, float, float, float]
EVERYTHING: View = (0.0, 0.0, 1.0, 1.0)


class CameraDriver(Wired):
    """A camera moves nothing: a stop only throws away the picture that is being taken."""

    where = ("source", "/dev/video0")
    deadlines = ("open", "frame", "answer")

    def __init__(self, setup: Setup, address: str, simulator: Behind | None = None) -> None:
        super().__init__(setup, address, simulator)
        self._views = views_of(setup)
        self._reads = bool(setup.config.get("reads"))
        self._source = source_of(setup.name, address, setup.config, self.limit_s)
        self.link = self._source.link

    @off_loop
    def connect(self) -> None:
        vision.cv()
        self.link.open()

    @off_loop
    def grab_image(self, file_name: str, folder: str, rotation_deg: float, focus: int | None) -> Attachment:
        """The picture as a file."""
        vision.format_of(file_name)
        with self.motion():
            picture = vision.rotate(self._picture(focus), rotation_deg)
            return Attachment(str(PurePosixPath(folder) / file_name), vision.encode(picture, file_name))

    @off_loop
    def read_barcode(self) -> str:
        """Of the plate in its own nest; empty if there is none that can be read."""
        with self.motion():
            return vision.label_in(vision.part(self._picture(), self._views[OWN]))

    @off_loop
    def look(self) -> dict[str, Any]:
        """Of each place that it sees 0 or 1, or the label if it ``reads`` them; nothing of places of
        which the picture does not tell it."""
        picture = self._picture(glance=True)
        seen: dict[str, int | str] = {}
        for place, view in self._views.items():
            there = vision.stands_there(vision.part(picture, view))
            if there is not None:
                label = vision.label_in(vision.part(picture, view)) if there and self._reads else ""
                seen[place] = label or int(there)
        return {"labware": seen}

    async def is_idle(self) -> bool:
        return not self.moving

    @off_loop
    def reset(self) -> None:
        self.link.open()
        self.resume()

    async def stop(self) -> None:
        self._halted.set()

    # -- one picture -------------------------------------------------------------------------

    def _picture(self, focus: int | None = None, *, glance: bool = False) -> Picture:
        """Raises DeviceError for one that shows nothing, or not the present."""
        *before, picture = self._source.take(focus, glance=glance)
        # The picture has been taken, and has changed nothing.
        self.unless_stopped(effects="all")
        if vision.is_black(picture):
            raise DeviceError(
                f"{self.name}: the picture is black.",
                effects="all",
                remedy="Switch the light on, and see that nothing covers the lens.",
            )
        if before and vision.is_same(before[-1], picture):
            raise DeviceError(
                f"{self.name}: the camera is frozen: two pictures are the same, bit by bit.",
                effects="all",
                remedy="Switch the camera off and on, then reset the module.",
            )
        return picture


def views_of(setup: Setup) -> dict[str, View]:
    """Which part of the picture shows each place: as ``views:`` says, else strips of one width from left
    to right. Raises DeviceError."""
    places = [OWN, *map(str, setup.config.get("observes") or ())]
    told = setup.config.get("views")
    if told is None:
        share = 1 / len(places)
        return {place: (n * share, 0.0, (n + 1) * share, 1.0) for n, place in enumerate(places)}
    views = {OWN: EVERYTHING, **{str(place): _view(setup.name, place, view) for place, view in told.items()}}
    if missing := [place for place in places if place not in views]:
        raise DeviceError(
            f"{setup.name}: `views:` does not say where in the picture {missing[0]} is.", effects="none"
        )
    return views


def _view(name: str, place: str, told: Any) -> View:
    try:
        left, top, right, bottom = map(float, told)
    except (TypeError, ValueError):
        left, top, right, bottom = 1.0, 1.0, 0.0, 0.0
    if not (0 <= left < right <= 1 and 0 <= top < bottom <= 1):
        raise DeviceError(
            f"{name}: the view of {place} is no part of a picture.",
            effects="none",
            remedy="Write it as [left, top, right, bottom], each 0 to 1.",
        )
    return left, top, right, bottom

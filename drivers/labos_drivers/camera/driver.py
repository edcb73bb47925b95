"""The driver of a real camera: takes pictures, reads labels and detects plates."""

from __future__ import annotations

from pathlib import PurePosixPath
from typing import Any

from labos.errors import DeviceError
from labos.node import Attachment, Setup
from labos_drivers._refusals import make_refusal
from labos_drivers._wired import DeviceOnWire, Wired, off_loop
from labos_drivers.camera import vision
from labos_drivers.camera.source import make_source
from labos_drivers.camera.vision import Picture

OWN = "plate_station"
View = tuple[float, float, float, float]
EVERYTHING: View = (0.0, 0.0, 1.0, 1.0)


class CameraDriver(Wired):
    """A camera moves nothing. A stop discards the present picture, and all others until a reset."""

    where = ("source", "/dev/video0")
    deadlines = ("open", "frame", "answer")

    def __init__(self, setup: Setup, address: str, simulator: DeviceOnWire | None = None) -> None:
        super().__init__(setup, address, simulator)
        self._views = read_views(setup)
        self._reads = bool(setup.config.get("reads"))
        self._source = make_source(setup.name, address, setup.config, self.limit_s)
        self.link = self._source.link

    @off_loop
    def connect(self) -> None:
        vision.cv()
        self.link.open()

    @off_loop
    def grab_image(self, file_name: str, folder: str, rotation_deg: float, focus: int | None) -> Attachment:
        """Take a picture; returns it as a file."""
        vision.format_of(file_name)
        with self.motion():
            picture = vision.rotate(self._take_picture(focus), rotation_deg)
            return Attachment(str(PurePosixPath(folder) / file_name), vision.encode(picture, file_name))

    @off_loop
    def read_barcode(self) -> str:
        """The label of the plate in the camera's own nest; empty if it cannot be read."""
        with self.motion():
            return vision.read_label(vision.part(self._take_picture(), self._views[OWN]))

    @off_loop
    def observe(self) -> dict[str, Any]:
        """For each place in view 0 or 1, or the label if the camera ``reads`` labels. A place is left out if
        the picture does not show whether it is occupied."""
        picture = self._take_picture(glance=True)
        seen: dict[str, int | str] = {}
        for place, view in self._views.items():
            there = vision.is_occupied(vision.part(picture, view))
            if there is not None:
                label = vision.read_label(vision.part(picture, view)) if there and self._reads else ""
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

    def _take_picture(self, focus: int | None = None, *, glance: bool = False) -> Picture:
        """Take a picture. Raises DeviceError if it is black, if the camera is frozen, or after a stop."""
        *before, picture = self._source.take(focus, glance=glance)
        # The effects are complete: the picture was taken, and it changes nothing on the bench.
        self.check_not_stopped(effects="all")
        if vision.is_black(picture):
            raise DeviceError(
                f"{self.name}: the picture is black.",
                effects="all",
                remedy="Switch the light on, and check that nothing covers the lens.",
            )
        if before and vision.is_same(before[-1], picture):
            raise DeviceError(
                f"{self.name}: the camera is frozen: two pictures are the same, bit by bit.",
                effects="all",
                remedy="Switch the camera off and on, then reset the module.",
            )
        return picture


def read_views(setup: Setup) -> dict[str, View]:
    """The part of the picture that shows each place: from ``views:``, else strips of equal width from left to
    right. Raises DeviceError if a view is missing or is not a part of a picture."""
    places = [OWN, *map(str, setup.config.get("observes") or ())]
    configured = setup.config.get("views")
    if configured is None:
        share = 1 / len(places)
        return {place: (n * share, 0.0, (n + 1) * share, 1.0) for n, place in enumerate(places)}
    views = {
        OWN: EVERYTHING,
        **{str(place): _read_view(setup.name, place, view) for place, view in configured.items()},
    }
    if missing := [place for place in places if place not in views]:
        raise DeviceError(
            f"{setup.name}: `views:` has no entry for {missing[0]}: where is it in the picture?",
            effects="none",
        )
    return views


def _read_view(name: str, place: str, configured: Any) -> View:
    try:
        left, top, right, bottom = map(float, configured)
    except (TypeError, ValueError):
        left, top, right, bottom = 1.0, 1.0, 0.0, 0.0
    if not (0 <= left < right <= 1 and 0 <= top < bottom <= 1):
        raise make_refusal(
            name,
            f"the view of {place} is not a part of a picture",
            "Write it as [left, top, right, bottom], each 0 to 1.",
        )
    return left, top, right, bottom

"""Drives a SciClops over USB or a serial port."""

from __future__ import annotations

from labos.link import UsbWire, Wire
from labos_drivers._hudson import HudsonDriver, SciclopsDialect, Sizes
from labos_drivers._wired import off_loop
from labos_drivers.sciclops.simulator import TOWERS

USB_VENDOR, USB_PRODUCT, USB_OUT, USB_IN = 0x7513, 0x0002, 0x04, 0x83
SIZES = Sizes(
    plate_mm=16.26,
    grip_mm=8.26,
    lid_mm=7.0,
    clear_mm=10.0,
    travel_z=23.5188,
    retracted_y=0.0,
    near=0.5,
)


class SciclopsDriver(HudsonDriver):
    """Uses millimetres and degrees. The default speed is only 10 %, because other arms may be near."""

    where = ("port", "usb")
    dialect = SciclopsDialect()
    sizes = SIZES
    limits = {"R": (0, 345), "Z": (-430, 30), "P": (0, 180), "Y": (0, 200)}
    codes = {1214: "a limit switch was hit in a jog", 1400: "the Z axis has hit something"}
    stacks = TOWERS
    speed_percent = 10.0

    def wire(self, address: str) -> Wire:
        if address == "usb":
            return UsbWire(USB_VENDOR, USB_PRODUCT, out_end=USB_OUT, in_end=USB_IN)
        return super().wire(address)

    @off_loop
    def get_plate(self, tower: str, target: str) -> None:
        """Move the topmost plate of a tower to a target. Raises DeviceError."""
        self._carry((tower, 0.0), (target, 0.0))

"""CANopen axis of the drive profile CiA 402."""

from labos_drivers.axis.interface import Axis

__all__ = ["Axis"]

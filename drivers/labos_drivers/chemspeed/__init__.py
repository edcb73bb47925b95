"""Chemspeed SWING synthesis platform."""

from labos_drivers.chemspeed.interface import Chemspeed

__all__ = ["Chemspeed"]

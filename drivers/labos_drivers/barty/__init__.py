"""Barty, the ink refill robot."""

from labos_drivers.barty.interface import Barty

__all__ = ["Barty"]

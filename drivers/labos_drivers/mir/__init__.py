"""Mobile Industrial Robots base."""

from labos_drivers.mir.interface import MiR

__all__ = ["MiR"]

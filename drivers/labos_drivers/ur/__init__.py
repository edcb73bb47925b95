"""Universal Robots e-Series arm."""

from labos_drivers.ur.interface import UR

__all__ = ["UR"]

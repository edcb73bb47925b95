"""Hudson PlateCrane EX plate arm."""

from labos_drivers.platecrane.interface import PlateCrane

__all__ = ["PlateCrane"]

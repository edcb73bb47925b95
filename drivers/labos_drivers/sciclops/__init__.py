"""Hudson SciClops plate stacker."""

from labos_drivers.sciclops.interface import Sciclops

__all__ = ["Sciclops"]

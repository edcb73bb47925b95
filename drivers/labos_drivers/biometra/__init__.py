"""Analytik Jena Biometra TRobot II thermal cycler."""

from labos_drivers.biometra.interface import Biometra

__all__ = ["Biometra"]

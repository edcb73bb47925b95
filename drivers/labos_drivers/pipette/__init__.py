"""Electronic pipette of TriContinent that an arm picks up."""

from labos_drivers.pipette.interface import Pipette

__all__ = ["Pipette"]

"""Hidex Sense plate reader."""

from labos_drivers.hidex.interface import Hidex

__all__ = ["Hidex"]

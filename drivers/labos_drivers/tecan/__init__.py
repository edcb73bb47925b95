"""Tecan Infinite plate reader."""

from labos_drivers.tecan.interface import Tecan

__all__ = ["Tecan"]

"""Inheco single-plate incubator shaker."""

from labos_drivers.inheco.interface import Inheco

__all__ = ["Inheco"]

"""Azenta XPeel seal remover."""

from labos_drivers.brooks_peeler.interface import BrooksPeeler

__all__ = ["BrooksPeeler"]

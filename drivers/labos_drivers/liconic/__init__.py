"""LiCONiC StoreX STX88 incubator."""

from labos_drivers.liconic.interface import Liconic

__all__ = ["Liconic"]

"""Azenta a4S plate sealer."""

from labos_drivers.a4s_sealer.interface import A4sSealer

__all__ = ["A4sSealer"]

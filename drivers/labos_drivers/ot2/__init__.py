"""Opentrons OT-2 liquid handler."""

from labos_drivers.ot2.interface import OT2

__all__ = ["OT2"]

"""Hudson SOLO liquid handler."""

from labos_drivers.solo.interface import Solo

__all__ = ["Solo"]

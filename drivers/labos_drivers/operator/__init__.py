"""A person, as a module."""

from labos_drivers.operator.interface import Operator

__all__ = ["Operator"]

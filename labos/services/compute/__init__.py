"""Computations of experiments: functions that run in other processes, here or on a cluster."""

from labos.services.compute._calls import Attempts, Computed, ComputeFailed, Computing
from labos.services.compute._places import PLACES, open_place
from labos.services.compute._work import Measured, code_digest, value_digest

__all__ = [
    "PLACES",
    "Attempts",
    "ComputeFailed",
    "Computed",
    "Computing",
    "Measured",
    "code_digest",
    "open_place",
    "value_digest",
]

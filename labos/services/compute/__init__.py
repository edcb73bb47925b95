"""Computations of experiments: functions that run in other processes, here or on a cluster."""

from labos.services.compute._calls import Attempts, Computed, ComputeFailed, Computing
from labos.services.compute._places import PLACES, open_place
from labos.services.compute._sent import ComputesOnce, MemoryRecord, PlaceUnavailable, SendingRecord
from labos.services.compute._work import (
    Measured,
    Returned,
    digest_code,
    digest_value,
    do_nothing,
    return_marked,
)

__all__ = [
    "PLACES",
    "Attempts",
    "ComputeFailed",
    "Computed",
    "ComputesOnce",
    "Computing",
    "Measured",
    "MemoryRecord",
    "PlaceUnavailable",
    "Returned",
    "SendingRecord",
    "digest_code",
    "digest_value",
    "do_nothing",
    "open_place",
    "return_marked",
]

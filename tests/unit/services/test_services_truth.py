"""A simulated bench held against a log: what is an alarm, and what is none."""

from __future__ import annotations

from labos.core.state import LabState
from labos.node import World
from labos.services.truth import list_differences


def test_readings_of_an_instrument_are_no_alarm() -> None:
    """A spectrum is one action, and a reading of each row or wavelength to the device."""
    world = World(":memory:")
    world.work("reader", "read", "", nm=400)
    world.work("reader", "read", "", nm=420)
    assert list_differences(world, LabState(), []) == []


def test_work_that_the_log_does_not_know_is_one() -> None:
    world = World(":memory:")
    world.stock("sealer.default", "plate96")
    (plate,) = world.at("sealer.default")
    world.work("sealer", "seal", "sealer.default")
    world.carry(plate, "")
    assert list_differences(world, LabState(), []) == ["sealer did seal 1 times, the log says 0"]

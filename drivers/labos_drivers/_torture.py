"""Faults that many instruments can have, for their declarations for the torture suite."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from labos.node import World

Strike = Callable[[Any, World], None]
"""Something that happens to a simulated device and its bench."""


def remove_plate(place: str) -> Strike:
    """A person takes the plate at a place away."""
    return lambda device, world: world.carry(device.top(device.place(place)), "")


def occupy(place: str) -> Strike:
    """A person puts a plate on a place."""

    def stock(device: Any, world: World) -> None:
        world.stock(device.place(place), "plate96")

    return stock


def use_up(resource: str) -> Strike:
    """A resource of the device is used up."""
    return lambda device, world: world.supply(
        device.name, resource, -(world.find_level(device.name, resource) or 0.0)
    )


def refill(resource: str, amount: float) -> Strike:
    """A person puts a new pack of a resource into the device."""
    return lambda device, world: world.supply(device.name, resource, amount)


def is_holding(arm: Any, world: World) -> bool:
    return bool(arm.find_held_plate())


def is_moving_empty(arm: Any, world: World) -> bool:
    return bool(arm.is_in_motion) and not is_holding(arm, world)

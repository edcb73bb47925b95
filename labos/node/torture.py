"""A driver's declaration for the torture suite, beyond its description: one value, ``TORTURE``.

It stands in the driver's module, or in a module ``torture`` beside it. All of it may be left out: then
each action is tried with the arguments that follow from its description, on a simulated bench.

::

    TORTURE = Torture(
        device=SimulatedShaker,
        cases=(Case("shake", {"speed": 800}),),
        faults=(Fault("the motor stalls", lambda shaker, world: shaker.stall()),),
    )
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Protocol

import msgspec

from labos.node.node import Setup
from labos.node.world import World


class WiredDevice(Protocol):
    """A simulated device at the far end of a real wire, in a thread of its own. It keeps its own truth in
    ``setup.world``; what it does there is what counts."""

    @property
    def address(self) -> str:
        """What a driver opens: a serial port, ``socket://host:port``, or an address of TCP or HTTP."""

    def start(self) -> None:
        """Power on."""

    def close(self) -> None:
        """Power off."""


class Case(msgspec.Struct, frozen=True):
    """An example call of an action, and the bench it needs.

    ``stock`` says what stands where before (``{"default": "plate96"}``, ``plate96+lid96`` with a lid);
    empty: as follows from the effects. ``prepare`` is what else somebody has to do to the simulated device
    (None if it lives in the node) and the bench.
    ``files`` are arguments that name files: the name and the text of each, by argument.
    ``ends`` is where the plate that is moved stands afterwards, if the effects do not name the place.
    ``refused`` is a part of the message with which this device declines the action; nothing moves then.
    ``record`` turns the arguments into what the device then notes of its set points, in the facts of one of
    its motions: ``lambda args: {"speed_rpm": args["speed"]}``.
    """

    action: str
    args: dict[str, Any] = {}
    stock: dict[str, str] = {}
    prepare: Callable[[Any, World], None] | None = None
    ends: str = ""
    refused: str = ""
    files: dict[str, tuple[str, str]] = {}
    record: Callable[[dict[str, Any]], dict[str, Any]] | None = None


class Fault(msgspec.Struct, frozen=True):
    """How a device is made to fail: ``strike`` is given the simulated device (None if it lives in the
    node) and the bench, before the action and in its middle; ``mend`` puts it right again, if a reset does
    not."""

    name: str
    strike: Callable[[Any, World], None]
    mend: Callable[[Any, World], None] | None = None

    @classmethod
    def by_setting(cls, name: str, attribute: str, *, to: Any = True, back: Any = False) -> Fault:
        """A fault that an attribute of the simulated device stands for."""

        def set_to(value: Any) -> Callable[[Any, World], None]:
            def change(device: Any, world: World) -> None:
                getattr(device, attribute)  # raises AttributeError for one that the device does not have
                setattr(device, attribute, value)

            return change

        return cls(name, set_to(to), set_to(back))


class Foreign(msgspec.Struct, frozen=True):
    """Software of others that has driven the simulated device, or that the driver has driven.
    ``shown_by`` names the test that does it."""

    software: str
    version: str
    shown_by: str


class Hardware(msgspec.Struct, frozen=True):
    """The real instrument that the driver was tried on."""

    serial: str
    date: str
    who: str


class Torture(msgspec.Struct, frozen=True, kw_only=True):
    """What the suite needs.

    ``device`` makes the simulated device at the far end of its wire; without it the device lives in the
    node and no wire can be cut. ``config`` turns the address of the wire into the module's configuration
    (``{"port": address}`` if left out). ``waits`` are constants of modules, as
    ``{"my.driver:MOTION_S": 5.0}``: how long the driver waits for motions that take seconds here and
    minutes in a lab. ``motion`` is the action that is interrupted, the longest that moves labware if left
    out; ``moments`` say when, by turns, as seen on the simulated device and the bench (after a share of the
    time that it takes, if left out). ``clear`` is what a person who takes all plates away does to the device,
    as opening its fingers. ``unasked`` is what the device may say without having been asked, as its manual
    has it: lines with their ends. ``left_out`` names checks that cannot be made, with the reason. Other
    settings of the module stand in ``settings``, taught places in ``poses``, of which ``regrip`` is the one
    where the grip is changed, the level of each resource in ``supplies``.
    """

    cases: tuple[Case, ...] = ()
    faults: tuple[Fault, ...] = ()
    device: Callable[[Setup], WiredDevice] | None = None
    config: Callable[[str], Mapping[str, Any]] | None = None
    settings: dict[str, Any] = {}
    poses: dict[str, list[float]] = {}
    regrip: str = ""
    supplies: dict[str, float] = {}
    waits: dict[str, float] = {}
    motion: str = ""
    moments: tuple[Callable[[Any, World], bool], ...] = ()
    clear: Callable[[Any, World], None] | None = None
    unasked: tuple[bytes, ...] = ()
    left_out: dict[str, str] = {}
    foreign: tuple[Foreign, ...] = ()
    hardware: tuple[Hardware, ...] = ()

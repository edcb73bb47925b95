"""A driver's declaration for the torture suite, beyond its description: one value, ``TORTURE``.

It is in the driver's module, or in a module ``torture`` beside it. It may be left out: then each action is
tried with arguments that are derived from its description, on a simulated bench.

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
    """A simulated device at the far end of a real wire, in its own thread. ``setup.world`` is its real state;
    the suite judges by what the device does there."""

    @property
    def address(self) -> str:
        """The address that a driver opens: a serial port, ``socket://host:port``, or an address of TCP or
        HTTP."""

    def start(self) -> None:
        """Switch on."""

    def close(self) -> None:
        """Switch off."""


class Case(msgspec.Struct, frozen=True):
    """An example call of an action, and the bench it needs.

    ``stock`` is the labware at stations before the call (``{"default": "plate96"}``, ``plate96+lid96`` with a
    lid); if it is empty, it is derived from the effects. ``prepare`` makes further changes to the simulated
    device (None if it is a part of the node) and the bench. ``files`` has the name and the text of each file,
    by the argument that names it. ``ends`` is the place of the moved plate afterwards, if the effects do not
    name it. ``refused`` is a part of the message with which this device declines the action; nothing moves
    then. ``record`` converts the arguments to the set points that the device records in the facts of one of
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
    """A way to make a device fail. ``strike`` gets the simulated device (None if it is a part of the node)
    and the bench; it is called before the action and in its middle. ``mend`` repairs the device, if a reset
    does not."""

    name: str
    strike: Callable[[Any, World], None]
    mend: Callable[[Any, World], None] | None = None

    @classmethod
    def by_setting(cls, name: str, attribute: str, *, to: Any = True, back: Any = False) -> Fault:
        """A fault that sets an attribute of the simulated device."""

        def set_to(value: Any) -> Callable[[Any, World], None]:
            def change(device: Any, world: World) -> None:
                # Raises AttributeError for an attribute that the device does not have.
                getattr(device, attribute)
                setattr(device, attribute, value)

            return change

        return cls(name, set_to(to), set_to(back))


class Foreign(msgspec.Struct, frozen=True):
    """Software of others that has driven the simulated device, or that the driver has driven. ``shown_by``
    names the test for it."""

    software: str
    version: str
    shown_by: str


class Hardware(msgspec.Struct, frozen=True):
    """The real instrument on which the driver was tried."""

    serial: str
    date: str
    who: str


class Torture(msgspec.Struct, frozen=True, kw_only=True):
    """The declaration for the torture suite.

    ``device`` makes the simulated device at the far end of its wire; without it the device is a part of the
    node and no wire can be cut. ``config`` converts the address of the wire to the module's configuration
    (``{"port": address}`` if left out). ``waits`` are constants of modules, as ``{"my.driver:MOTION_S":
    5.0}``: the driver's time limits for motions, which take seconds here and minutes in a lab. ``motion`` is
    the action that is interrupted; if left out, it is the longest that moves labware. ``moments`` are
    conditions on the simulated device and the bench at which it is interrupted, in turn; if left out, it is
    interrupted after a part of its duration. ``clear`` is what a person who takes all plates away does to the
    device, for example open its fingers. ``unasked`` are the messages that the device may send without a
    request according to its manual: lines with their ends. ``left_out`` names checks that cannot be made,
    with the reason. ``settings`` has other settings of the module, and ``poses`` its taught places;
    ``regrip`` among them is the place where the grip is changed. ``supplies`` has the level of each resource.
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

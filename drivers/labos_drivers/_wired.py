"""Devices at the end of a wire: blocking commands, called off the event loop.

A driver is a subclass of ``Wired`` whose methods block; those that a node calls are marked
``@off_loop`` and become awaitable. They run one after the other in one thread, so a device is never
asked two things at once, and the node's loop never waits for a wire.
"""

from __future__ import annotations

import asyncio
import functools
import threading
from collections.abc import Callable, Coroutine, Iterator
from contextlib import contextmanager, suppress
from typing import Any, Concatenate, ParamSpec, TypeVar

from labos.errors import DeviceError
from labos.node import Setup
from labos.node.worker import Worker
from labos_drivers._onwire import OnWire

D = TypeVar("D", bound="Wired")
P = ParamSpec("P")
S = TypeVar("S")
T = TypeVar("T")

CLOSE_S = 1.0


def off_loop(
    method: Callable[Concatenate[D, P], T],
) -> Callable[Concatenate[D, P], Coroutine[Any, Any, T]]:
    """A blocking method as one that is awaited."""

    @functools.wraps(method)
    async def call(self: D, /, *args: P.args, **kwargs: P.kwargs) -> T:
        result: T = await self.run(functools.partial(method, self, *args, **kwargs))
        return result

    return call


def aside(
    method: Callable[Concatenate[D, P], T],
) -> Callable[Concatenate[D, P], Coroutine[Any, Any, T]]:
    """A blocking question that the device answers in mid-motion: it does not wait for the motion."""

    @functools.wraps(method)
    async def call(self: D, /, *args: P.args, **kwargs: P.kwargs) -> T:
        result: T = await self.ask(functools.partial(method, self, *args, **kwargs))
        return result

    return call


class Wired:
    """Base of drivers. ``simulator`` is the simulated device behind the wire, if there is one."""

    def __init__(self, setup: Setup, simulator: OnWire | None = None) -> None:
        self.name = setup.name
        self.run = Worker(f"{setup.name} driver")
        self.ask = Worker(f"{setup.name} questions")
        self.moving = False
        self._simulator = simulator
        self._halted = threading.Event()

    def stop(self) -> None:
        """Nothing more is sent until a reset. What a device without a stop command has begun, it
        ends. Raises DeviceError, for who stopped it must know that."""
        self._halted.set()
        if self.moving:
            raise DeviceError(
                f"{self.name} takes no stop over its wire; it ends what it has begun.",
                remedy="Use the button or switch on the device.",
            )

    async def close(self) -> None:
        """Let go of the wire. A question that is under way in the driver's thread holds on to it, and
        must not keep the node from ending."""
        with suppress(TimeoutError):
            await asyncio.wait_for(self.ask(self.disconnect), CLOSE_S)
        self.run.close()
        self.ask.close()
        if self._simulator is not None:
            self._simulator.close()

    async def connect(self) -> None:
        """Find the device. Raises NotConnected, WrongDevice."""
        raise NotImplementedError

    def disconnect(self) -> None:
        """Close the link."""
        raise NotImplementedError

    def unless_stopped(self, effects: str = "none") -> None:
        """Raise DeviceError if the device was stopped; asked before each command that moves."""
        if self._halted.is_set():
            raise DeviceError(f"{self.name} was stopped.", effects=effects, remedy="Reset it.")

    def resume(self) -> None:
        """A reset ends a stop."""
        self._halted.clear()

    @contextmanager
    def under_way(self) -> Iterator[None]:
        """A motion has begun: whatever goes wrong from now on, nobody can say that nothing moved. A
        line that fails before a question knows only of that question."""
        try:
            yield
        except DeviceError as error:
            if error.effects == "none":
                error.effects = "unknown"
            raise

    @contextmanager
    def motion(self) -> Iterator[None]:
        """The device is at work."""
        self.unless_stopped()
        self.moving = True
        try:
            yield
        finally:
            self.moving = False


def port_of(setup: Setup, example: str = "/dev/ttyUSB0") -> str:
    """The port that the workcell names for this module. Raises DeviceError."""
    port = setup.config.get("port")
    if not isinstance(port, str) or not port:
        raise DeviceError(
            f"{setup.name}: the workcell names no port for this device.",
            effects="none",
            remedy=f"Write `config: {{port: {example}}}` for the module, or start with --simulate.",
        )
    return port


async def open_device(
    setup: Setup,
    simulated: Callable[[Setup], S],
    on_wire: Callable[[Setup], OnWire],
    driver: Callable[[Setup, str, OnWire | None], D],
) -> S | D:
    """The device of a node: simulated on the bench, simulated behind its wire, or real. Raises
    DeviceError if it is not there."""
    if setup.world is None:
        device = driver(setup, port_of(setup), None)
    elif not setup.wire:
        return simulated(setup)
    else:
        simulator = on_wire(setup)
        simulator.start()
        device = driver(setup, simulator.address, simulator)
    try:
        await device.connect()
    except BaseException:
        await device.close()
        raise
    return device

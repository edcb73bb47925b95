"""What simulated devices share: lab time, durations that vary, and lids or drawers on the simulated bench.

Neither this module nor any ``simulator.py`` knows of effects or occupancy. A device knows its places, its
hand and the physics of the world. So a test can compare the world with the log.
"""

from __future__ import annotations

import asyncio
import math
import random  # noqa: TID251 (seeded by Setup: the same seed gives the same jitter)
from collections.abc import Awaitable, Callable, Iterator
from contextlib import contextmanager
from typing import Any, Protocol, TypeVar

from labos.node import DeviceError, Node, Setup
from labos.node.world import lid_of
from labos_drivers._refusals import Refusing, make_refusal

T = TypeVar("T")

JITTER = 0.1
"""Real durations scatter by this fraction about the nominal one."""


class Simulated(Refusing):
    """A device on the simulated bench. Raises DeviceError if there is no bench."""

    drawers: tuple[str, ...] = ()
    """Places that are out of reach while the device works on them, and out when it starts."""

    def __init__(self, setup: Setup) -> None:
        if setup.world is None:
            raise make_refusal(
                setup.name,
                "there is no simulated bench for this device",
                "Start the node with --simulate; this driver drives no real device yet.",
            )
        self.name = setup.name
        self.world = setup.world
        self.config = setup.config
        self.moving = False
        self._setup = setup
        self._halted = False
        self._random = random.Random(f"{setup.seed}/{setup.name}")
        self._pause: asyncio.Future[None] | None = None
        self.open(*self.drawers)
        self.world.leave(self.name)

    def place(self, name: str) -> str:
        return place_of(self._setup, name)

    async def take_time(self, nominal_s: float) -> None:
        """Wait about this number of lab seconds. Raises DeviceError if the device is stopped meanwhile."""
        pace = self._setup.pace
        self._pause = pause = asyncio.ensure_future(asyncio.sleep(self.scatter(nominal_s) / pace))
        try:
            await asyncio.wait({pause})
        finally:
            pause.cancel()
        if self._halted:
            raise DeviceError(f"{self.name} was stopped in mid-motion.", remedy="Look at it, then reset.")

    def read_clock(self) -> float:
        """Lab time (s) by the clock of this computer. Only the difference of two readings has a meaning."""
        return asyncio.get_running_loop().time() * self._setup.pace

    def scatter(self, nominal_s: float) -> float:
        """A random duration (s) near the nominal one, because the durations of real devices vary."""
        return nominal_s * self._random.uniform(1 - JITTER, 1 + JITTER)

    @contextmanager
    def motion(self, *, drawn_in: bool = False) -> Iterator[None]:
        """The device is at work. With ``drawn_in``, its drawers are shut: hands that reach for them crash.

        After an error that the device reports, the drawers come out. A device that was stopped, has
        crashed or was switched off stays as it is until it is reset or started again. Raises DeviceError if
        the device is stopped or busy.
        """
        if self._halted:
            raise DeviceError(f"{self.name} is stopped.", effects="none", remedy="Reset it.")
        if self.moving:
            raise DeviceError(f"{self.name} is busy.", effects="none", remedy="Wait until it is idle.")
        self.moving = True
        self.world.enter(self.name, self.name)
        try:
            if drawn_in:
                self.shut(*self.drawers)
            yield
            self.open(*self.drawers if drawn_in else ())
            self.world.leave(self.name)
        except DeviceError:
            if not self._halted:
                self.open(*self.drawers if drawn_in else ())
                self.world.leave(self.name)
            raise
        finally:
            self.moving = False

    def shut(self, *places: str) -> None:
        """Close a lid over these places of the device, or draw in the drawer with them."""
        for place in map(self.place, places):
            self.world.gate(self.name, place, shut=True)

    def open(self, *places: str) -> None:
        for place in map(self.place, places):
            if self.world.is_shut(place):
                self.world.gate(self.name, place, shut=False)

    def shut_at_start(self, *places: str) -> None:
        """Shut these places, as shipped. Does nothing if the device has opened or shut a place before."""
        moved = (motion for verb in ("open", "shut") for motion in self.world.motions(verb))
        if not any(motion.device == self.name for motion in moved):
            self.shut(*places)

    def furnish(self, capacity: int, *places: str) -> None:
        """Give these places of the device room for ``capacity`` plates, unless the bench has done this."""
        for place in map(self.place, places):
            if not self.world.is_furnished(place):
                self.world.furnish(place, capacity)

    def top(self, place: str) -> str:
        """The topmost plate at a place; empty if there is none."""
        plates = self.world.at(place)
        return plates[-1] if plates else ""

    def find_held_plate(self) -> str:
        """The plate in the device's hand; empty if there is none."""
        return self.top(f"hand:{self.name}")

    def is_waste(self, place: str) -> bool:
        chutes = {self.place(name) for name in self.config.get("waste", ())}
        return place in chutes or place.rpartition(".")[2].lower() in ("trash", "waste")

    def open_hand(self, place: str, grip: str = "") -> None:
        """Open the hand at a place. At a waste, the plate is discarded."""
        if self.is_waste(place):
            self.world.discard(self.name, place)
        else:
            self.world.release(self.name, place, grip)

    def is_sealed(self, plate: str) -> bool:
        return self.world.last(plate, "seal", "peel") == "seal"

    def is_lidded(self, plate: str) -> bool:
        return bool(self.world.at(lid_of(plate)))

    def crash_if_sealed(self, place: str, what: str) -> None:
        """Record a crash if the plate at a place has a seal. Raises Crash."""
        plate = self.top(place)
        if plate and self.is_sealed(plate):
            self.world.crash(self.name, place, what)

    def crash_if_lidded(self, place: str, what: str) -> None:
        """Record a crash if the plate at a place has its lid on. Raises Crash."""
        plate = self.top(place)
        if plate and self.is_lidded(plate):
            self.world.crash(self.name, place, what)

    def is_idle(self) -> bool:
        return not self.moving

    def stop(self) -> None:
        """Stop all motion at once. The hand keeps what it holds."""
        self._halted = True
        if self._pause is not None:
            self._pause.cancel()

    def reset(self) -> None:
        """End a stop of the device. Its drawers come out."""
        self._halted = False
        self.open(*self.drawers)
        self.world.leave(self.name)

    def observe(self) -> dict[str, Any]:
        """The readings of the device's own sensors, in the form of ``Node.observe``."""
        return {}

    def close(self) -> None:
        """Switch the device off."""


def place_of(setup: Setup, name: str) -> str:
    """The bench's name of a place: ``module.place``, without the workcell. A name without a module is a place
    of the device itself."""
    bare = name.rpartition("/")[2].replace(".positions.", ".")
    return bare if "." in bare or ":" in bare else setup.place(bare)


class Settling:
    """A quantity that approaches its goal like a first-order system, with the time constant ``settles_s``.
    ``clock`` returns lab time (s)."""

    def __init__(self, start: float, settles_s: float, clock: Callable[[], float]) -> None:
        self.goal = self._from = start
        self._settles_s, self._clock, self._since_s = settles_s, clock, clock()

    def now(self) -> float:
        passed_s = self._clock() - self._since_s
        return self.goal + (self._from - self.goal) * math.exp(-passed_s / self._settles_s)

    def aim(self, goal: float) -> None:
        self._from, self._since_s, self.goal = self.now(), self._clock(), goal


class Gated(Simulated):
    """A device with a lid, hood or carrier, which stays where it is when the power fails."""

    behind: tuple[str, ...] = ("default",)
    variable = "lid"
    gate_s = 20.0

    async def open_gate(self) -> None:
        with self.motion():
            await self.take_time(self.gate_s)
            self.open(*self.behind)

    async def close_gate(self) -> None:
        with self.motion():
            self.shut(*self.behind)
            await self.take_time(self.gate_s)

    def check_closed(self) -> None:
        """Check that the lid is closed. Raises DeviceError if it is open; nothing has moved then."""
        if not self.is_closed():
            raise self.make_refusal(f"the {self.variable} is open", f"Close the {self.variable} first.")

    def is_closed(self) -> bool:
        return self.world.is_shut(self.place(self.behind[0]))

    def observe(self) -> dict[str, Any]:
        return {self.variable: "closed" if self.is_closed() else "open"}


class Device(Protocol):
    """The methods of a device that its node calls. The device is simulated or at the end of a wire."""

    def is_idle(self) -> bool | Awaitable[bool]: ...

    def reset(self) -> Awaitable[None] | None: ...

    def stop(self) -> Awaitable[None] | None: ...

    def observe(self) -> dict[str, Any] | Awaitable[dict[str, Any]]: ...

    def close(self) -> Awaitable[None] | None: ...


class Instrument(Node):
    """A node that talks to one device, ``self.device``, which its ``connect`` opens."""

    device: Device

    async def is_idle(self) -> bool:
        return await await_answer(self.device.is_idle())

    async def reset(self) -> None:
        await await_answer(self.device.reset())

    async def stop(self) -> None:
        await await_answer(self.device.stop())

    async def observe(self) -> dict[str, Any]:
        return await await_answer(self.device.observe())

    async def close(self) -> None:
        if hasattr(self, "device"):  # there is none if `connect` failed
            await await_answer(self.device.close())


async def await_answer(answer: T | Awaitable[T]) -> T:
    """The answer. If it is awaitable, it is awaited first."""
    return await answer if isinstance(answer, Awaitable) else answer

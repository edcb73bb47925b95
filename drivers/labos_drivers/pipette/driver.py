"""Drives the plunger of a pipette over its serial line, or through the arm that carries it."""

from __future__ import annotations

import re
import time
from typing import Annotated, Any

import msgspec

from labos.errors import DeviceError, Garbled, LinkError
from labos.link import Link, TcpWire, Wire
from labos.node import Setup
from labos.node.node import note_handle
from labos_drivers._limits import make_serial_wire, read_setting
from labos_drivers._refusals import make_refusal
from labos_drivers._wired import DeviceOnWire, Wired, during_motion, off_loop, parse_host_port
from labos_drivers.pipette import protocol
from labos_drivers.pipette.protocol import Answer, Kind

ANSWER_S, POLL_S, LOST_S = 2.0, 0.1, 10.0
START_S, EJECT_S, SLACK_S = 30.0, 10.0, 5.0
WHO = "a pump that speaks DT"
StrokeUl = Annotated[float, msgspec.Meta(gt=0, le=5000)]


class Stroke(msgspec.Struct, frozen=True):
    """Start and target of a stroke of the plunger, in steps. It is journalled. So after a restart, the driver
    can determine from the position how far the plunger moved."""

    start: int
    target: int

    def __str__(self) -> str:
        return f"{self.start}:{self.target}"

    @classmethod
    def read(cls, handle: str) -> Stroke:
        start, _, target = handle.partition(":")
        return cls(int(start), int(target))


class PipetteDriver(Wired):
    """Moves are absolute. So the position of the plunger afterwards shows how far it moved in a stroke. There
    is no sensor for liquid: only the position of the plunger is known."""

    deadlines = ("answer", "lost", "start", "eject", "slack")
    where = ("port", "192.168.0.40")
    link: Link

    def __init__(self, setup: Setup, address: str, simulator: DeviceOnWire | None = None) -> None:
        super().__init__(setup, address, simulator)
        self._kind = read_kind(setup)
        self.link = Link(
            self._wire(setup, address),
            protocol.Frames(),
            name=setup.name,
            identify=self._recognise,
            expected=WHO,
        )

    @staticmethod
    def _wire(setup: Setup, address: str) -> Wire:
        if address.startswith("/") or "://" in address or re.fullmatch(r"COM\d+", address):
            return make_serial_wire(setup, address, baudrate=protocol.BAUDRATE)
        return TcpWire(*parse_host_port(address, protocol.TOOL_PORT))

    # -- strokes -----------------------------------------------------------------------------

    async def aspirate(self, volume_ul: float, speed_ul_s: float) -> float:
        return await self._move(volume_ul, speed_ul_s)

    async def dispense(self, volume_ul: float, speed_ul_s: float) -> float:
        return await self._move(-volume_ul, speed_ul_s)

    async def _move(self, change_ul: float, speed_ul_s: float) -> float:
        """Move the plunger; returns the drawn-up volume after the stroke (µL)."""
        stroke = await self.plan(change_ul)
        await note_handle(str(stroke))
        return await self.carry_out(stroke, speed_ul_s)

    @off_loop
    def plan(self, change_ul: float) -> Stroke:
        """Plan a stroke; nothing moves. Raises DeviceError for a volume that is not possible."""
        self.check_not_stopped()
        with self.report_no_effects():
            here = self._read_position()
        target = here + round(change_ul / self._ul_a_step)
        if not 0 <= target <= self._kind.steps:
            raise self.make_refusal(
                f"{here * self._ul_a_step:.4g} of {self._kind.volume_ul:g} µL are drawn up; "
                f"{abs(change_ul):g} µL cannot be {'aspirated' if change_ul > 0 else 'dispensed'}",
                "Ask for less, or empty it first.",
            )
        return Stroke(here, target)

    @off_loop
    def carry_out(self, stroke: Stroke, speed_ul_s: float) -> float:
        """Start a stroke and wait for its end. Returns the drawn-up volume (µL)."""
        steps_s = round(speed_ul_s / self._ul_a_step)
        steps_s = min(max(steps_s, protocol.SLOWEST_STEPS_S), protocol.FASTEST_STEPS_S)
        with self.motion():
            limit_s = abs(stroke.target - stroke.start) / steps_s + self.limit_s("slack", SLACK_S)
            try:
                self._order(f"V{steps_s}A{stroke.target}")
            except LinkError as error:
                if error.effects == "none":
                    raise
                # The position shows whether the pump got the command. If not, the command may still arrive.
                with self.assume_motion():
                    return self._await_end(stroke, limit_s)
            return self._await_end(stroke, limit_s)

    @off_loop
    def follow(self, handle: str) -> float:
        """Wait for the end of a stroke that was planned earlier and perhaps begun. Returns the drawn-up
        volume (µL)."""
        with self.motion():
            stroke = Stroke.read(handle)
            return self._await_end(
                stroke,
                abs(stroke.target - stroke.start) / protocol.SLOWEST_STEPS_S + self.limit_s("slack", SLACK_S),
            )

    def _await_end(self, stroke: Stroke, limit_s: float) -> float:
        with self.assume_motion():
            self._await_rest(limit_s)
            here = self._read_position()
            self._check_initialised(here)
        if here == stroke.target:
            return round(here * self._ul_a_step, 2)
        moved = abs(here - stroke.start) * self._ul_a_step
        raise DeviceError(
            f"{self.name}: the plunger has moved {moved:.4g} of "
            f"{abs(stroke.target - stroke.start) * self._ul_a_step:.4g} µL.",
            effects="partial" if here != stroke.start else "none",
            remedy="Look at the tip, then reset the module; a reset empties it.",
        )

    def _await_rest(self, limit_s: float) -> None:
        """Wait until the plunger stands still. While the link fails, the pump is asked again for the time
        ``lost``. Raises DeviceError."""
        deadline = time.monotonic() + limit_s
        lost_s = self.limit_s("lost", LOST_S)
        while True:
            answer = self.ask_again(lambda: self._ask("Q"), lost_s, POLL_S)
            self._check_answer(answer, "it moved", "unknown")
            if answer.ready:
                return
            if time.monotonic() > deadline + lost_s:
                raise DeviceError(f"{self.name}: the plunger has not come to rest within {limit_s:.0f} s.")
            time.sleep(POLL_S)

    def _check_initialised(self, here: int) -> None:
        """Check that the pump is initialised. After a loss of power it reports position zero, wherever the
        plunger is. The check is a command to move to ``here``, so nothing moves. Raises DeviceError."""
        self._check_answer(self._ask(f"A{here}R"), "it was asked where it is", "unknown")
        self._await_rest(self.limit_s("slack", SLACK_S))

    # -- the device itself -------------------------------------------------------------------

    @off_loop
    def initialise(self) -> None:
        """Move the plunger to its end: all drawn-up liquid comes out."""
        with self.motion():
            self._initialise()

    def _initialise(self) -> None:
        self._order(self._kind.initialise)
        with self.assume_motion():
            self._await_rest(self.limit_s("start", START_S))
            self._check_initialised(self._read_position())

    @off_loop
    def eject_tip(self) -> None:
        if not self._kind.eject:
            raise self.make_refusal(
                "this pump has no ejector", "Let the arm strip the tip off: run its program for that."
            )
        with self.motion():
            self._order(self._kind.eject)
            with self.assume_motion():
                self._await_rest(self.limit_s("eject", EJECT_S))

    @during_motion
    def read_volume(self) -> float:
        return round(self._read_position() * self._ul_a_step, 2)

    @off_loop
    def reset(self) -> None:
        self.resume()
        self._initialise()

    @during_motion
    def stop(self) -> None:
        """Stop the plunger where it is."""
        self._halted.set()
        self._order("T", run="")

    @during_motion
    def is_idle(self) -> bool:
        return self._ask("Q").ready

    @during_motion
    def observe(self) -> dict[str, Any]:
        """Check that the pump replies. Always empty: there is no sensor for a tip or for liquid."""
        self._ask("Q")
        return {}

    # -- one question ------------------------------------------------------------------------

    @property
    def _ul_a_step(self) -> float:
        return self._kind.volume_ul / self._kind.steps

    def _read_position(self) -> int:
        answer = self._ask("?")
        self._check_answer(answer, "it was asked where it is", "unknown")
        if not re.fullmatch(r"\d{1,6}", answer.data):
            raise Garbled(f"{self.name}: {answer.data!r} is no position of a plunger.")
        return int(answer.data)

    def _order(self, commands: str, run: str = "R") -> None:
        """Send commands. Raises DeviceError if the pump refuses them; nothing moves then."""
        self._check_answer(self._ask(commands + run), f"it was told {commands}", "none")

    def _check_answer(self, answer: Answer, when: str, effects: str) -> None:
        if answer.error:
            why = protocol.MEANINGS.get(answer.error, "an unknown error")
            raise DeviceError(
                f"{self.name}: pump error {answer.error} when {when}: {why}.",
                effects=effects,
                remedy="Look at the pipette, then reset the module; a reset empties it.",
            )

    def _ask(self, question: str) -> Answer:
        return protocol.read(self.link.exchange(question.encode(), self.limit_s("answer", ANSWER_S)))

    def _recognise(self, link: Link) -> str:
        protocol.read(link.exchange(b"Q", self.limit_s("answer", ANSWER_S)))
        return WHO


def read_kind(setup: Setup) -> Kind:
    """The kind of pump, from ``kind:`` of the config, with the volume of a full stroke (µL) from
    ``volume_ul:``. Raises DeviceError."""
    named = setup.config.get("kind", "z_pump")
    if named not in protocol.KINDS:
        raise make_refusal(
            setup.name,
            f"there is no pump of kind {named!r}",
            f"Write `kind:` as one of {', '.join(protocol.KINDS)}.",
        )
    kind = protocol.KINDS[named]
    return kind._replace(volume_ul=read_setting(setup, "volume_ul", kind.volume_ul, StrokeUl))

"""The driver of Barty's pumps, through the pigpio daemon of its Raspberry Pi."""

from __future__ import annotations

import secrets
import time
from contextlib import nullcontext, suppress
from typing import Any

import msgspec

from labos.errors import DeviceError, Garbled, LinkError
from labos.link import Link, TcpWire
from labos.node import Setup, assume_motion
from labos.node.node import note_handle
from labos_drivers._refusals import make_refusal
from labos_drivers._wired import DeviceOnWire, Wired, during_motion, off_loop, parse_host_port
from labos_drivers.barty import protocol
from labos_drivers.barty.protocol import PINS

ANSWER_S, POLL_S, LOST_S = 3.0, 0.2, 30.0
"""How long the daemon may be out of reach while a pump runs; it stops the pump by itself."""

LONGEST_S = 120.0
SLACK_S = 5.0
LEAST_ML, MOST_ML = 0.1, 150.0
"""A reservoir holds 150 mL."""
WHO = "a pigpio daemon"


class Dose(msgspec.Struct, frozen=True):
    """A dose in the daemon: the number of its script, and the mark in the script's parameters."""

    script: int
    owner: int

    def __str__(self) -> str:
        return f"{self.script}:{self.owner}"

    @classmethod
    def read(cls, handle: str) -> Dose:
        script, _, owner = handle.partition(":")
        return cls(int(script), int(owner))


class BartyDriver(Wired):
    """A dose is checked, stored, journalled and started. Then the driver polls it until the daemon reports
    its end. There is no flow sensor: only the time for which a motor was enabled is known."""

    deadlines = ("answer", "lost")
    where = ("host", "192.168.0.50")
    link: Link

    def __init__(self, setup: Setup, address: str, simulator: DeviceOnWire | None = None) -> None:
        super().__init__(setup, address, simulator)
        self._ml_per_s = read_rates(setup)
        self._dose: Dose | None = None
        host, port = parse_host_port(address, protocol.PORT)
        self.link = Link(
            TcpWire(host, port),
            protocol.Framing(),
            name=setup.name,
            identify=lambda _: self._recognise(),
            expected=WHO,
        )

    # -- doses -------------------------------------------------------------------------------

    async def fill(self, pumps: list[int], amount_ml: float) -> None:
        await self._pump(pumps, amount_ml, fill=True)

    async def drain(self, pumps: list[int], amount_ml: float) -> None:
        await self._pump(pumps, amount_ml, fill=False)

    async def _pump(self, pumps: list[int], amount_ml: float, *, fill: bool) -> None:
        """Run the pumps: those with the same rate at the same time, the groups one after the other."""
        rates = sorted({self._ml_per_s[pump] for pump in pumps})
        if (longest_s := amount_ml / rates[0]) > LONGEST_S:
            raise self.make_refusal(
                f"that would take {longest_s:.0f} s; no pump runs longer than {LONGEST_S:g} s",
                "Ask for less at a time.",
            )
        for number, rate in enumerate(rates):
            group = [pump for pump in pumps if self._ml_per_s[pump] == rate]
            with assume_motion() if number else nullcontext():
                await self._give_dose(group, amount_ml / rate, fill=fill)

    async def _give_dose(self, pumps: list[int], seconds: float, *, fill: bool) -> None:
        dose = await self.store(pumps, seconds, fill=fill)
        await note_handle(str(dose))
        await self.carry_out(dose)

    @off_loop
    def store(self, pumps: list[int], seconds: float, *, fill: bool) -> Dose:
        """Store the script of a dose. No motor turns: a stored script does not run before its start."""
        self.check_not_stopped()
        owner = secrets.randbelow(2**31 - 1) + 1
        script = protocol.write_script(pumps, max(round(seconds * 1000), 1), owner, fill=fill)
        with self.report_no_effects():
            if not self._is_at_rest():
                raise DeviceError(f"{self.name}: a pump runs already.", remedy="Wait, or reset the module.")
            self._delete_last()
            number = self._ask(protocol.PROC, more=script.encode())[0]
            if number == protocol.NO_ROOM:
                self._delete_ended()
                number = self._ask(protocol.PROC, more=script.encode())[0]
        if number < 0:
            raise self.make_refusal(
                f"the daemon does not take the dose (error {number})",
                "Restart pigpiod on the Raspberry Pi, then reset the module.",
            )
        return Dose(number, owner)

    @off_loop
    def carry_out(self, dose: Dose) -> None:
        """Start a dose and wait for its end."""
        with self.motion():
            self._dose = dose
            try:
                result = self._ask(protocol.PROCR, dose.script)[0]
            except LinkError as error:
                if error.effects == "none":
                    raise
                # The script itself shows whether the daemon has received the start.
                self._await_end(dose)
                return
            if result < 0:
                raise self.make_refusal(f"the daemon does not start the dose (error {result})")
            self._await_end(dose)

    @off_loop
    def follow(self, handle: str) -> None:
        """Wait for the end of a dose that was stored before, and perhaps started. If it was not started, its
        script is deleted, so that it cannot start later."""
        with self.motion():
            self._dose = dose = Dose.read(handle)
            self._await_end(dose)

    def _await_end(self, dose: Dose) -> None:
        deadline = time.monotonic() + LONGEST_S + SLACK_S
        with self.assume_motion():
            while True:
                status, parameters = self._poll_script(dose)
                if parameters[protocol.BEGUN] and parameters[protocol.OWNER] != dose.owner:
                    raise self._make_forgotten_error()
                if status not in (protocol.INITING, protocol.RUNNING, protocol.WAITING):
                    break
                if time.monotonic() > deadline:
                    raise DeviceError(f"{self.name}: a pump has not stopped after {LONGEST_S:g} s.")
                time.sleep(POLL_S)
        if status not in (protocol.HALTED, protocol.FAILED):
            raise DeviceError(
                f"{self.name}: the daemon says that the dose is in the state {status}, which is not known.",
                remedy="Look whether a pump runs and how full the reservoirs are, then reset the module.",
            )
        if not parameters[protocol.BEGUN]:
            # A deleted script cannot be started later.
            with suppress(LinkError):
                self._delete_last()
            raise self.make_refusal("the pumps were not started")
        if not parameters[protocol.ENDED]:
            raise DeviceError(
                f"{self.name}: the pumps were stopped before the dose was done.",
                effects="partial",
                remedy="Look how much ink is in the reservoirs, then reset the module.",
            )

    def _delete_last(self) -> None:
        """Delete the script of the last dose. It is kept until the next dose, so that its end can be read
        after a restart of the node."""
        last, self._dose = self._dose, None
        if last is not None:
            self._ask(protocol.PROCD, last.script)

    def _delete_ended(self) -> None:
        """Delete the ended scripts that earlier nodes have left."""
        for script in range(protocol.ROOM):
            result, more = self._ask(protocol.PROCP, script)
            if result != protocol.STATUS.size:
                continue
            status, *parameters = protocol.STATUS.unpack(more)
            if status == protocol.HALTED and parameters[protocol.ENDED] and parameters[protocol.OWNER]:
                self._ask(protocol.PROCD, script)

    # -- the device itself -------------------------------------------------------------------

    @during_motion
    def stop(self) -> None:
        """Stop all motors immediately."""
        self._halted.set()
        self._stop_all()

    @off_loop
    def reset(self) -> None:
        self._stop_all()
        self.resume()

    @during_motion
    def is_idle(self) -> bool:
        return self._is_at_rest()

    @during_motion
    def observe(self) -> dict[str, Any]:
        """Nothing is reported: Barty has no sensor of level or flow. Raises LinkError."""
        self._is_at_rest()
        return {}

    def _is_at_rest(self) -> bool:
        return not any(self._ask(protocol.READ, pins.enable)[0] for pins in PINS)

    def _stop_all(self) -> None:
        dose = self._dose
        if dose is not None:
            self._ask(protocol.PROCS, dose.script)
        for pins in PINS:
            if (result := self._ask(protocol.WRITE, pins.enable, 0)[0]) < 0:
                raise DeviceError(f"{self.name}: pin {pins.enable} cannot be set (error {result}).")

    # -- one command -------------------------------------------------------------------------

    def _poll_script(self, dose: Dose) -> tuple[int, tuple[int, ...]]:
        """Status and parameters of a script. After a lost link, the daemon is asked again for ``lost`` s."""
        result, more = self.ask_again(
            lambda: self._ask(protocol.PROCP, dose.script), self.limit_s("lost", LOST_S), POLL_S
        )
        if result < 0:
            raise self._make_forgotten_error()
        if len(more) != protocol.STATUS.size:
            raise Garbled(f"{self.name}: {more!r} is no status of a script.")
        status, *parameters = protocol.STATUS.unpack(more)
        return status, tuple(parameters)

    def _make_forgotten_error(self) -> DeviceError:
        return DeviceError(
            f"{self.name}: the daemon has been restarted, and knows nothing of the dose.",
            remedy="Look how much ink is in the reservoirs, then reset the module.",
        )

    def _ask(self, command: int, p1: int = 0, p2: int = 0, more: bytes = b"") -> tuple[int, bytes]:
        """Send a command. Returns the result and the data of the reply."""
        question = protocol.make_command(command, p1, p2, more)
        answer = self.link.exchange(question, self.limit_s("answer", ANSWER_S))
        header = protocol.HEADER.unpack_from(answer)
        if header[:3] != (command, p1, p2):
            raise Garbled(f"{self.name}: {answer[:16]!r} is no answer to command {command}.")
        return header[3], answer[protocol.HEADER.size :]

    def _recognise(self) -> str:
        answer = self.link.exchange(protocol.make_command(protocol.PIGPV), self.limit_s("answer", ANSWER_S))
        command, _, _, version = protocol.HEADER.unpack_from(answer)
        return WHO if command == protocol.PIGPV and version > 0 else f"what answers {answer[:16]!r}"


def check_dose(name: str, pumps: list[int], amount_ml: float) -> None:
    """Raise DeviceError for a dose that the pumps cannot deliver."""
    why = ""
    # In Python, 1.0 and True equal 1, but they are not the number of a pump.
    if unknown := [pump for pump in pumps if type(pump) is not int or pump not in range(len(PINS))]:
        why = f"has no pump {unknown[0]}"
    elif not pumps:
        why = "was given no pump"
    elif len(set(pumps)) < len(pumps):
        why = "was given a pump twice"
    elif not LEAST_ML <= amount_ml <= MOST_ML:
        why = f"pumps {LEAST_ML:g} to {MOST_ML:g} mL at a time, not {amount_ml:g}"
    if why:
        raise DeviceError(f"{name} {why}.", effects="none", remedy="Use pumps 0 to 3, each once.")


def read_rates(setup: Setup) -> tuple[float, ...]:
    """The rate of each pump (mL/s), from ``ml_per_s:``: one number, or four. Raises DeviceError."""
    configured = setup.config.get("ml_per_s", protocol.ML_PER_S)
    rates = list(configured) if isinstance(configured, list | tuple) else [configured] * len(PINS)
    if len(rates) != len(PINS) or not all(isinstance(rate, int | float) and rate > 0 for rate in rates):
        raise make_refusal(
            setup.name,
            f"{configured!r} are no rates of {len(PINS)} pumps",
            "Write `ml_per_s:` as one number, or as a list of four.",
        )
    return tuple(float(rate) for rate in rates)

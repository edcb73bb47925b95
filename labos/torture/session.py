"""One driver under torture: its node in a process that can be killed, its device behind a line that can be
cut, its bench, and the kernel's side."""

from __future__ import annotations

import asyncio
import contextlib
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec

from labos.core.effects import AnyEffect, Requires, Sets
from labos.core.model import ActionSpec
from labos.errors import NoAnswer
from labos.node.node import Node, Setup
from labos.node.protocol import ActionReply, Outcome, SetupReply, Start
from labos.node.torture import Case, Fault, Torture, WiredDevice
from labos.node.world import World
from labos.settings import Settings
from labos.torture.bench import POLL_S, Bench, Deeds, describe_deeds, find_repeated
from labos.torture.cases import cases_of, moves_labware, works_a_gate
from labos.torture.kernel import Kernel
from labos.torture.relay import Relay
from labos.torture.relay_http import open_relay

WORKCELL, MODULE = "torture", "device"
START_S = 60.0
REST_S = 60.0
END_S = 120.0
"""The longest time, also on a slow machine, for a node to start, a device to come to rest, or an action to
end."""


SHARE = 0.4
"""The part of a motion after which it is interrupted if its driver names no moment."""

LEAST_SHARE = 0.2
"""A device that records a motion before this part of it counts as recording it at its start."""

TRIES = 3
"""The number of attempts to interrupt a motion, because on a busy machine a motion may end before."""


DEPTH = 6
"""The longest chain of actions that each need another one before."""


class Failed(Exception):
    """The driver does not fulfil a requirement for all drivers."""


class LeftOut(Exception):
    """The check is not possible for this driver."""


class Attempt(msgspec.Struct, frozen=True):
    """One attempt at an action: the request, the end of the motion log at that moment, and the node's first
    reply."""

    case: Case
    start: Start
    since: int
    reply: ActionReply


class Session:
    """``reference`` has the motions of each action without faults. ``sights`` are the driver's observations
    and the truth after unknown outcomes. ``orders`` are the messages that the driver sends only during a
    motion. ``took_s`` is the duration of an action by its node, and ``moved_s`` the time of the last of its
    ``motions`` on the bench, because a driver may wait long after its device has come to rest."""

    def __init__(
        self, reference: str, node: type[Node], torture: Torture, folder: Path, motion_s: float
    ) -> None:
        self.driver, self.node, self.torture = reference, node, torture
        self.about = node.describe()
        self.cases = cases_of(self.about, torture, folder)
        self.pace = max((self.spec(case).duration_s for case in self.cases), default=1.0) / motion_s
        self.motion_s = motion_s
        self.slowness = 1.0
        self.powered = True
        self._powered_until = 0
        self.start_s = 0.0
        self._asked = self._interrupted = 0
        self._rested: tuple[int | None, int] = (None, 0)
        self.settings = Settings.make(folder, "sqlite://")
        self.reference: dict[str, Deeds] = {}
        self.took_s: dict[str, float] = {}
        self.moved_s: dict[str, float] = {}
        self.motions: dict[str, int] = {}
        self.sights: list[tuple[str, bool]] = []
        self.orders: list[bytes] | None = None
        self.folder = folder
        self.device: WiredDevice | None = None
        self.relay: Relay | None = None
        self.kernel: Kernel
        self.bench: Bench
        self._process: subprocess.Popen[bytes] | None = None

    @property
    def is_wired(self) -> bool:
        return self.torture.device is not None

    @property
    def blocks(self) -> Path:
        """The file in which the node records blocks of its event loop."""
        return self.folder / "blocks.txt"

    def spec(self, case: Case) -> ActionSpec:
        spec = self.about.action(case.action)
        assert spec is not None
        return spec

    # -- start and end -----------------------------------------------------------------------

    async def open(self) -> None:
        """Lay the bench, switch the device on, connect the line. The node is started later."""
        path = self.settings.world(WORKCELL)
        path.parent.mkdir(parents=True, exist_ok=True)
        world = World(str(path))
        self.bench = Bench(world, MODULE, self.about)
        for resource, level in {**self.about.levels, **self.torture.supplies}.items():
            world.supply(MODULE, resource, level)
        config = dict(self.torture.settings)
        if self.torture.device is not None:
            self.device = self._make_device()
            self.relay = open_relay(self.device.address, self.folder)
            as_config = self.torture.config or (lambda address: {"port": address})
            config |= as_config(self.relay.address)
        setup = SetupReply(
            driver=self.about.driver,
            config=config,
            poses=self.torture.poses,
            regrip=self.torture.regrip,
            pace=self.pace,
            simulated=not self.is_wired,
        )
        self.kernel = await Kernel.open(f"{WORKCELL}/{MODULE}", setup, self.folder)

    async def close(self) -> None:
        self.kill()
        if self.relay is not None:
            self.relay.close()
        if self.device is not None:
            self.device.close()
        await self.kernel.close()
        self.bench.world.close()

    def _make_device(self) -> WiredDevice:
        assert self.torture.device is not None
        device = self.torture.device(
            Setup(
                name=MODULE,
                workcell=WORKCELL,
                world=self.bench.world,
                pace=self.pace / self.slowness,
                poses=self.torture.poses,
                regrip=self.torture.regrip,
                config=dict(self.torture.settings),
            )
        )
        device.start()
        self._asked += 1
        return device

    def switch_off(self) -> None:
        """The device loses its power."""
        assert self.relay is not None
        assert self.device is not None
        self.relay.reach("")
        self._powered_until = self.bench.mark()
        self.device.close()
        self.powered = False

    def switch_on(self) -> None:
        assert self.relay is not None
        self.device = self._make_device()
        self.relay.reach(self.device.address)
        self.powered = True

    def mend(self, fault: Fault) -> None:
        """Repair a fault that was caused, if a reset does not end it."""
        if fault.mend is not None:
            fault.mend(self.device, self.bench.world)

    def switch_off_between_answers(self) -> None:
        """The device loses its power after it has answered the last question, so that no answer is lost."""
        assert self.relay is not None
        self.relay.wait_for_device()
        self.switch_off()

    def strike(self, fault: Fault) -> None:
        """Make the device fail, in its own thread if it has one."""
        at_once = getattr(self.device, "do_at_once", None)
        if at_once is None:
            fault.strike(self.device, self.bench.world)
        else:
            at_once(lambda: fault.strike(self.device, self.bench.world))

    def slow_down(self, slowness: float) -> None:
        """Replace the device by one of its kind that is so many times slower than the first."""
        self.slowness = slowness
        rested = self._rested[0] == self._asked
        if self.powered:
            self.switch_off()
        self.switch_on()
        if rested:  # a device that was just switched on has not moved
            self._rested = (self._asked, self.bench.mark())

    async def slow_both_down(self, slowness: float) -> None:
        """Make the device slower and its driver wait longer. Both are started anew."""
        self.slow_down(slowness)
        self.kill()
        await self.await_node_gone()
        await self.start_node()
        await self.recover()

    async def start_node(self) -> None:
        """Start the node's process; returns when the node answers. Raises Failed."""
        process = self._process = self._spawn()
        began = time.monotonic()
        deadline = time.monotonic() + START_S
        while not self.kernel.node_lives:
            if process.poll() is not None or time.monotonic() > deadline:
                raise Failed(f"its node does not start: {self._read_last_words()}")
            await asyncio.sleep(0.02)
        self.kernel.journal = (await self.kernel.about()).journal
        self.start_s = max(self.start_s, time.monotonic() - began)

    def _spawn(self) -> subprocess.Popen[bytes]:
        command = [
            *(sys.executable, "-m", "labos.torture.process", self.driver, MODULE),
            *("--home", str(self.folder), "--workcell", WORKCELL, "--connect", self.kernel.endpoint),
            *("--blocks", str(self.blocks), *(() if self.is_wired else ("--simulate",))),
            *(f"--wait={place}={seconds * self.slowness}" for place, seconds in self.torture.waits.items()),
        ]
        with (self.folder / "node.log").open("ab") as log:
            return subprocess.Popen(command, stdin=subprocess.PIPE, stdout=log, stderr=log)

    def kill(self) -> None:
        """Kill the node's process."""
        process, self._process = self._process, None
        if process is not None:
            process.kill()
            process.wait()
            if process.stdin is not None:
                process.stdin.close()

    async def await_node_gone(self) -> None:
        """Wait until the bus has noticed that the node is dead."""
        deadline = time.monotonic() + START_S
        while self.kernel.node_lives and time.monotonic() < deadline:
            await asyncio.sleep(0.02)

    def _read_last_words(self) -> str:
        with contextlib.suppress(OSError):
            lines = (self.folder / "node.log").read_text("utf-8", "replace").strip().splitlines()
            return lines[-1] if lines else "it reports nothing"
        return "it reports nothing"

    # -- the bench ---------------------------------------------------------------------------

    def clear(self) -> None:
        """Remove all plates."""
        self.bench.clear()
        if self.torture.clear is not None:
            self.torture.clear(self.device, self.bench.world)

    def lay(self, case: Case) -> None:
        """Put only the labware on the bench that a case needs."""
        self.clear()
        self.bench.lay(case, self.spec(case))
        if case.prepare is not None:
            case.prepare(self.device, self.bench.world)

    # -- actions -----------------------------------------------------------------------------

    async def prepare(self, case: Case) -> None:
        """Prepare the module and the bench for a case. Raises Failed."""
        await self.fulfil(case)
        self.lay(case)

    async def begin(self, case: Case) -> Attempt:
        """Prepare the bench and the module for a case, and request its action."""
        await self.prepare(case)
        return await self.ask_for(case)

    async def ask_for(self, case: Case) -> Attempt:
        """Request the action of a case, on the bench as it is."""
        self._asked += 1
        since = self.bench.mark()
        start = self.kernel.request(case.action, case.args)
        return Attempt(case, start, since, await self.kernel.send(start))

    async def await_outcome(self, done: Attempt) -> Outcome | None:
        """Its outcome, without a look at the bench; None if it has none."""
        return done.reply.outcome or await self.kernel.outcome(done.start, END_S)

    async def end(self, done: Attempt) -> Outcome:
        """Wait for its outcome and compare that with the bench. Raises Failed."""
        outcome = await self.await_outcome(done)
        if outcome is None:
            reply = await self.kernel.ask(done.start)
            if reply.status != "interrupted":
                why = done.reply.why or f"it has not ended after {END_S:g} s"
                raise Failed(f"{done.case.action} has no outcome: {why}")
            outcome = Outcome(False, "unknown", error=reply.why)  # the driver itself reports this
        await self.judge(done, outcome)
        return outcome

    async def learn(self, done: Attempt) -> Outcome:
        """Wait for its outcome, and measure when its motions are seen on the bench. Raises Failed."""
        name, began, seen = done.case.action, time.monotonic(), self.bench.mark()
        self.moved_s[name] = 0.0
        ends = asyncio.create_task(self.end(done))
        while not ends.done():
            await asyncio.wait({ends}, timeout=POLL_S)
            if (mark := self.bench.mark()) != seen:
                seen, self.moved_s[name] = mark, time.monotonic() - began
        self.motions[name] = len(self.bench.motions(done.since))
        return await ends

    async def act(self, case: Case) -> Outcome:
        """Carry out a case from its beginning to its end. Raises Failed if it does not succeed."""
        began = time.monotonic()
        done = await self.begin(case)
        outcome = await self.end(done)
        self.took_s.setdefault(case.action, time.monotonic() - began)
        if not outcome.succeeded and not case.refused:
            raise Failed(f"{case.action} fails: {outcome.error}")
        return outcome

    async def judge(self, done: Attempt, outcome: Outcome) -> None:
        """Compare what a node says of an attempt with the bench. Raises Failed."""
        name = done.case.action
        expected = self.reference.get(key_of(done.case))
        if not outcome.succeeded:
            await self.await_rest()
            if not outcome.error:
                raise Failed(f"{name} failed without a message")
            if any(outcome.error.startswith(f"{kind}: ") for kind in _SURPRISES):
                raise Failed(f"{name} ended with an unexpected error in the driver: {outcome.error}")
        deeds = self.list_deeds(done)
        if outcome.effects == "none" and deeds:
            raise Failed(
                f"{name} reports that nothing was done, but it did: {describe_deeds(deeds)} ({outcome.error})"
            )
        if expected is None:
            return
        if outcome.effects == "all" and deeds != expected:
            raise Failed(
                f"{name} reports that all was done; it should have done {describe_deeds(expected)}, "
                f"it did {describe_deeds(deeds)}"
            )
        if twice := find_repeated(deeds, expected):
            raise Failed(
                f"{name} did more than was requested: {describe_deeds(twice)} in place of "
                f"{describe_deeds(expected)}"
            )

    def list_deeds(self, done: Attempt) -> Deeds:
        return self.bench.list_deeds(done.since, gates=works_a_gate(self.spec(done.case)))

    async def fulfil(self, case: Case, depth: int = 0) -> None:
        """Bring the module's variables to the values that the case needs, with the driver's own actions,
        which may need other actions. Raises Failed."""
        wanted = [
            (effect.variable, effect.value)
            for effect in self.bench.effects(case, self.spec(case))
            if isinstance(effect, Requires) and effect.of == "module"
        ]
        done: set[str] = set()
        for _ in range(DEPTH if wanted else 0):
            seen = await self._observe()
            # A variable that it cannot observe is set once, whatever its value was.
            unmet = [(n, v) for n, v in wanted if (seen[n] != v if n in seen else n not in done)]
            if not unmet:
                return
            done.add(unmet[0][0])
            await self._set(*unmet[0], depth)

    async def _observe(self) -> dict[str, Any]:
        seen = await self.kernel.admin("observe")
        return seen.result if seen.done and isinstance(seen.result, dict) else {}

    async def _set(self, variable: str, value: Any, depth: int) -> None:
        for case in () if depth > DEPTH else self.cases:
            effects = self.bench.effects(case, self.spec(case))
            if case.refused or not any(self._is_set_by(effect, variable, value) for effect in effects):
                continue
            await self.fulfil(case, depth + 1)
            self.lay(case)
            done = await self.ask_for(case)
            outcome = await self.await_outcome(done)
            if outcome is None or not outcome.succeeded:
                why = outcome.error if outcome is not None else done.reply.why
                raise Failed(f"{case.action} fails: {why}")
            return

    @staticmethod
    def _is_set_by(effect: AnyEffect, variable: str, value: Any) -> bool:
        return isinstance(effect, Sets) and (effect.of, effect.variable, effect.value) == (
            "module",
            variable,
            value,
        )

    # -- the motion that is interrupted ------------------------------------------------------

    def choose_motion(self) -> Case:
        """An action that is long enough to be interrupted. Raises LeftOut, Failed."""
        if not self.reference:
            raise Failed("not made: no action has its declared effects")
        names = [case for case in self.cases if not case.refused and self.spec(case).exclusive]
        if self.torture.motion:
            names = [case for case in names if case.action == self.torture.motion]
        names = [case for case in names if self.reference.get(key_of(case))]
        if not names:
            raise LeftOut("no action of it moves anything")
        return max(names, key=lambda c: (moves_labware(self.spec(c)), self.spec(c).duration_s))

    async def begin_to_middle(self, case: Case, share: float | None = None) -> Attempt:
        """Start a motion, and return while the device is moving: at the next of the driver's ``moments``, or
        after a part of its duration. Raises Failed."""
        for _ in range(TRIES):
            done = await self.begin(case)
            if done.reply.status != "accepted":
                why = done.reply.why or (done.reply.outcome.error if done.reply.outcome else "")
                raise Failed(f"{case.action} does not begin: {why}")
            if share is None and self.torture.moments:
                await self._await_moment(done)
            else:
                await asyncio.sleep((share or SHARE) * self.read_motion_s(case) * self.slowness)
            if await self.is_running(done) and not self._is_over(done):
                return done
            await self.kernel.outcome(done.start, END_S)
            await self.await_rest()
        raise Failed(f"{case.action} has ended before it can be interrupted: declare a longer `motion`")

    async def interrupt(self, case: Case, switch_off: Callable[[], None]) -> Attempt:
        """Start a motion, and switch the device off during it. If the motion has just ended, which can happen
        on a busy computer and says nothing about the driver, it is started again. Raises Failed."""
        for _ in range(TRIES):
            done = await self.begin_to_middle(case)
            switch_off()
            # An entry of the device about the loss of its power is not the end of its motion.
            if not self._is_over(done, self._powered_until):
                return done
            self.switch_on()
            await self.end(done)
            await self.recover()
        raise Failed(f"{case.action} has ended before it can be interrupted: declare a longer `motion`")

    def read_motion_s(self, case: Case) -> float:
        """How long its device moves (s) according to the bench, independent of its node's report."""
        took_s = min(self.took_s[case.action], self.motion_s)
        return self.moved_s[case.action] if self._shows_its_end(case) else took_s

    def _shows_its_end(self, case: Case) -> bool:
        took_s = min(self.took_s[case.action], self.motion_s)
        return self.moved_s[case.action] >= LEAST_SHARE * took_s

    def _is_over(self, done: Attempt, until: int | None = None) -> bool:
        """Whether all its motions have ended on the bench, whatever its node reports. Only motions up to the
        mark ``until`` count, if there is one."""
        if self.torture.moments or not self._shows_its_end(done.case):
            return False
        noted = [motion for motion in self.bench.motions(done.since) if until is None or motion.seq <= until]
        return len(noted) >= self.motions[done.case.action]

    async def _await_moment(self, done: Attempt) -> None:
        """Wait until the device is at the moment at which it is to be interrupted, or its motion is over."""
        has_come = self.torture.moments[self._interrupted % len(self.torture.moments)]
        while not has_come(self.device, self.bench.world) and await self.is_running(done):
            await asyncio.sleep(POLL_S)
        self._interrupted += 1

    async def is_running(self, done: Attempt) -> bool:
        """Whether its node reports that it is still under way."""
        return (await self.kernel.ask(done.start)).status == "running"

    async def await_rest(self) -> None:
        """Wait until nothing has moved for the duration of the longest motion. Returns at once if there was
        no request since the last rest. Raises Failed."""
        if self._rested == (self._asked, self.bench.mark()):
            return
        still_s = 1.2 * self.motion_s * self.slowness
        # On a busy computer a node starts late. Its device is slowed down accordingly, so that the wait is
        # longer.
        if not await self.bench.await_quiet(still_s, max(REST_S, 5 * still_s)):
            raise Failed("its device never comes to rest")
        self._rested = (self._asked, self.bench.mark())

    # -- recovery ----------------------------------------------------------------------------

    def repair_line(self) -> None:
        """Plug the line in, if there is one, and spoil nothing on it any more."""
        if self.relay is not None:
            self.relay.restore()
            self.relay.plug()

    async def recover(self) -> None:
        """Recover from a failure as a person does: repair the line, wait, clear the bench, reset. Raises
        Failed if the module is then not IDLE, or if the reset caused other motions."""
        self.repair_line()
        await self.await_rest()
        self.clear()
        before = self.bench.mark()
        outcome: Outcome | None = None
        deadline = time.monotonic() + REST_S
        while time.monotonic() < deadline:
            self._asked += 1
            start = self.kernel.request("reset", {})
            reply = await self.kernel.send(start)
            outcome = reply.outcome or (
                await self.kernel.outcome(start, END_S) if reply.status == "accepted" else None
            )
            if outcome is not None and outcome.succeeded:
                break
            await asyncio.sleep(0.2)
        else:
            raise Failed(f"a reset does not bring it back: {outcome.error if outcome else reply.why}")
        await self.await_idle()
        spec = self.about.action("reset")
        if (deeds := self.bench.list_deeds(before, gates=False)) and not (spec and spec.effects):
            raise Failed(f"a reset, which declares no effects, did {describe_deeds(deeds)}")

    async def await_idle(self) -> None:
        """Wait until the module is IDLE. Raises Failed."""
        if await self.kernel.await_state(lambda state: state.status == "IDLE", REST_S) is None:
            state = await self.kernel.state()
            raise Failed(f"it stays {state.status}{f': {state.error}' if state.error else ''}")

    async def check_recovers(self, case: Case) -> None:
        """Recover, and carry out a case once more. Raises Failed."""
        await self.recover()
        await self.check_works_again(case)

    async def check_works_again(self, case: Case) -> None:
        """Carry out a case once more after a recovery. Raises Failed."""
        try:
            await self.act(case)
        except Failed as error:
            raise Failed(f"after the recovery, {error}") from None

    async def make_ready(self) -> None:
        """After any earlier check, make sure that the node runs, the device is at rest and the line is whole.
        A device that had to be switched on is reset afterwards. Raises Failed."""
        self.repair_line()
        fresh = self.relay is not None and (not self.powered or self.slowness != 1.0)
        if fresh:
            self.slow_down(1.0)
        with contextlib.suppress(NoAnswer):
            if self._process is not None and self._process.poll() is None:
                state = await self.kernel.state()
                if state.status == "IDLE" and not fresh:
                    return
                with contextlib.suppress(Failed):
                    await self.recover()
                    return
        self.kill()
        await self.await_node_gone()
        if self.relay is not None:
            self.slow_down(1.0)
        self.clear()
        await self.start_node()
        await self.recover()


_SURPRISES = (
    *("TypeError", "KeyError", "AttributeError", "ValueError", "IndexError", "NameError", "RuntimeError"),
    *("AssertionError", "UnicodeDecodeError", "ZeroDivisionError", "NotImplementedError", "OSError"),
)


def key_of(case: Case) -> str:
    return f"{case.action} {sorted(case.args.items())!r}"

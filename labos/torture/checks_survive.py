"""Silver: after any failure of the device, the line or the node, the driver never reports anything false, and
it recovers."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING

from labos.node.protocol import Outcome
from labos.torture.bench import describe_deeds
from labos.torture.checks_speak import needs_a_wire
from labos.torture.observation import observe_bench
from labos.torture.session import END_S, REST_S, TRIES, Done, Failed, LeftOut, Session, case_key

if TYPE_CHECKING:
    from collections.abc import Sequence

    from labos.node.protocol import AdminReply, Outcome
    from labos.node.torture import Case, Fault
    from labos.torture.relay import Mode, Relay

HELD_S = 20.0
"""The delay of a reply that is held back, if the driver has not stopped waiting before."""

STOP_S = 10.0

MOST_ORDERS = 4
"""The number of messages that a driver sends only during a motion and whose replies are spoiled, one at a
time. The order that starts the motion is one of them."""

MENDED_S = 10.0
"""The time after which a fault during a motion is repaired, if the motion has not ended by then."""

SLOWNESS = 4.0
"""The least factor by which a device is slowed down, so that its motion takes longer than a restart of the
node."""

IDLE_TOO_SOON = "ready for new work while its device still moves"


async def state_is_true(on: Session) -> None:
    """The levels that it reports are those on the bench, and its observations without a motion are true."""
    case = on.motion()
    done = await on.begin(case)
    await on.end(done)
    await observe_bench(on, done)
    on.sights.clear()
    report = await on.kernel.resources()
    if report.error:
        raise Failed(f"resources: {report.error}")
    for resource, level in report.levels.items():
        left = on.bench.world.left("device", resource)
        if resource not in on.about.levels and resource not in on.about.units:
            raise Failed(f"resources tells of {resource}, which about does not name")
        if left is not None and abs(left - level) > max(0.02 * left, 10):
            raise Failed(f"resources says {level:g} {resource}; there are {left:g}")
    state = await on.kernel.state()
    if (state.status, state.error, state.running) != ("IDLE", "", []):
        raise Failed(f"at rest, its state is {state.status} {state.error} {state.running}")


async def device_error(on: Session) -> None:
    """An error of the device is reported as an error, with the known effects; a reset ends it."""
    if not on.torture.faults:
        raise LeftOut("TORTURE names no fault of the device")
    case = on.motion()
    for fault in on.torture.faults:
        await on.fulfil(case)
        on.lay(case)
        on.strike(fault)
        done = await on.ask_for(case)
        outcome = await on.end(done)
        if outcome.succeeded:
            raise Failed(f"{fault.name}: {case.action} says that it succeeded")
        on.mend(fault)
        await on.recover()
        await on.works_again(case)
        await _strike_in_motion(on, case, (fault,))
    if len(on.torture.faults) > 1:
        await _strike_in_motion(on, case, on.torture.faults[:2])
    await on.works_again(case)


async def _strike_in_motion(on: Session, case: Case, faults: Sequence[Fault]) -> None:
    """The report about a motion with a fault is true, and the fault can be repaired."""
    done = await on.midway(case)
    for fault in faults:
        on.strike(fault)
    await on.kernel.outcome(done.start, MENDED_S)
    for fault in faults:
        on.mend(fault)
    await _end_by_person(on, done)
    await on.end(done)
    await on.recover()


async def _end_by_person(on: Session, done: Done) -> None:
    """An action that waits for a person, also after the repair, must report this; it is then stopped. Raises
    Failed."""
    if await on.kernel.outcome(done.start, MENDED_S) is not None or not await on.runs(done):
        return
    state = await on.kernel.state()
    if state.status != "ERROR" or not state.error:
        raise Failed(f"{done.case.action} neither goes on nor ends, and nothing says why")
    await on.kernel.admin("stop", STOP_S, by="torture")


async def stop(on: Session) -> None:
    """A stop during a motion ends the motion, or reports that this is impossible; the report about the motion
    is true."""
    await _check_stop(on, "stop")


async def estop(on: Session) -> None:
    """An emergency stop during a motion is reported until a reset, and nothing starts before the reset."""
    await _check_stop(on, "estop")


async def _check_stop(on: Session, command: str) -> None:
    case = on.motion()
    expected = on.reference[case_key(case)]
    done, reply, outcome = await _stop_midway(on, case, command)
    await observe_bench(on, done)
    if not reply.done and not reply.why:
        raise Failed(f"{command} fails without a word")
    if outcome.succeeded and on.deeds(done) != expected:
        raise Failed(f"{case.action} says that it succeeded; it did {describe_deeds(on.deeds(done))}")
    if command == "estop":
        state = await on.kernel.state()
        if state.status != "ERROR" or not state.stopped_at:
            raise Failed(f"after an emergency stop its state is {state.status}")
        other = await on.ask_for(case)
        if other.reply.status != "refused":
            raise Failed(f"after an emergency stop it takes {case.action}")
    await on.recover()
    await on.works_again(case)


async def _stop_midway(on: Session, case: Case, command: str) -> tuple[Done, AdminReply, Outcome]:
    """Stop a motion; returns the motion, the answer to the stop and the outcome, with the device at rest. If
    the motion succeeded although the node reports that it was stopped, the bench shows whether it continued
    after the stop. If it had ended before the stop, the check is repeated. Raises Failed."""
    for _ in range(TRIES):
        done = await on.midway(case)
        reply = await on.kernel.admin(command, STOP_S, by="torture")
        stopped = on.bench.mark()
        outcome = await on.end(done)
        await on.at_rest()
        if not (reply.done and outcome.succeeded) or on.spec(case).by_person:
            return done, reply, outcome
        if on.bench.motions(stopped):
            raise Failed(f"{command} is said to be done, but {case.action} went on to its end")
        await on.recover()
    raise Failed(f"{case.action} is over before it can be stopped: name a longer `motion`")


async def unplug_before(on: Session) -> None:
    """With the line unplugged, an action fails without motion, and the driver reports this. With the line
    plugged in, it works."""
    case, relay = on.motion(), _line(on)
    await on.fulfil(case)
    relay.unplug()
    on.lay(case)
    done = await on.ask_for(case)
    outcome = await on.end(done)
    if outcome.succeeded or outcome.effects != "none":
        raise Failed(
            f"unplugged, {case.action} says effects = {outcome.effects}: {outcome.error or 'success'}"
        )
    await on.recover()
    await on.works_again(case)


async def unplug_during(on: Session) -> None:
    """If the line is unplugged during a motion, the action ends as failed or unknown. With the line plugged
    in, it works."""
    case, relay = on.motion(), _line(on)
    done = await on.midway(case)
    relay.unplug()
    await _settle(on, done, await on.end(done))


async def unplug_after(on: Session) -> None:
    """If the line is unplugged at rest, the node stays alive and answers. With the line plugged in, it
    works."""
    case, relay = on.motion(), _line(on)
    await on.act(case)
    relay.unplug()
    for _ in range(3):
        await on.kernel.state()
        await on.kernel.admin("observe", END_S)
        await on.kernel.resources()
    relay.plug()
    await on.recover()
    await on.works_again(case)


async def lose_reply(on: Session) -> None:
    """If a reply is lost, at the start of a motion or during it, the driver does not report an unconfirmed
    success."""
    await _spoil_reply(on, "lose")


async def garble_reply(on: Session) -> None:
    """The driver never accepts noise as an answer."""
    await _spoil_reply(on, "garble")


async def half_reply(on: Session) -> None:
    """The driver never accepts half a reply as an answer."""
    await _spoil_reply(on, "cut")


async def late_reply(on: Session) -> None:
    """A late reply is not mistaken for the answer to a later question."""
    case, relay = on.motion(), _line(on)
    for in_motion in (False, True):
        if in_motion:
            done = await on.midway(case)
            relay.spoil("hold")
        else:
            await on.fulfil(case)
            on.lay(case)
            relay.spoil("hold")
            done = await on.ask_for(case)
        await on.kernel.outcome(done.start, HELD_S)
        _did_spoil(relay)
        relay.restore()
        await _settle(on, done, await on.end(done))


async def say_unasked(on: Session) -> str:
    """A message that the device sends without a question is not mistaken for an answer."""
    case = on.motion()
    needs_a_wire(on)
    if not on.torture.unasked:
        return "its device says nothing unasked"
    for stray in on.torture.unasked:
        for order in await _orders(on):
            await _one_spoiled(on, "precede", order, stray)
    await on.works_again(case)
    return ""


async def _orders(on: Session) -> list[bytes]:
    """The messages that the driver sends only during a motion, in their order. Raises LeftOut, Failed."""
    case, relay = on.motion(), _line(on)
    if on.orders is None:
        await on.fulfil(case)
        on.lay(case)
        relay.questions.clear()
        await on.kernel.admin("observe", END_S)
        await on.recover()
        at_rest = set(relay.questions)
        on.lay(case)
        relay.questions.clear()
        await on.end(await on.ask_for(case))
        on.orders = [kind for kind in relay.questions if kind not in at_rest][:MOST_ORDERS]
    return on.orders


async def _one_spoiled(on: Session, mode: Mode, order: bytes, stray: bytes = b"") -> None:
    """Spoil the reply to one message, as soon as the driver sends the message."""
    case, relay = on.motion(), _line(on)
    await on.fulfil(case)
    on.lay(case)
    relay.spoil(mode, times=1, to=order, stray=stray)
    done = await on.ask_for(case)
    outcome = await on.end(done)
    relay.restore()
    await on.at_rest()
    await on.judge(done, outcome)
    await observe_bench(on, done)
    await on.recover()


async def _spoil_reply(on: Session, mode: Mode) -> None:
    case, relay = on.motion(), _line(on)
    await on.fulfil(case)
    on.lay(case)
    relay.spoil(mode, times=1)
    done = await on.ask_for(case)
    outcome = await on.end(done)
    _did_spoil(relay)
    await _settle(on, done, outcome)
    done = await on.midway(case)
    relay.spoil(mode)
    ends = asyncio.create_task(on.kernel.outcome(done.start, END_S))
    await on.at_rest()
    _did_spoil(relay)
    relay.restore()
    await ends
    await _settle(on, done, await on.end(done))
    for order in await _orders(on):
        await _one_spoiled(on, mode, order)
    await on.works_again(case)


def _did_spoil(relay: Relay) -> None:
    """Raises LeftOut if there was no reply to spoil."""
    if not relay.spoiled:
        raise LeftOut("its device said nothing that could be spoiled")


async def _settle(on: Session, done: Done, outcome: Outcome) -> None:
    """Repair the line after a fault; check that the device did no more than was reported, and that the driver
    observes, can be reset, and works."""
    relay = _line(on)
    relay.restore()
    relay.plug()
    await on.at_rest()
    await on.judge(done, outcome)
    await observe_bench(on, done)
    await on.recover()
    await on.works_again(done.case)


async def power_cycle(on: Session) -> None:
    """The device loses its power, at rest and during a motion, and comes back."""
    case = on.motion()
    needs_a_wire(on)
    on.switch_off()
    on.switch_on()
    await on.recover()
    await on.works_again(case)
    done = await on.interrupt(case, on.switch_off)
    await on.end(done)
    on.switch_on()
    await on.recover()
    await on.works_again(case)


async def restart(on: Session) -> None:
    """The device restarts during a motion, as by its watchdog, and answers again at once. The driver does not
    report success only because the device is at rest."""
    case = on.motion()
    needs_a_wire(on)
    done = await on.interrupt(case, on.switch_off_between_answers)
    on.switch_on()
    await on.end(done)
    await on.recover()
    await on.works_again(case)


async def power_cut(on: Session) -> None:
    """The node and the device lose their power at the same time, during a motion. Both come back, and nothing
    is repeated."""
    case = on.motion()
    needs_a_wire(on)
    done = await on.midway(case)
    on.kill()
    on.switch_off()
    await on.await_node_gone()
    on.switch_on()
    await on.start_node()
    await _check_remembers(on, done)
    outcome = await on.kernel.outcome(done.start, END_S)
    await on.at_rest()
    await _check_reconciled(on, done, outcome)
    await on.recover()
    await on.works_again(case)


async def kill_node(on: Session) -> None:
    """If the node is killed during a motion, nothing is repeated, and the new node is not idle before the
    device is at rest."""
    case = on.motion()
    if on.is_wired:
        await on.at_rest()
        await on.slow_both_down(max(SLOWNESS, 2 * on.start_s / on.motion_s))
    done = await on.midway(case, 0.1 if on.is_wired else None)
    await _kill_and_start(on, done)
    if on.is_wired:
        await on.slow_both_down(1.0)
    await on.recover()
    await on.works_again(case)
    done = await on.begin(case)  # between its journal and its device, or hardly later
    await _kill_and_start(on, done)
    await on.recover()
    for fault in on.torture.faults[:1] if on.is_wired else ():
        done = await on.midway(case)
        on.kill()
        on.strike(fault)
        await _kill_and_start(on, done, fault)
        await on.recover()
    await on.works_again(case)


async def _kill_and_start(on: Session, done: Done, fault: Fault | None = None) -> None:
    """Kill the node and start it again. A ``fault`` of the device is repaired when its node is not BUSY, or
    has waited. Raises Failed."""
    on.kill()
    await on.await_node_gone()
    await on.start_node()
    await _check_remembers(on, done)
    if fault is not None:
        await on.kernel.until(lambda state: state.status != "BUSY", MENDED_S)
        on.mend(fault)
        await _end_by_person(on, done)
        await on.at_rest()
    await on.kernel.until(lambda state: state.status != "BUSY", REST_S)
    idle = on.bench.mark()
    outcome = await on.kernel.outcome(done.start, END_S)
    await on.at_rest()
    if later := on.bench.motions(idle):
        raise Failed(f"after the kill it is {IDLE_TOO_SOON}: {later[0].verb} at {later[0].place}")
    await _check_reconciled(on, done, outcome)


async def _check_remembers(on: Session, done: Done) -> None:
    """Check that a restarted node knows the attempt. Raises Failed."""
    again = await on.kernel.send(done.start)
    if again.status not in ("interrupted", "running", "finished"):
        raise Failed(f"started again, it tells {done.case.action} as {again.status}: {again.why}")


async def _check_reconciled(on: Session, done: Done, outcome: Outcome | None) -> None:
    """Check that the outcome which a restarted node reports for an attempt is true, and that nothing was done
    twice. Raises Failed."""
    deeds, expected = on.deeds(done), on.reference[case_key(done.case)]
    if twice := {deed: n for deed, n in deeds.items() if deed in expected and n > expected[deed]}:
        raise Failed(f"started again, it did again: {describe_deeds(twice)}")
    if outcome is not None:
        await on.judge(done, outcome)
    if outcome is not None and outcome.effects in ("all", "none"):
        on.sights.append((done.case.action, True))  # by the device's own record of it
        return
    before = len(on.sights)
    await observe_bench(on, done)
    if len(on.sights) == before:
        on.sights.append((done.case.action, False))


async def event_loop(on: Session) -> None:
    """During all checks, the event loop of its node was never blocked for more than 50 ms."""
    if not on.blocks.exists():
        return
    worst = max(on.blocks.read_text("utf-8").splitlines(), key=lambda line: float(line.split("\t")[0]))
    held, _, by = worst.partition("\t")
    raise Failed(f"held for {float(held) * 1000:.0f} ms by {by}")


async def reconciles(on: Session) -> str:
    """After a fault with an unknown outcome, the driver has determined the outcome at least once, from an
    observation or from the device's own record, and correctly each time."""
    needs_a_wire(on)
    if not on.sights:
        raise LeftOut("what its motion does shows in nothing that could be observed")
    settled = sum(there for _, there in on.sights)
    if not settled:
        unknown = f"{len(on.sights)} unknown outcomes of {on.sights[0][0]}"
        raise LeftOut(f"nothing that it sees or keeps a record of settles one of {unknown}")
    return f"{settled} of {len(on.sights)} unknown outcomes"


def _line(on: Session) -> Relay:
    needs_a_wire(on)
    assert on.relay is not None
    return on.relay

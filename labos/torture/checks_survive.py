"""Silver: whatever happens to the device, the line and the node, the driver's reports are true, and it
works again afterwards."""

from __future__ import annotations

import asyncio
from collections.abc import Sequence

from labos.node.protocol import AdminReply, Outcome
from labos.node.torture import Case, Fault
from labos.torture.bench import describe_deeds, find_repeated
from labos.torture.checks_speak import require_wire
from labos.torture.observation import observe_bench
from labos.torture.relay import Mode, Relay
from labos.torture.session import END_S, REST_S, TRIES, Attempt, Failed, LeftOut, Session, key_of

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


async def check_true_state(on: Session) -> None:
    """Levels that it reports are those on the bench, and so is what it observes at rest."""
    case = on.choose_motion()
    done = await on.begin(case)
    await on.end(done)
    await observe_bench(on, done)
    on.sights.clear()
    report = await on.kernel.resources()
    if report.error:
        raise Failed(f"resources: {report.error}")
    for resource, level in report.levels.items():
        left = on.bench.world.find_level("device", resource)
        if resource not in on.about.levels and resource not in on.about.units:
            raise Failed(f"resources reports {resource}, which about does not name")
        if left is not None and abs(left - level) > max(0.02 * left, 10):
            raise Failed(f"resources reports {level:g} {resource}; there are {left:g}")
    state = await on.kernel.state()
    if (state.status, state.error, state.running) != ("IDLE", "", []):
        raise Failed(f"at rest, its state is {state.status} {state.error} {state.running}")


async def check_device_error(on: Session) -> None:
    """An error of the device is reported as an error, with the known effects; a reset ends it."""
    if not on.torture.faults:
        raise LeftOut("TORTURE names no fault of the device")
    case = on.choose_motion()
    for fault in on.torture.faults:
        await on.prepare(case)
        on.strike(fault)
        done = await on.ask_for(case)
        outcome = await on.end(done)
        if outcome.succeeded:
            raise Failed(f"{fault.name}: {case.action} reports success")
        on.mend(fault)
        await on.check_recovers(case)
        await _strike_in_motion(on, case, (fault,))
    if len(on.torture.faults) > 1:
        await _strike_in_motion(on, case, on.torture.faults[:2])
    await on.check_works_again(case)


async def _strike_in_motion(on: Session, case: Case, faults: Sequence[Fault]) -> None:
    """The report about a motion with a fault is true, and the fault can be repaired."""
    done = await on.begin_to_middle(case)
    for fault in faults:
        on.strike(fault)
    await on.kernel.outcome(done.start, MENDED_S)
    for fault in faults:
        on.mend(fault)
    await _end_by_person(on, done)
    await on.end(done)
    await on.recover()


async def _end_by_person(on: Session, done: Attempt) -> None:
    """If an action waits for a person, also after the repair, the driver must report this; the action is then
    stopped. Raises Failed."""
    if await on.kernel.outcome(done.start, MENDED_S) is not None or not await on.is_running(done):
        return
    state = await on.kernel.state()
    if state.status != "ERROR" or not state.error:
        raise Failed(f"{done.case.action} neither continues nor ends, and reports no reason")
    await on.kernel.admin("stop", STOP_S, by="torture")


async def check_stop(on: Session) -> None:
    """A stop during a motion ends the motion, or reports that this is impossible; the report about the motion
    is true."""
    await _check_stopping(on, "stop")


async def check_emergency_stop(on: Session) -> None:
    """An emergency stop during a motion is reported until a reset, and nothing starts before the reset."""
    await _check_stopping(on, "estop")


async def _check_stopping(on: Session, command: str) -> None:
    case = on.choose_motion()
    expected = on.reference[key_of(case)]
    done, reply, outcome = await _stop_midway(on, case, command)
    await observe_bench(on, done)
    if not reply.done and not reply.why:
        raise Failed(f"{command} fails without a message")
    if outcome.succeeded and on.list_deeds(done) != expected:
        raise Failed(f"{case.action} reports success; it did {describe_deeds(on.list_deeds(done))}")
    if command == "estop":
        state = await on.kernel.state()
        if state.status != "ERROR" or not state.stopped_at:
            raise Failed(f"after an emergency stop its state is {state.status}")
        other = await on.ask_for(case)
        if other.reply.status != "refused":
            raise Failed(f"after an emergency stop it accepts {case.action}")
    await on.check_recovers(case)


async def _stop_midway(on: Session, case: Case, command: str) -> tuple[Attempt, AdminReply, Outcome]:
    """Stop a motion; returns the motion, the answer to the stop and the outcome, with the device at rest. If
    the motion succeeded although the node reports that it was stopped, the bench shows whether it continued
    after the stop. If it had ended before the stop, the check is repeated. Raises Failed."""
    for _ in range(TRIES):
        done = await on.begin_to_middle(case)
        reply = await on.kernel.admin(command, STOP_S, by="torture")
        stopped = on.bench.mark()
        outcome = await on.end(done)
        await on.await_rest()
        if not (reply.done and outcome.succeeded) or on.spec(case).by_person:
            return done, reply, outcome
        if on.bench.motions(stopped):
            raise Failed(f"{command} reports success, but {case.action} went on to its end")
        await on.recover()
    raise Failed(f"{case.action} has ended before it can be stopped: declare a longer `motion`")


async def unplug_before(on: Session) -> None:
    """With the line unplugged, an action fails without motion, and the driver reports this. With the line
    plugged in, it works."""
    case, relay = on.choose_motion(), _require_relay(on)
    await on.fulfil(case)
    relay.unplug()
    on.lay(case)
    done = await on.ask_for(case)
    outcome = await on.end(done)
    if outcome.succeeded or outcome.effects != "none":
        raise Failed(
            f"unplugged, {case.action} reports effects = {outcome.effects}: {outcome.error or 'success'}"
        )
    await on.check_recovers(case)


async def unplug_during(on: Session) -> None:
    """If the line is unplugged during a motion, the action ends as failed or unknown. With the line plugged
    in, it works."""
    case, relay = on.choose_motion(), _require_relay(on)
    done = await on.begin_to_middle(case)
    relay.unplug()
    await _settle(on, done, await on.end(done))


async def unplug_after(on: Session) -> None:
    """If the line is unplugged at rest, the node stays alive and answers. With the line plugged in, it
    works."""
    case, relay = on.choose_motion(), _require_relay(on)
    await on.act(case)
    relay.unplug()
    for _ in range(3):
        await on.kernel.state()
        await on.kernel.admin("observe", END_S)
        await on.kernel.resources()
    relay.plug()
    await on.check_recovers(case)


async def lose_reply(on: Session) -> None:
    """When a reply is lost, at the beginning or in mid-motion, the driver reports no success that it did not
    see."""
    await _spoil_reply(on, "lose")


async def garble_reply(on: Session) -> None:
    """The driver never accepts noise as an answer."""
    await _spoil_reply(on, "garble")


async def cut_reply(on: Session) -> None:
    """Half a reply is never taken for an answer."""
    await _spoil_reply(on, "cut")


async def delay_reply(on: Session) -> None:
    """A late reply is not mistaken for the answer to a later question."""
    case, relay = on.choose_motion(), _require_relay(on)
    for in_motion in (False, True):
        if in_motion:
            done = await on.begin_to_middle(case)
            relay.spoil("hold")
        else:
            await on.prepare(case)
            relay.spoil("hold")
            done = await on.ask_for(case)
        await on.kernel.outcome(done.start, HELD_S)
        _check_spoiled(relay)
        relay.restore()
        await _settle(on, done, await on.end(done))


async def say_unasked(on: Session) -> str:
    """A message that the device sends without a question is not mistaken for an answer."""
    case = on.choose_motion()
    require_wire(on)
    if not on.torture.unasked:
        return "its device sends no message without a question"
    for stray in on.torture.unasked:
        for order in await _find_orders(on):
            await _spoil_one_reply(on, "precede", order, stray)
    await on.check_works_again(case)
    return ""


async def _find_orders(on: Session) -> list[bytes]:
    """The messages that its driver sends during a motion and not at rest, in order. Raises LeftOut,
    Failed."""
    case, relay = on.choose_motion(), _require_relay(on)
    if on.orders is None:
        await on.prepare(case)
        relay.questions.clear()
        await on.kernel.admin("observe", END_S)
        await on.recover()
        at_rest = set(relay.questions)
        on.lay(case)
        relay.questions.clear()
        await on.end(await on.ask_for(case))
        on.orders = [kind for kind in relay.questions if kind not in at_rest][:MOST_ORDERS]
    return on.orders


async def _spoil_one_reply(on: Session, mode: Mode, order: bytes, stray: bytes = b"") -> None:
    """Spoil the reply to one message, as soon as the driver sends the message."""
    case, relay = on.choose_motion(), _require_relay(on)
    await on.prepare(case)
    relay.spoil(mode, times=1, to=order, stray=stray)
    done = await on.ask_for(case)
    outcome = await on.end(done)
    relay.restore()
    await on.await_rest()
    await on.judge(done, outcome)
    await observe_bench(on, done)
    await on.recover()


async def _spoil_reply(on: Session, mode: Mode) -> None:
    case, relay = on.choose_motion(), _require_relay(on)
    await on.prepare(case)
    relay.spoil(mode, times=1)
    done = await on.ask_for(case)
    outcome = await on.end(done)
    _check_spoiled(relay)
    await _settle(on, done, outcome)
    done = await on.begin_to_middle(case)
    relay.spoil(mode)
    ends = asyncio.create_task(on.kernel.outcome(done.start, END_S))
    await on.await_rest()
    _check_spoiled(relay)
    relay.restore()
    await ends
    await _settle(on, done, await on.end(done))
    for order in await _find_orders(on):
        await _spoil_one_reply(on, mode, order)
    await on.check_works_again(case)


def _check_spoiled(relay: Relay) -> None:
    """Raises LeftOut if the device gave no reply that could be spoiled."""
    if not relay.spoiled_count:
        raise LeftOut("its device sent nothing that could be garbled")


async def _settle(on: Session, done: Attempt, outcome: Outcome) -> None:
    """After a fault of the line: repair it, compare the outcome with the bench, let the driver observe and
    reset, and check that it works."""
    on.repair_line()
    await on.await_rest()
    await on.judge(done, outcome)
    await observe_bench(on, done)
    await on.check_recovers(done.case)


async def power_cycle(on: Session) -> None:
    """The device loses its power, at rest and during a motion, and comes back."""
    case = on.choose_motion()
    require_wire(on)
    on.switch_off()
    on.switch_on()
    await on.check_recovers(case)
    done = await on.interrupt(case, on.switch_off)
    await on.end(done)
    on.switch_on()
    await on.check_recovers(case)


async def restart_device(on: Session) -> None:
    """The device restarts in mid-motion, as by its watchdog, and answers again at once: that it is at rest is
    not taken for success."""
    case = on.choose_motion()
    require_wire(on)
    done = await on.interrupt(case, on.switch_off_between_answers)
    on.switch_on()
    await on.end(done)
    await on.check_recovers(case)


async def cut_power(on: Session) -> None:
    """The node and the device lose their power at the same time, during a motion. Both come back, and nothing
    is repeated."""
    case = on.choose_motion()
    require_wire(on)
    done = await on.begin_to_middle(case)
    on.kill()
    on.switch_off()
    await on.await_node_gone()
    on.switch_on()
    await on.start_node()
    await _check_remembered(on, done)
    outcome = await on.kernel.outcome(done.start, END_S)
    await on.await_rest()
    await _check_reconciled(on, done, outcome)
    await on.check_recovers(case)


async def kill_node(on: Session) -> None:
    """If the node is killed during a motion, nothing is repeated, and the new node is not idle before the
    device is at rest."""
    case = on.choose_motion()
    if on.is_wired:
        await on.await_rest()
        await on.slow_both_down(max(SLOWNESS, 2 * on.start_s / on.motion_s))
    done = await on.begin_to_middle(case, 0.1 if on.is_wired else None)
    await _kill_and_start(on, done)
    if on.is_wired:
        await on.slow_both_down(1.0)
    await on.check_recovers(case)
    done = await on.begin(case)  # between its journal and its device, or shortly after
    await _kill_and_start(on, done)
    await on.recover()
    for fault in on.torture.faults[:1] if on.is_wired else ():
        done = await on.begin_to_middle(case)
        on.kill()
        on.strike(fault)
        await _kill_and_start(on, done, fault)
        await on.check_recovers(case)


async def _kill_and_start(on: Session, done: Attempt, fault: Fault | None = None) -> None:
    """Kill the node and start it again. A ``fault`` of the device is repaired when its node is not BUSY, or
    has waited. Raises Failed."""
    on.kill()
    await on.await_node_gone()
    await on.start_node()
    await _check_remembered(on, done)
    if fault is not None:
        await on.kernel.await_state(lambda state: state.status != "BUSY", MENDED_S)
        on.mend(fault)
        await _end_by_person(on, done)
        await on.await_rest()
    await on.kernel.await_state(lambda state: state.status != "BUSY", REST_S)
    idle = on.bench.mark()
    outcome = await on.kernel.outcome(done.start, END_S)
    await on.await_rest()
    if later := on.bench.motions(idle):
        raise Failed(f"after the kill it is {IDLE_TOO_SOON}: {later[0].verb} at {later[0].place}")
    await _check_reconciled(on, done, outcome)


async def _check_remembered(on: Session, done: Attempt) -> None:
    """Check that a restarted node knows the attempt. Raises Failed."""
    again = await on.kernel.send(done.start)
    if again.status not in ("interrupted", "running", "finished"):
        raise Failed(f"after the restart, it reports {done.case.action} as {again.status}: {again.why}")


async def _check_reconciled(on: Session, done: Attempt, outcome: Outcome | None) -> None:
    """Check that the outcome which a restarted node reports for an attempt is true, and that nothing was done
    twice. Raises Failed."""
    deeds, expected = on.list_deeds(done), on.reference[key_of(done.case)]
    if twice := find_repeated(deeds, expected):
        raise Failed(f"after the restart, it repeated: {describe_deeds(twice)}")
    if outcome is not None:
        await on.judge(done, outcome)
    if outcome is not None and outcome.effects in ("all", "none"):
        on.sights.append((done.case.action, True))  # by the device's own record of it
        return
    before = len(on.sights)
    await observe_bench(on, done)
    if len(on.sights) == before:
        on.sights.append((done.case.action, False))


async def check_event_loop(on: Session) -> None:
    """During all these checks, the event loop of its node was never blocked for more than 50 ms."""
    if not on.blocks.exists():
        return
    worst = max(on.blocks.read_text("utf-8").splitlines(), key=lambda line: float(line.split("\t")[0]))
    held, _, by = worst.partition("\t")
    raise Failed(f"held for {float(held) * 1000:.0f} ms by {by}")


async def check_reconciliation(on: Session) -> str:
    """After faults that left the outcome unknown, the driver has found out at least once what happened, by
    the device's sensors or its own record, and it was right each time."""
    require_wire(on)
    if not on.sights:
        raise LeftOut("no observation shows the effects of its motion")
    settled = sum(there for _, there in on.sights)
    if not settled:
        unknown = f"{len(on.sights)} unknown outcomes of {on.sights[0][0]}"
        raise LeftOut(f"neither an observation nor a record settles one of {unknown}")
    return f"{settled} of {len(on.sights)} unknown outcomes"


def _require_relay(on: Session) -> Relay:
    require_wire(on)
    assert on.relay is not None
    return on.relay

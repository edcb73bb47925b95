"""The adapter of EPICS devices, with a real IOC of ``softioc`` 4.6.1 over Channel Access and PV Access."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from tests.integration.adapter.bench import Bench
from tests.integration.adapter.scenario import play, shaker
from tests.integration.bus.contract import until
from tests.support.ioc import CaLine, Ioc, PvaLine
from tests.support.needed import need

need("aioca", "epics")

run = partial(play, limit_s=110.0)
DESCRIPTION = shaker("epics_node")
NEVER = 1000.0
"""The least target that is never reached."""
SET = [
    {"pv": "Speed", "value": "{speed}"},
    {"pv": "Label", "value": "{label}"},
    {"pv": "Mode", "value": "Rough"},
]
SHAKE = {
    "set": SET,
    "start": {"pv": "Shake", "value": "{time_s}"},
    "result": {"turns": "Turns", "mode": "Mode"},
}
MAPPING: dict[str, Any] = {
    "prefix": "SHAKER:",
    "actions": {
        "shake": SHAKE,
        "shake_by_id": {
            **SHAKE,
            "set": [*SET, {"pv": "Job", "value": "{id}"}],
            "done": {"pv": "Last", "is": "{id}"},
        },
        "travel": {
            "start": {"pv": "Target", "value": "{target}"},
            "done": [{"pv": "Position", "near": "{target}", "within": 0.01}, {"pv": "State", "is": "Idle"}],
            "result": "Position",
        },
    },
    "state": {
        "busy": {"pv": "State", "is": "Shaking"},
        "error": {"pv": "State", "is": "Error"},
        "why": "Why",
        "alarms": ["Heat"],
    },
    "reset": {"pv": "Reset"},
    "stop": {"pv": "Stop"},
    "resources": {"turns": "Turns"},
    "observe": {"mode": "Mode", "heat": "Heat"},
    "labware": {"plate": {"pv": "Plate", "is": "Present"}},
}


@pytest.fixture(scope="module")
def ioc(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Ioc]:
    device = Ioc(tmp_path_factory.mktemp("epics"))
    try:
        yield device.start()
    finally:
        device.kill()


@pytest.fixture(params=["ca", "pva"])
def line(ioc: Ioc, request: pytest.FixtureRequest) -> Iterator[CaLine]:
    line = CaLine(ioc.port) if request.param == "ca" else PvaLine(ioc.pva_port, ioc.pva_search)
    yield line
    line.close()


def on(line: CaLine) -> dict[str, Any]:
    """A device at the other end of a line."""
    protocol = "pva" if isinstance(line, PvaLine) else "ca"
    return {f"{protocol}_address": f"127.0.0.1:{line.port}", "protocol": protocol}


async def adapter(here: Bench, ioc: Ioc, **told: Any) -> Any:
    """In a process of its own, since EPICS' client library reads its environment once."""
    where = {key: told.pop(key) for key in ("ca_address", "pva_address", "patience_s") if key in told}
    config = {**ioc.config, "patience_s": 20.0, **where}
    process = await here.process("epics_node", DESCRIPTION, **config, epics={**MAPPING, **told})
    await here.idle()
    return process


@pytest.mark.parametrize("protocol", ["ca", "pva"])
def test_actions_state_alarms_and_reset(ioc: Ioc, tmp_path: Path, protocol: str) -> None:
    async def scenario(here: Bench) -> None:
        await adapter(here, ioc, protocol=protocol)
        await here.start("a1", "shake", speed=300, label=protocol)
        done = await here.outcome("a1")
        assert (done.succeeded, done.effects, done.result) == (True, "all", {"turns": 60.0, "mode": "Rough"})
        assert len(ioc.truth("shake", label=protocol)) == 1
        told = await here.start("a1", "shake", speed=300, label=protocol)
        assert told.outcome == done
        # What the put's callback does not wait for is waited for by its readback.
        await here.start("a2", "travel", target=len(protocol))
        assert (await here.outcome("a2")).result == len(protocol)
        assert ioc.truth("travelled")[-1]["target"] == len(protocol)
        seen = (await here.kernel.admin("observe")).result
        assert seen == {"mode": "Rough", "heat": 20.0, "labware": {"plate": True}}
        await here.start("a3", "shake", speed=1, label="jam")
        failed = await here.outcome("a3")
        assert (failed.succeeded, failed.effects) == (False, "unknown")
        assert "The plate is stuck." in failed.error
        assert (await here.kernel.state()).status == "ERROR"
        assert (await here.kernel.recover("a4")).succeeded
        await here.idle()
        assert (await here.kernel.admin("stop")).done
        await until(lambda: ioc.truth("stop"), 10)
        assert len(ioc.truth("shake", label=protocol)) == 1

    run(tmp_path, scenario)


@pytest.mark.slow
def test_a_put_that_is_never_answered_is_unknown(ioc: Ioc, tmp_path: Path) -> None:
    """The IOC is well, and the record hangs; nothing says that it works."""

    async def scenario(here: Bench) -> None:
        shake = {**SHAKE, "timeout": "1 s"}
        await adapter(here, ioc, state={}, actions={**MAPPING["actions"], "shake": shake})
        await here.start("a1", "shake", speed=1, time_s=4.0, label="mute")
        why = (await here.status("a1", "interrupted")).why
        assert f"Shake: the IOC at 127.0.0.1:{ioc.port} " in why
        assert "has not answered the put for 1 s" in why
        assert not ioc.truth("shaken", label="mute")
        await until(lambda: ioc.truth("shaken", label="mute"), 10)

    run(tmp_path, scenario)


@pytest.mark.slow
@pytest.mark.parametrize("protocol", ["ca", "pva"])
def test_texts_in_arrays_of_characters_and_labels(ioc: Ioc, tmp_path: Path, protocol: str) -> None:
    story = "The motor of the shaker has been switched off, for its temperature is 81 °C."
    assert len(story) > 40

    async def scenario(here: Bench) -> None:
        tell = {"start": {"pv": "Story", "value": "{label}"}, "done": {"pv": "Story", "is": "{label}"}}
        switch = {"start": {"pv": "Mode", "value": "{label}"}, "result": "Mode"}
        await adapter(
            here,
            ioc,
            protocol=protocol,
            actions={
                **MAPPING["actions"],
                "shake": {**tell, "result": {"story": "Story", "bytes": "Bytes", "image": "Image"}},
                "shake_by_id": switch,
            },
            numbers=["Bytes"],
        )
        await here.start("a1", "shake", speed=1, label=story)
        told = await here.outcome("a1")
        assert told.result["story"] == story, told
        assert [value % 256 for value in told.result["bytes"]] == [72, 105, 0, 200]
        assert told.result["image"] == [200, 201, 0, 7]
        await here.start("a2", "shake", speed=1, label="short")
        assert (await here.outcome("a2")).result["story"] == "short"
        for number, label in enumerate(("Rough", "Gentle")):
            await here.start(f"a3{number}", "shake_by_id", speed=1, label=label)
            assert (await here.outcome(f"a3{number}")).result == label
        await here.start("a4", "shake_by_id", speed=1, label="Wild")
        refused = await here.outcome("a4")
        assert (refused.succeeded, refused.effects) == (False, "none")
        assert "it has Gentle, Rough" in refused.error
        if protocol == "ca":
            await here.start("a5", "shake", speed=1, label="x" * 256)
            refused = await here.outcome("a5")
            assert (refused.succeeded, refused.effects) == (False, "none")
            assert "takes a text of 255 bytes; this one has 256" in refused.error

    run(tmp_path, scenario)


@pytest.mark.full
@pytest.mark.parametrize("protocol", ["ca", "pva"])
def test_an_alarm_is_an_error_until_it_ends(ioc: Ioc, tmp_path: Path, protocol: str) -> None:
    async def scenario(here: Bench) -> None:
        heating = {"start": {"pv": "Overheat", "value": "{target}"}}
        await adapter(here, ioc, protocol=protocol, actions={**MAPPING["actions"], "travel": heating})
        await here.start("a1", "travel", target=99.0)
        await here.in_error("Heat has an alarm (major, value 99.0)")
        assert (await here.kernel.recover("a2")).succeeded
        await here.idle()

    run(tmp_path, scenario)


@pytest.mark.full
@pytest.mark.parametrize("protocol", ["ca", "pva"])
def test_what_a_record_refuses_has_failed(ioc: Ioc, tmp_path: Path, protocol: str) -> None:
    """The IOC has answered: that is no unknown outcome."""

    async def scenario(here: Bench) -> None:
        nonsense = {"start": {"pv": "Speed", "value": "fast"}}
        await adapter(here, ioc, protocol=protocol, actions={**MAPPING["actions"], "travel": nonsense})
        await here.start("a1", "travel", target=1.0)
        failed = await here.outcome("a1")
        # Over PV Access the value is refused before it is sent.
        assert (failed.succeeded, failed.effects) == (False, "unknown" if protocol == "ca" else "none")
        assert "Speed does not accept 'fast'" in failed.error

    run(tmp_path, scenario)


@pytest.mark.full
def test_what_does_not_end_in_time_is_not_known(ioc: Ioc, tmp_path: Path) -> None:
    """It may still move: neither done nor failed."""

    async def scenario(here: Bench) -> None:
        endless = {**MAPPING["actions"]["travel"], "timeout": 1.0}
        await adapter(here, ioc, actions={**MAPPING["actions"], "travel": endless})
        await here.start("a1", "travel", target=NEVER + 10)
        told = await here.status("a1", "interrupted")
        assert "did not end within 1 s (by Position, State)" in told.why
        assert (await here.kernel.recover("a2")).succeeded
        await here.idle(40)

    run(tmp_path, scenario)


@pytest.mark.full
@pytest.mark.parametrize("action", ["shake", "shake_by_id"])
def test_a_lost_callback_never_moves_twice(ioc: Ioc, line: CaLine, tmp_path: Path, action: str) -> None:
    """The line is cut in mid-action, the device goes on: only what names the action can be found."""
    label = f"lost {action} {on(line)['protocol']}"

    async def scenario(here: Bench) -> None:
        await adapter(here, ioc, **on(line))
        await here.start("a1", action, speed=2, time_s=6.0, label=label)
        await until(lambda: len(ioc.truth("shake", label=label)) == 1, 20)
        line.cut()
        if action == "shake":
            assert "its callback was lost" in (await here.status("a1", "interrupted")).why
        else:
            assert (await here.outcome("a1", 40)).succeeded
        await here.idle(40)
        assert len(ioc.truth("shaken", label=label)) == 1
        again = await here.start("a1", action, speed=2, time_s=6.0, label=label)
        assert again.status == ("interrupted" if action == "shake" else "finished")
        await here.start("a2", action, speed=3, time_s=0.0, label=label)
        assert (await here.outcome("a2")).succeeded
        assert [told["speed"] for told in ioc.truth("shake", label=label)] == [2, 3]

    run(tmp_path, scenario)


@pytest.mark.full
@pytest.mark.parametrize("boot", ["Boot", ""], ids=["the same IOC", "no word of the IOC"])
def test_a_motion_is_waited_for_across_a_broken_line(
    ioc: Ioc, line: CaLine, tmp_path: Path, boot: str
) -> None:
    async def scenario(here: Bench) -> None:
        target = (7.0 if boot else NEVER) + (on(line)["protocol"] == "pva")
        await adapter(here, ioc, **on(line), boot=boot)
        await here.start("a1", "travel", target=target)
        await until(lambda: len(ioc.truth("travel", target=target)) == 1, 20)
        await here.await_taken()
        line.cut()
        if boot:
            assert (await here.outcome("a1", 40)).result == target
        else:
            assert "record" in (await here.status("a1", "interrupted", 40)).why
            assert (await here.kernel.recover("a2")).succeeded
        assert len(ioc.truth("travel", target=target)) == 1

    run(tmp_path, scenario)


@pytest.mark.full
@pytest.mark.timeout(200)
@pytest.mark.parametrize("protocol", ["ca", "pva"])
@pytest.mark.parametrize("action", ["shake", "travel"])
def test_an_ioc_killed_in_mid_motion(tmp_path: Path, action: str, protocol: str) -> None:
    """It is started again at once, and neither the library nor the adapter sends the put a second time."""
    ioc = Ioc(tmp_path / "ioc").start()
    args = {"speed": 5, "time_s": 30.0, "label": "died"} if action == "shake" else {"target": NEVER}

    async def scenario(here: Bench) -> None:
        await adapter(here, ioc, protocol=protocol, boot="Boot", patience_s=60.0)
        await here.start("a1", action, **args)
        await until(lambda: len(ioc.truth(action)) == 1, 20)
        if action == "travel":  # its put was answered; the end of the motion is waited for
            await here.await_taken()
        ioc.kill()
        await here.in_error("here is no answer for")
        ioc.start()
        told = await here.status("a1", "interrupted", 60)
        assert "restarted" in told.why or "lost" in told.why
        await here.idle(60)
        assert (await here.start("a1", action, **args)).status == "interrupted"
        await here.start("a2", "shake", speed=6, time_s=0.0)
        assert (await here.outcome("a2")).succeeded
        moved = [told["what"] for told in ioc.truth() if told["what"] in ("shake", "travel")]
        assert moved == [action, "shake"]

    try:
        run(tmp_path, scenario)
    finally:
        ioc.kill()


@pytest.mark.full
@pytest.mark.parametrize("protocol", ["ca", "pva"])
@pytest.mark.parametrize("action", ["shake", "shake_by_id", "travel"])
def test_the_adapter_is_killed_in_mid_action(ioc: Ioc, tmp_path: Path, action: str, protocol: str) -> None:
    """Only what names the action, or what was answered by an IOC that is still the same one, can be found."""
    label = f"killed {action} {protocol}"
    mapping = {**MAPPING, "protocol": protocol, "boot": "Boot"}
    args: dict[str, Any] = {"speed": 4, "time_s": 6.0, "label": label}
    told: dict[str, Any] = {"label": label}
    what = "shake"
    if action == "travel":
        what, args = "travel", {"target": 30.0 + (protocol == "pva")}
        told = args

    async def scenario(here: Bench) -> None:
        first = await adapter(here, ioc, protocol=protocol, boot="Boot")
        await here.start("a1", action, **args)
        await until(lambda: len(ioc.truth(what, **told)) == 1, 20)
        if action == "travel":
            await here.await_taken()
        first.kill()
        await here.await_node_gone()
        await here.process("epics_node", DESCRIPTION, **ioc.config, patience_s=20.0, epics=mapping)
        if action == "shake":
            assert "restarted" in (await here.status("a1", "interrupted", 40)).why
        else:
            assert (await here.outcome("a1", 40)).succeeded
        await here.idle(40)
        again = await here.start("a1", action, **args)
        assert again.status in ("finished", "interrupted")
        assert len(ioc.truth(what, **told)) == 1

    run(tmp_path, scenario)


@pytest.mark.full
def test_what_is_not_there_is_named(ioc: Ioc, tmp_path: Path) -> None:
    async def scenario(here: Bench) -> None:
        await here.process(
            "epics_node", DESCRIPTION, **ioc.config, epics={**MAPPING, "resources": {"foil": "Foil"}}
        )
        await here.in_error("here is no answer for SHAKER:Foil")

    run(tmp_path, scenario)


@pytest.mark.full
@pytest.mark.parametrize("protocol", ["ca", "pva"])
@pytest.mark.parametrize("action", ["shake", "travel"])
def test_an_ioc_that_says_nothing_any_more(tmp_path: Path, action: str, protocol: str) -> None:
    """It is frozen in mid-motion, so that the line stays up: after `patience_s` the outcome is unknown."""
    ioc = Ioc(tmp_path / "ioc").start()
    args = {"speed": 5, "time_s": 3.0, "label": "frozen"} if action == "shake" else {"target": NEVER}

    async def scenario(here: Bench) -> None:
        await adapter(here, ioc, protocol=protocol, patience_s=3.0)
        await here.start("a1", action, **args)
        await until(lambda: len(ioc.truth(action)) == 1, 20)
        if action == "travel":  # its put was answered; the end of the motion is waited for
            await here.await_taken()
        ioc.send(signal.SIGSTOP)
        told = await here.status("a1", "interrupted", 60)
        assert told.why
        assert (await here.start("a2", "shake", speed=6, time_s=0.0, label="unheard")).status == "refused"
        ioc.send(signal.SIGCONT)
        assert (await here.start("a1", action, **args)).status == "interrupted"
        assert [told["what"] for told in ioc.truth() if told["what"] in ("shake", "travel")] == [action]

    try:
        run(tmp_path, scenario)
    finally:
        ioc.send(signal.SIGCONT)
        ioc.kill()

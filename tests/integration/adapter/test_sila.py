"""The adapter of SiLA 2 servers, with a real one on ``sila2`` 0.14.0 in a process of its own."""

from __future__ import annotations

import asyncio
import json
import signal
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import pytest
import yaml
from msgspec.structs import replace

from labos.adapter import describe_foreign
from labos.core.model import ActionSpec, Arg, Description
from labos.spec.about import About, make_about, make_description
from labos.spec.emit import to_yaml
from tests.integration.adapter.bench import Bench
from tests.integration.adapter.scenario import play
from tests.integration.bus.contract import until
from tests.support.cable import Cable
from tests.support.lab_process import labos
from tests.support.sila import SilaProcess

pytest.importorskip("grpc", reason="needs labos-sdl[sila]")

run = partial(play, limit_s=100.0)
MAPPING: dict[str, Any] = {
    "state": {
        "busy": {"property": "ShakingController.State", "is": "Shaking"},
        "error": {"property": "ShakingController.State", "is": "Error"},
        "why": "ShakingController.Why",
    },
    "harmless": ["LidOpen"],
    "intermediate": ["shake_plate"],
    "reset": "ShakingController.Reset",
    "stop": "ShakingController.Halt",
    "resources": {"oil": "ShakingController.Oil"},
    "observe": {"x": "ShakingController.Nest.Position.X"},
    "labware": {"plate": {"property": "ShakingController.Nest.Present", "is": True}},
}
SHAKE = {"speed": 300, "duration": 0.3, "label": "", "mode": "Gentle"}


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[SilaProcess]:
    process = SilaProcess(tmp_path_factory.mktemp("sila"))
    try:
        yield process.start()
    finally:
        process.kill()


@pytest.fixture
def cable(server: SilaProcess) -> Iterator[Cable]:
    cable = Cable(server.port)
    yield cable
    cable.cut()


@pytest.fixture(scope="module")
def description(server: SilaProcess) -> Description:
    """What the server says of itself, as it goes through a workcell file."""
    told = asyncio.run(describe_foreign("sila_node", server.config()))
    written = yaml.safe_load(to_yaml(make_about(told)))
    return make_description(About.model_validate(written), "sila_node")


def config(server: SilaProcess, port: int = 0, **more: Any) -> dict[str, Any]:
    return {**server.config(port), "sila": MAPPING, "patience_s": 20.0, **more}


def test_commands_properties_errors_and_files(
    server: SilaProcess, description: Description, tmp_path: Path
) -> None:
    async def scenario(here: Bench) -> None:
        node = (await here.adapter("sila_node", description, **config(server))).node
        await here.idle()
        assert node.setup.firmware
        await here.start("a1", "shake_plate", **{**SHAKE, "label": "everyday"})
        done = await here.outcome("a1")
        assert (done.succeeded, done.effects, done.result["Turns"]) == (True, "all", 1.5)
        assert server.truth("shake", label="everyday") == [
            {"what": "shake", "speed": 300, "label": "everyday", "mode": "Gentle"}
        ]
        told = here.blobs.get(done.result["files"]["intermediate"]["sha256"]).decode()
        elapsed = [json.loads(line)["Elapsed"] for line in told.splitlines()]
        assert elapsed
        assert elapsed == sorted(set(elapsed))
        await here.start("a2", "nudge", duration=0.0, label="once")
        assert (await here.outcome("a2")).result == {"Position": {"X": 1.5, "Y": -2.0}}
        # every kind of value, both ways
        steps = [{"Part": 1, "Reversed": False}, {"Part": 7, "Reversed": True}]
        when = "2026-01-02T03:04:05.600+02:00"
        pinned = {"p.yaml": b"steps: 3"}
        await here.start("a3", "run_program", pinned, protocol="p.yaml", steps=steps, not_before=when)
        done = await here.outcome("a3")
        assert {key: done.result[key] for key in ("Done", "Began")} == {
            "Done": [1, 7],
            "Began": "2026-02-03T04:05:06.789+00:00",
        }
        assert here.blobs.get(done.result["files"]["Log"]["sha256"]) == b"all well"
        (seen,) = server.truth("program")
        assert (seen["text"], seen["after"]) == ("steps: 3", "2026-01-02T03:04:05.600000+02:00")
        assert [step["part"] for step in seen["steps"]] == [1, 7]
        # what goes wrong, in the server's own words
        failed = await fail(here, "a4", **{**SHAKE, "label": "lid"})
        assert (failed.effects, "LidOpen: Close the lid." in failed.error) == ("none", True)
        failed = await fail(here, "a5", **{**SHAKE, "label": "x" * 41})
        assert (failed.effects, "Label" in failed.error) == ("none", True)
        failed = await fail(here, "a6", **{**SHAKE, "label": "break"})
        assert (failed.effects, "The motor is hot." in failed.error) == ("unknown", True)
        failed = await fail(here, "a7", **{**SHAKE, "label": "jam"})
        assert (failed.effects, "PlateStuck: The plate does not move." in failed.error) == ("unknown", True)
        assert "The plate is stuck." in await node.trouble()
        assert (await here.kernel.recover("a8")).succeeded
        await here.idle()
        # what the arguments say of themselves is checked before the server is asked
        for action, wrong in (("a9", {"speed": 2001}), ("a10", {"mode": "Wild"})):
            refused = await here.start(action, "shake_plate", **{**SHAKE, **wrong})
            assert refused.status == "refused"
        assert await node.resources() == {"oil": 12.5}
        assert (await here.kernel.admin("observe")).result == {"x": 0.5, "labware": {"plate": True}}
        assert (await here.kernel.admin("stop")).done
        assert len(server.truth("halt")) == 1
        # a known attempt is never passed on again
        await here.start("a1", "shake_plate", **{**SHAKE, "label": "everyday"})
        assert len(server.truth("shake", label="everyday")) == 1

    run(tmp_path, scenario)


async def fail(here: Bench, action: str, **args: Any) -> Any:
    await recover(here)
    await here.start(action, "shake_plate", **args)
    outcome = await here.outcome(action)
    assert not outcome.succeeded
    return outcome


async def recover(here: Bench) -> None:
    """Out of the error that a failure leaves."""
    if (await here.kernel.state()).status == "ERROR":
        assert (await here.kernel.recover(f"a{100 + len(here.kernel.results)}")).succeeded
    await here.idle()


@pytest.mark.slow
def test_labos_node_about_prints_the_module(server: SilaProcess, tmp_path: Path) -> None:
    where = f"127.0.0.1:{server.port}"
    said = labos("node", "about", "sila_node", where, "--config", "sila_insecure=true")
    assert said.returncode == 0, said.stderr
    module = yaml.safe_load(said.stdout)
    assert module["config"] == {"sila_address": where, "sila_insecure": True}
    cell = tmp_path / "cell.yaml"
    cell.write_text(yaml.safe_dump({"labos": 1, "name": "cell", "modules": [{"name": "shaker", **module}]}))
    checked = labos("validate", str(cell))
    assert checked.returncode == 0, checked.stdout


@pytest.mark.full
def test_as_madscis_files_have_it(server: SilaProcess, tmp_path: Path) -> None:
    """A URL and nothing else, and SiLA's own names in the workflow."""
    where = {"node_url": f"sila://127.0.0.1:{server.port}/"}
    description = asyncio.run(describe_foreign("madsci_sila_node", where))

    async def scenario(here: Bench) -> None:
        await here.adapter("madsci_sila_node", description, **where)
        await here.idle()
        await here.start(
            "a1", "ShakingController.ShakePlate", Speed=60, Duration=0.0, Label="m", Mode="Rough"
        )
        assert (await here.outcome("a1")).result == {"Turns": 0.0}
        assert len(server.truth("shake", label="m")) == 1

    run(tmp_path, scenario)


# -- what goes wrong ------------------------------------------------------------------------------


def motion(action: str, label: str, duration: float) -> dict[str, Any]:
    """The arguments of either command; one is observable, the other is not."""
    told = {"duration": duration, "label": label}
    return {**SHAKE, **told} if action == "shake_plate" else told


WORDS = {"shake_plate": "shake", "nudge": "nudge"}
BOTH = pytest.mark.parametrize("action", ["shake_plate", "nudge"])


async def once_more(here: Bench, server: SilaProcess, action: str, label: str) -> None:
    """What became unknown is not sent again, and the next action is carried out."""
    again = await here.start("a1", action, **motion(action, label, 2.0))
    assert again.status == "interrupted"
    await here.idle(40)
    await here.start("a2", action, **motion(action, f"{label}, next", 0.0))
    assert (await here.outcome("a2")).succeeded
    assert len(server.truth(WORDS[action], label=label)) == 1


@pytest.mark.full
@BOTH
def test_a_lost_answer_to_the_start_never_moves_twice(
    server: SilaProcess, description: Description, cable: Cable, tmp_path: Path, action: str
) -> None:
    label = f"lost {action}"
    cable.deaf_after = label.encode()

    async def scenario(here: Bench) -> None:
        await here.adapter("sila_node", description, **config(server, cable.port))
        await here.idle()
        await here.start("a1", action, **motion(action, label, 2.0))
        await until(lambda: len(server.truth(WORDS[action], label=label)) == 1, 20)
        assert cable.deaf.is_set()
        cable.deaf_after = b""
        cable.cut()
        cable.mend()
        told = await here.status("a1", "interrupted", 40)
        assert ("UUID" if action == "shake_plate" else "no record") in told.why
        # it is asked whether it is busy, so nothing else begins before the motion has ended
        assert len(server.truth(f"{WORDS[action]} ended", label=label)) == 1
        await once_more(here, server, action, label)

    run(tmp_path, scenario)


@pytest.mark.full
@BOTH
def test_the_line_is_cut_in_mid_motion(
    server: SilaProcess, description: Description, cable: Cable, tmp_path: Path, action: str
) -> None:
    """The motion ends while the line is dead: an execution is asked for by its UUID."""
    label = f"cut {action}"

    async def scenario(here: Bench) -> None:
        await here.adapter("sila_node", description, **config(server, cable.port))
        await here.idle()
        await here.start("a1", action, **motion(action, label, 2.0))
        await until(lambda: len(server.truth(WORDS[action], label=label)) == 1, 20)
        await asyncio.sleep(0.5)  # the answer to the start is there
        cable.cut()
        await until(lambda: len(server.truth(f"{WORDS[action]} ended", label=label)) == 1, 20)
        cable.mend()
        if action == "shake_plate":
            assert (await here.outcome("a1", 40)).result["Turns"] == 10.0
            again = await here.start("a1", action, **motion(action, label, 2.0))
            assert again.status == "finished"
            assert len(server.truth("shake", label=label)) == 1
        else:
            await here.status("a1", "interrupted", 40)
            await once_more(here, server, action, label)

    run(tmp_path, scenario)


@pytest.mark.full
@BOTH
@pytest.mark.parametrize("heard", [True, False], ids=["", "before an answer came"])
def test_the_adapter_is_killed_in_mid_motion(
    server: SilaProcess, description: Description, cable: Cable, tmp_path: Path, action: str, heard: bool
) -> None:
    label = f"killed {action} {heard}"
    cable.deaf_after = b"" if heard else label.encode()

    async def scenario(here: Bench) -> None:
        first = await here.process("sila_node", description, **config(server, cable.port))
        await here.idle()
        await here.start("a1", action, **motion(action, label, 6.0))
        await until(lambda: len(server.truth(WORDS[action], label=label)) == 1, 20)
        await asyncio.sleep(0.5)  # the answer to the start is there, if one comes
        first.kill()
        await here.await_node_gone()
        cable.deaf_after = b""
        await here.process("sila_node", description, **config(server, cable.port))
        if action == "shake_plate" and heard:
            assert (await here.outcome("a1", 60)).result["Turns"] == 30.0
            assert len(server.truth("shake", label=label)) == 1
        else:
            assert "restarted" in (await here.status("a1", "interrupted", 60)).why
            assert len(server.truth(f"{WORDS[action]} ended", label=label)) == 1
            await once_more(here, server, action, label)

    run(tmp_path, scenario)


@pytest.mark.full
@BOTH
def test_the_server_is_killed_in_mid_motion(description: Description, tmp_path: Path, action: str) -> None:
    """It is started again at once, and neither gRPC nor the adapter sends the command a second time."""
    server = SilaProcess(tmp_path / "server").start()

    async def scenario(here: Bench) -> None:
        await here.adapter("sila_node", description, **config(server, patience_s=60.0))
        await here.idle()
        await here.start("a1", action, **motion(action, "died", 30.0))
        await until(lambda: len(server.truth(WORDS[action])) == 1, 20)
        await asyncio.sleep(0.5)  # the answer to the start is there, if one comes
        server.kill()
        await here.in_error("does not send")
        server.start()
        told = await here.status("a1", "interrupted", 60)
        assert ("does not know the execution" if action == "shake_plate" else "lost") in told.why
        await here.idle(40)
        await once_more(here, server, action, "died")
        moved = [told["label"] for told in server.truth(WORDS[action])]
        assert moved == ["died", "died, next"]

    try:
        run(tmp_path, scenario)
    finally:
        server.kill()


@pytest.mark.full
@BOTH
def test_a_server_that_says_nothing_any_more(description: Description, tmp_path: Path, action: str) -> None:
    """It is frozen, so that the line stays up: after `patience_s` the outcome is unknown."""
    server = SilaProcess(tmp_path / "server").start()
    assert server.process is not None

    async def scenario(here: Bench) -> None:
        await here.adapter("sila_node", description, **config(server, patience_s=3.0))
        await here.idle()
        await here.start("a1", action, **motion(action, "frozen", 2.0))
        await until(lambda: len(server.truth(WORDS[action])) == 1, 20)
        await asyncio.sleep(0.5)  # the answer to the start is there, if one comes
        server.process.send_signal(signal.SIGSTOP)  # type: ignore[union-attr]
        assert "has not answered for" in (await here.status("a1", "interrupted", 60)).why
        await here.in_error("does not send")
        assert (await here.start("a3", action, **motion(action, "unheard", 0.0))).status == "refused"
        server.process.send_signal(signal.SIGCONT)  # type: ignore[union-attr]
        await here.idle(40)
        await once_more(here, server, action, "frozen")
        assert server.truth(WORDS[action], label="unheard") == []

    try:
        run(tmp_path, scenario)
    finally:
        server.process.send_signal(signal.SIGCONT)
        server.kill()


# -- another maker ---------------------------------------------------------------------------------


@pytest.mark.full
def test_a_server_on_other_software(description: Description, tmp_path: Path) -> None:
    """`unitelabs-sila` 0.13.0 shares no code with `sila2`. The adapter is killed, then the server."""
    server = SilaProcess(tmp_path / "server", "unitelabs").start()
    mapping = {"state": {"busy": MAPPING["state"]["busy"]}, "intermediate": ["shake_plate"]}
    told = {**config(server), "sila": mapping, "patience_s": 60.0}

    async def scenario(here: Bench) -> None:
        first = await here.process("sila_node", description, **told)
        await here.idle()
        await here.start("a1", "shake_plate", **{**SHAKE, "label": "everyday"})
        done = await here.outcome("a1")
        assert done.result["Turns"] == 1.5
        kept = here.blobs.get(done.result["files"]["intermediate"]["sha256"]).decode().splitlines()
        assert json.loads(kept[-1]) == {"Elapsed": 0.3}
        refused = await fail(here, "a2", **{**SHAKE, "label": "x" * 41})
        assert (refused.effects, "Label" in refused.error) == ("none", True)
        await recover(here)
        await here.start("a3", "shake_plate", **motion("shake_plate", "killed", 6.0))
        await until(lambda: len(server.truth("shake", label="killed")) == 1, 20)
        await asyncio.sleep(0.5)  # the answer to the start is there
        first.kill()
        await here.await_node_gone()
        await here.process("sila_node", description, **told)
        assert (await here.outcome("a3", 60)).result["Turns"] == 30.0
        await here.idle()
        await here.start("a4", "shake_plate", **motion("shake_plate", "died", 30.0))
        await until(lambda: len(server.truth("shake", label="died")) == 1, 20)
        await asyncio.sleep(0.5)  # the answer to the start is there
        server.kill()
        await here.in_error("does not send")
        server.start()
        assert "does not know the execution" in (await here.status("a4", "interrupted", 60)).why
        await here.idle(40)
        moved = [told["label"] for told in server.truth("shake")]
        assert moved == ["everyday", "killed", "died"]

    try:
        run(tmp_path, scenario)
    finally:
        server.kill()


# -- encryption -----------------------------------------------------------------------------------


@pytest.mark.full
@pytest.mark.parametrize("host", ["127.0.0.1", ""], ids=["its address", "SiLA2"])
def test_encrypted_by_the_servers_own_certificate(
    description: Description, tmp_path: Path, host: str
) -> None:
    """Made by `sila2`, for the address; and as SiLA wants of one that nobody signed, for the name SiLA2."""
    server = SilaProcess(tmp_path / "server", encrypted=True, host=host).start()
    stranger = SilaProcess(tmp_path / "stranger", encrypted=True, host=host)
    name = {} if host else {"sila_server_name": "SiLA2"}

    async def scenario(here: Bench) -> None:
        for wrong in (
            {"sila_certificate": ""},  # which the computer does not trust
            stranger.config(server.port),
            {"sila_certificate": "", "sila_insecure": True},
            *([{"sila_server_name": ""}] if name else []),
        ):
            node = await here.adapter("sila_node", description, **{**config(server, **name), **wrong})
            await here.in_error("does not send")
            await node.close()
            await here.await_node_gone()
        await here.adapter("sila_node", description, **config(server, **name))
        await here.idle()
        await here.start("a1", "shake_plate", **{**SHAKE, "label": "secret"})
        assert (await here.outcome("a1")).result["Turns"] == 1.5
        assert len(server.truth("shake", label="secret")) == 1

    try:
        run(tmp_path, scenario)
    finally:
        server.kill()


# -- what does not fit ----------------------------------------------------------------------------


@pytest.mark.full
def test_what_the_server_lacks_is_said(server: SilaProcess, description: Description, tmp_path: Path) -> None:
    async def scenario(here: Bench) -> None:
        more = replace(description, actions=(*description.actions, ActionSpec(name="dance")))
        node = await here.adapter("sila_node", more, **config(server))
        await here.in_error("does not offer dance")
        await node.close()
        await here.await_node_gone()
        lacking = {**MAPPING, "stop": "ShakingController.Freeze", "resources": {"foil": "Sealer.Foil"}}
        node = await here.adapter("sila_node", description, **{**config(server), "sila": lacking})
        await here.in_error("does not offer Sealer.Foil, ShakingController.Freeze")
        await node.close()
        await here.await_node_gone()
        # Names that are otherwise are mapped as for all adapters.
        shake = ActionSpec(name="mix", args=(Arg(name="rpm", type="int"), Arg(name="time_s", type="float")))
        called = {"mix": {"name": "ShakingController.ShakePlate", "args": {"rpm": "Speed"}}}
        mixer = replace(description, actions=(shake,))
        await here.adapter("sila_node", mixer, **config(server, actions=called))
        await here.idle()
        await here.start("a1", "mix", rpm=3, time_s=0.0)
        failed = await here.outcome("a1")
        assert (failed.succeeded, failed.effects) == (False, "none")
        assert "has no 'time_s', needs 'Duration', needs 'Label', needs 'Mode'" in failed.error

    run(tmp_path, scenario)

"""Somebody else shows himself as a node: his tokens, heartbeats and answers change nothing."""

from __future__ import annotations

import asyncio
from pathlib import Path

import msgspec
import pytest

from labos.core.ids import ModuleName
from labos.node.protocol import StateReport
from labos.runtime.liveness import MOST_INSTANCES, MOST_STRANGERS, Liveness
from labos.runtime.stop import stop_modules
from tests.integration.bus.contract import until
from tests.support.attacked import ARM, OTHER, Liar, start_attacked

AWAY = ModuleName("cell/away")


def test_a_second_node_of_a_name_is_refused_and_told_of_once(tmp_path: Path) -> None:
    """Its heartbeats are not the module's, and the first one works on."""

    async def main() -> None:
        async with start_attacked(tmp_path, silence_s=1.0) as (lab, _):
            first = lab.module().instance
            await lab.evil.declare_alive(lab.keys.alive(ARM, "impostor"))
            report = StateReport("ERROR", lab.module().journal, "impostor", error="everything is broken")
            key = lab.keys.operation(ARM, "state")

            async def go_on() -> None:
                while True:
                    await lab.say(key, report)
                    await asyncio.sleep(0.05)

            lying = asyncio.get_running_loop().create_task(go_on())
            await until(lambda: bool(lab.questions("doubtful_node")), 15.0)
            (question,) = lab.questions("doubtful_node")
            assert "impostor" in question.text
            assert lab.registry.rejected[ARM] == "two nodes claim this module"
            assert (lab.module().status, lab.module().instance) == ("IDLE", first)
            await lab.works()
            lying.cancel()
            await until(lambda: ARM not in lab.registry.rejected, 15.0)
            assert len(lab.questions("doubtful_node")) == 1

    asyncio.run(main())


def test_a_node_that_takes_the_place_of_another_is_no_impostor(tmp_path: Path) -> None:
    async def main() -> None:
        async with start_attacked(tmp_path, silence_s=1.0) as (lab, _):
            first = lab.nodes[ARM]
            await first.close()
            await lab.start_node(ARM)
            await until(lambda: lab.module().instance == lab.nodes[ARM].instance, 10.0)
            await lab.works()
            assert not lab.questions("doubtful_node")
            assert ARM not in lab.registry.rejected

    asyncio.run(main())


@pytest.mark.slow
def test_a_second_node_that_obeys_a_later_kernel_takes_nothing_out_of_service(tmp_path: Path) -> None:
    """Whoever of the two is asked who it is."""

    async def main() -> None:
        async with start_attacked(tmp_path) as (lab, _):
            liar = Liar(lab, ARM)
            liar.about = msgspec.structs.replace(liar.about, epoch=2**62)
            bus = await lab.session()
            await bus.serve(lab.keys.operation(ARM, "about"), liar.on_about)
            await bus.serve(lab.keys.operation(ARM, "state"), liar.on_state)
            for n in range(20):
                await bus.declare_alive(lab.keys.alive(ARM, f"liar {n}"))
                await lab.heartbeats(1)
            assert lab.module().status == "IDLE"
            assert not lab.module().out_of_service
            assert not lab.questions("log_shorter")
            await lab.works()

    asyncio.run(main())


def test_an_answer_of_another_node_does_not_join_with_the_first_ones_state(tmp_path: Path) -> None:
    """``about`` from one and ``state`` from another is nobody."""

    async def main() -> None:
        async with start_attacked(tmp_path) as (lab, _):
            liar = Liar(lab, AWAY)
            liar.state = StateReport("IDLE", "j", "somebody else")
            await liar.serve()
            await until(lambda: AWAY in lab.registry.rejected, 10.0)
            assert lab.module(AWAY).status == "GONE"
            liar.state = StateReport("IDLE", "j", "liar")
            await until(lambda: lab.module(AWAY).status == "IDLE", 10.0)

    asyncio.run(main())


@pytest.mark.parametrize("count", [1000, pytest.param(10_000, marks=pytest.mark.full)])
def test_thousands_of_made_up_tokens_do_no_harm(tmp_path: Path, count: int) -> None:
    """Nobody is asked about modules that no workcell has, and only so many are remembered."""

    async def main() -> None:
        async with start_attacked(tmp_path, answer_s=5.0) as (lab, _):
            asked = lab.count_queries()
            session = lab.evil._session
            tokens = [
                session.liveliness().declare_token(lab.keys.alive(f"made-up/m{n}", f"i{n}"))
                for n in range(count)
            ]
            await lab.settle()
            await until(lambda: len(lab.registry.living) >= MOST_STRANGERS, 20.0)
            assert len(lab.registry.living) <= MOST_STRANGERS + 6  # with the modules that the lab has
            assert len(lab.registry.rejected) <= MOST_STRANGERS + 6  # with the modules that the lab has
            assert len(lab.registry._greeting) <= 3
            assert not asked
            await lab.works()
            assert not lab.kernel.state.interventions.open
            for token in tokens:
                token.undeclare()
            await until(lambda: set(lab.registry.living) <= {ARM, OTHER}, 20.0)
            assert set(lab.registry.rejected) <= {ARM, OTHER, AWAY}

    asyncio.run(main())


def test_made_up_instances_of_a_real_module_are_few_and_forgotten(tmp_path: Path) -> None:
    """And the node that comes back is noticed among them."""

    async def main() -> None:
        async with start_attacked(tmp_path, silence_s=1.0) as (lab, _):
            for n in range(100):
                await lab.say(lab.keys.operation(ARM, "state"), StateReport("IDLE", "j", f"made-up {n}"))
            await lab.settle()
            assert len(lab.registry._living.list_instances(ARM)) <= MOST_INSTANCES
            await lab.works()
            await lab.nodes[ARM].close()
            await until(lambda: lab.module().status == "GONE", 10.0)
            await lab.start_node(ARM)
            await until(lambda: lab.module().status == "IDLE", 10.0)
            await until(lambda: len(lab.registry._living.list_instances(ARM)) == 1, 10.0)
            await lab.works()

    asyncio.run(main())


@pytest.mark.parametrize(
    "key", ["@alive/*/*/x", "@alive/cell/*/x", "@alive/**", "@alive/cell/@x/y", "@alive/cell/ü\u202e/z", "**"]
)
def test_a_token_with_odd_parts_is_nobodys(tmp_path: Path, key: str) -> None:
    """With a wildcard, every node would be asked at once, and an emergency stop sent to all."""

    async def main() -> None:
        async with start_attacked(tmp_path) as (lab, _):
            await lab.evil.declare_alive(f"{lab.keys.root}/{key}")
            await lab.settle()
            assert set(lab.registry.living) == {ARM, OTHER}
            await lab.works()

    asyncio.run(main())


@pytest.mark.parametrize("key", ["*/*/state", "**", "cell/*/state", "*/*/result/*", "cell/arm/result/*"])
def test_what_is_published_for_many_is_heard_of_nobody(tmp_path: Path, key: str) -> None:
    async def main() -> None:
        async with start_attacked(tmp_path) as (lab, _):
            known = lab.module()
            report = StateReport("ERROR", known.journal, known.instance, error="broken")
            await lab.say(f"{lab.keys.root}/{key}", report)
            await lab.settle()
            assert lab.module().status == "IDLE"
            await lab.works()

    asyncio.run(main())


def test_a_flood_of_changes_is_not_a_flood_of_events(tmp_path: Path) -> None:
    async def main() -> None:
        async with start_attacked(tmp_path) as (lab, _):
            known = lab.module()
            key = lab.keys.operation(ARM, "state")
            before = lab.kernel.durable
            for n in range(2000):
                report = StateReport(
                    "ERROR", known.journal, known.instance, error=f"{n}" * 1000, stopped_at=n
                )
                await lab.say(key, report)
            await lab.settle()
            await lab.kernel.flush()
            assert lab.kernel.durable - before < 200
            await until(lambda: lab.module().status == "IDLE", 10.0)

    asyncio.run(main())


@pytest.mark.parametrize(
    "answer",
    [
        b'{"done": true, "result": ' + b"[" * 100_000,
        b"\xff\xfe",
        b"{}",
        b"",
        b'{"done": true, "result": ' + b"9" * 40 + b"}",
        b'{"done": true, "result": -1}',
        b'{"done": true, "result": {"a": ' * 300,
    ],
)
def test_one_bad_answer_keeps_no_other_module_from_being_stopped(tmp_path: Path, answer: bytes) -> None:
    async def main() -> None:
        async with start_attacked(tmp_path, nodes=(OTHER,)) as (lab, _):
            liar = await Liar.show_itself(lab)
            liar.admin = answer
            report = await stop_modules(lab.bus, lab.kernel.lab, [ARM, OTHER, AWAY], "ada")
            assert set(report.stopped) == {OTHER}
            assert set(report.silent) == {ARM, AWAY}
            assert all(len(why) < 5000 for why in report.silent.values())

    asyncio.run(main())


def test_living_never_forgets_the_one_that_is_in_use() -> None:
    living = Liveness()
    assert living.remember(ARM, "first", 0.0, "first", None)
    for n in range(1000):
        assert living.remember(ARM, f"i{n}", float(n + 1), "first", None)
    assert len(living.list_instances(ARM)) == MOST_INSTANCES
    assert "first" in living.list_instances(ARM)
    for n in range(1000):
        living.remember(ModuleName(f"x/{n}"), "i", 0.0, "", 1)
    assert len(living.modules) == MOST_STRANGERS + 1
    assert not living.remember(ModuleName("x/last"), "i", 0.0, "", 1)
    for module in living.modules:
        for instance in list(living.list_instances(module)):
            living.forget(module, instance)
    assert living.modules == []
    assert living.list_silent(1e9, 1.0) == []

"""What the kernel does not believe: a stranger on the bus says what it likes, and nothing follows from it."""

from __future__ import annotations

import asyncio
from pathlib import Path
from typing import Any

import msgspec
import pytest

from labos.core.actions import CLOCK_SKEW_NS, Action
from labos.core.decide.interventions import ResolveIntervention
from labos.core.decide.runs import SubmitRun
from labos.core.ids import ActionId, ModuleName
from labos.errors import Fenced, StoreUnavailable
from labos.node.protocol import (
    ActionReply,
    Outcome,
    ResultPublished,
    Start,
    StateReport,
    Unacknowledged,
)
from tests.integration.bus.contract import until
from tests.support.attacked import ARM, OTHER, Liar, start_attacked
from tests.support.bench import plan, step


def forge(action: Action, **changed: Any) -> ResultPublished:
    """The result that the node itself would publish, but for what is changed."""
    outcome = Outcome(True, "all", ended_ns=changed.pop("ended_ns", action.requested_at + 1))
    return msgspec.structs.replace(
        ResultPublished(action.id, action.attempt, action.journal, outcome), **changed
    )


@pytest.mark.parametrize("what", ["key", "journal", "attempt", "named", "past", "future", "no time"])
def test_a_result_that_does_not_fit_ends_nothing(tmp_path: Path, what: str) -> None:
    """The node itself is asked, and says that it is still at it. A person is told once, however much comes,
    unless it may be a clock that is wrong."""

    async def main() -> None:
        async with start_attacked(tmp_path) as (lab, devices):
            action = await lab.hold_in_flight(devices[ARM])
            key, message = lab.keys.result(ARM, action.id), forge(action)
            if what == "key":
                key = lab.keys.result(OTHER, action.id)
            elif what == "journal":
                message = forge(action, journal="another")
            elif what == "attempt":
                message = forge(action, attempt=7)
            elif what == "named":
                key = lab.keys.result(ARM, "another")
            else:
                off = {"past": -1, "future": 1, "no time": 0}[what]
                ended_ns = off and lab.kernel.clock.now_ns() + off * 2 * CLOCK_SKEW_NS
                message = forge(action, ended_ns=ended_ns)
            asked = lab.dispatcher.asked
            for _ in range(200):
                await lab.say(key, message)
            await lab.settle()
            assert lab.in_flight().id == action.id
            assert lab.in_flight().status == "accepted"
            assert 1 <= lab.dispatcher.asked - asked <= 100
            told = 0 if what in ("past", "future", "no time") else 1
            assert len(lab.questions("doubtful_node")) == told
            position = lab.kernel.durable
            devices[ARM].gate.set()
            await until(lambda: lab.is_over("R1"), 20.0)
            assert devices[ARM].done == ["act"] * 3
            assert lab.kernel.durable > position
            await lab.works()

    asyncio.run(main())


def test_a_node_whose_clock_is_wrong_loses_nothing_but_the_time(tmp_path: Path) -> None:
    async def main() -> None:
        async with start_attacked(tmp_path) as (lab, devices):
            action = await lab.hold_in_flight(devices[ARM])
            clock = lab.nodes[ARM]._clock
            now_ns = clock.now_ns
            clock.now_ns = lambda: now_ns() + 365 * 24 * 3600 * 10**9  # type: ignore[method-assign]
            devices[ARM].gate.set()
            await until(lambda: action.id not in lab.kernel.state.actions.open, 10.0)
            await until(lambda: lab.is_over("R1"), 20.0)
            assert not lab.kernel.state.interventions.open
            ends = [
                msgspec.json.decode(record.payload)
                for record in await lab.records()
                if record.head.type == "action.succeeded"
            ]
            assert [end["ended_ns"] for end in ends] == [0, 0, 0]

    asyncio.run(main())


@pytest.mark.parametrize("attempt", [-1, 2, 2**40])
def test_a_reply_about_an_attempt_that_was_never_sent_asks_a_person(tmp_path: Path, attempt: int) -> None:
    async def main() -> None:
        async with start_attacked(tmp_path, nodes=(OTHER,)) as (lab, _):
            liar = await Liar.show_itself(lab)
            liar.reply = ActionReply("finished", "j", outcome=Outcome(True, "all"), attempt=attempt)
            await lab.submit()
            await until(lambda: bool(lab.questions("unknown_action")), 10.0)
            assert lab.in_flight().status == "unknown"
            assert not lab.kernel.failed.done()

    asyncio.run(main())


def test_a_node_that_refuses_to_say_has_not_said_that_it_did_nothing(tmp_path: Path) -> None:
    """``refused`` is an answer to a start. To a question, it is none."""

    async def main() -> None:
        async with start_attacked(tmp_path, nodes=(OTHER,)) as (lab, _):
            liar = await Liar.show_itself(lab)
            liar.reply = ActionReply("accepted", "j", attempt=1)
            await lab.submit()
            await until(lambda: lab.in_flight().status == "accepted", 10.0)
            liar.reply = ActionReply("refused", "j", "its journal cannot be written")
            lab.dispatcher.find_out(lab.in_flight().id)
            await until(lambda: bool(lab.questions("unknown_action")), 10.0)
            assert lab.in_flight().status == "unknown"

    asyncio.run(main())


def test_a_late_result_is_evidence_if_the_node_itself_says_so(tmp_path: Path) -> None:
    """After a person has said how the action ended."""

    async def main() -> None:
        async with start_attacked(tmp_path, nodes=(OTHER,)) as (lab, _):
            liar = await Liar.show_itself(lab)
            liar.reply = ActionReply("interrupted", "j", attempt=1)
            await lab.submit()
            await until(lambda: bool(lab.questions("unknown_action")), 10.0)
            action = lab.in_flight()
            answer = ResolveIntervention(lab.questions("unknown_action")[0].id, "gone", "ada")
            await lab.kernel.execute(answer, "ada")
            assert lab.kernel.state.actions.settled[action.id].effects == "partial"

            asked = liar.questions
            await lab.say(lab.keys.result(OTHER, action.id), forge(action))
            await lab.settle()
            await lab.heartbeats(3, OTHER)
            assert liar.questions == asked, "the other module was not asked, and cannot know"

            await lab.say(lab.keys.result(ARM, action.id), forge(action))
            await until(lambda: liar.questions > asked, 10.0)
            await lab.heartbeats(3, OTHER)
            assert action.id in lab.kernel.state.actions.settled, "its node does not confirm it"

            liar.reply = ActionReply("finished", "j", outcome=Outcome(True, "all"), attempt=1)
            await lab.say(lab.keys.result(ARM, action.id), forge(action))
            await until(lambda: bool(lab.questions("contradiction")), 10.0)
            assert action.id not in lab.kernel.state.actions.settled, "evidence is taken once"

    asyncio.run(main())


# -- other kernels --------------------------------------------------------------------------------


@pytest.mark.parametrize("epoch", [2, 50_000_000, 2**62])
def test_a_node_that_obeys_a_later_kernel_is_refused_and_ends_nobody(tmp_path: Path, epoch: int) -> None:
    """The database says that this is still the lab's kernel. Everything else works; the module is out of
    service until a person has looked."""

    async def main() -> None:
        async with start_attacked(tmp_path) as (lab, _):
            away = ModuleName("cell/away")
            await Liar.show_itself(lab, away, epoch=epoch)
            await until(lambda: bool(lab.questions("outranked_node")), 10.0)
            assert not lab.kernel.failed.done()
            assert lab.module(away).status == "GONE"
            assert f"epoch {epoch}" in lab.module(away).out_of_service
            assert f"epoch {epoch}" in lab.registry.rejected[away]
            (question,) = lab.questions("outranked_node")
            assert ("labos db restored" in question.text) == (epoch < 2**53)
            await lab.works()
            assert len(lab.questions("outranked_node")) == 1

    asyncio.run(main())


def test_an_answer_fenced_ends_nobody(tmp_path: Path) -> None:
    """The action that it was given in answer to is a person's question when the module stays away."""

    async def main() -> None:
        async with start_attacked(tmp_path, nodes=(OTHER,)) as (lab, _):
            liar = await Liar.show_itself(lab)
            liar.reply = ActionReply("fenced", "j", "cell/arm belongs to lab x, not to y.")
            await lab.submit()
            await until(lambda: lab.module().status == "GONE", 10.0)
            await until(lambda: bool(lab.questions("doubtful_node")), 10.0)
            assert "belongs to lab x" in lab.registry.rejected[ARM]
            assert not lab.kernel.failed.done()
            assert len(liar.heard) == 1, "it is barred: nobody sends in a circle"
            await lab.kernel.execute(SubmitRun(plan(step("other")), "ada"), "ada")
            await until(lambda: lab.is_over("R2"), 10.0)

    asyncio.run(main())


def test_a_kernel_that_was_replaced_in_the_database_stops_at_the_first_fenced_answer(tmp_path: Path) -> None:
    async def main() -> None:
        async with start_attacked(tmp_path, nodes=(OTHER,)) as (lab, _):
            liar = await Liar.show_itself(lab)
            lab.kernel._tasks[0].cancel()  # it renews its lease too seldom to notice by itself
            await lab.set_epoch(lab.kernel.epoch + 1)
            liar.reply = ActionReply("fenced", "j", "obeys the kernel of epoch 2; this one's is 1")
            lab.dispatcher.note_outranked(ARM, "obeys another")
            await until(lab.kernel.failed.done, 10.0)
            assert isinstance(lab.kernel.failed.result(), Fenced)
            with pytest.raises((Fenced, StoreUnavailable)):
                lab.kernel.state  # noqa: B018

    asyncio.run(main())


# -- what the log does not know -------------------------------------------------------------------


def test_a_start_that_the_kernel_never_sent_is_known_at_once(tmp_path: Path) -> None:
    """Not only when the node joins again; whatever it names itself, and once."""

    async def main() -> None:
        async with start_attacked(tmp_path) as (lab, devices):
            journal = lab.module().journal
            names = ["0190aaaa-0000-7000-8000-000000000000", "x" * 150]
            for name in names:
                start = Start(lab.kernel.lab, 1, journal, name, 1, 1000, "act")
                payload = msgspec.json.encode(start)
                await lab.evil.query(lab.keys.operation(ARM, "action"), payload, 5.0)
            await until(lambda: set(lab.kernel.state.actions.discovered) == set(names), 10.0)
            assert devices[ARM].done == ["act", "act"]
            assert len(lab.questions("log_shorter")) == 1
            await lab.heartbeats(5)
            assert len(lab.questions("log_shorter")) == 1
            assert set(lab.kernel.state.shorter.actions) == set(names)

    asyncio.run(main())


def test_a_made_up_heartbeat_takes_no_module_out_of_service(tmp_path: Path) -> None:
    """The node itself is asked what is in its journal."""

    async def main() -> None:
        async with start_attacked(tmp_path) as (lab, _):
            known = lab.module()
            report = StateReport("IDLE", known.journal, known.instance, running=["made-up"], finished=["too"])
            for number in range(50):
                changed = msgspec.structs.replace(report, interrupted=[f"n{number}"])
                await lab.say(lab.keys.operation(ARM, "state"), changed)
            await lab.settle()
            await lab.heartbeats(3)
            assert not lab.kernel.state.interventions.open
            await lab.works()

    asyncio.run(main())


def test_actions_that_ended_long_ago_are_no_discovery(tmp_path: Path) -> None:
    """A node may not forget them as long as an older one goes on; the kernel's memory is shorter, its log is
    not. What a node says of their positions is looked up."""

    async def main() -> None:
        async with start_attacked(tmp_path) as (lab, devices):
            first = await lab.hold_in_flight(devices[OTHER], plan(step("other", exclusive=False)))
            devices[OTHER].gate.set()
            for _ in range(40):
                await lab.submit(plan(step("other", exclusive=False)))
            await until(lambda: not lab.kernel.state.runs.active and not lab.kernel.state.runs.queued, 30.0)
            assert first.id not in lab.kernel.state.actions.ended[OTHER]
            entry = Unacknowledged(first.id, 1, "act", "finished", "", first.position)
            lies = [
                msgspec.structs.replace(entry, action="lie"),
                Unacknowledged("lie 2", 1, "act", "finished", "", 2**62),
                Unacknowledged("lie 3", 1, "act", "finished", "", -1),
            ]
            strange = await lab.registry._discovery.find_unlogged(OTHER, [entry, *lies])
            assert [entry.action for entry in strange] == ["lie", "lie 2", "lie 3"]

    asyncio.run(main())


def test_an_id_that_cannot_be_ours_is_recorded_cut(tmp_path: Path) -> None:
    """And only so many of them."""

    async def main() -> None:
        async with start_attacked(tmp_path, nodes=(OTHER,)) as (lab, _):
            liar = await Liar.show_itself(lab)
            ids = [f"{number}".rjust(500, "\u0007") for number in range(300)]
            open_ = [Unacknowledged(name, 1, "act" * 5000, "finished", "", 3) for name in ids]
            liar.about = msgspec.structs.replace(liar.about, open=open_)
            await lab.say(lab.keys.operation(ARM, "state"), StateReport("IDLE", "j", "liar", finished=ids))
            await until(lambda: bool(lab.kernel.state.actions.discovered), 10.0)
            await lab.kernel.flush()
            assert max(map(len, lab.kernel.state.actions.discovered)) <= 200
            assert len(lab.kernel.state.actions.discovered) <= 100
            assert len(lab.questions("log_shorter")) == 1

    asyncio.run(main())


# -- settled ------------------------------------------------------------------------------------


def test_a_module_that_does_not_answer_settled_delays_only_itself(tmp_path: Path) -> None:
    async def main() -> None:
        async with start_attacked(tmp_path, nodes=(OTHER,), answer_s=60.0) as (lab, _):
            liar = await Liar.show_itself(lab)
            liar.settles = asyncio.Event()
            lab.dispatcher.report_settled(ARM, ActionId("gone"), done=True)
            await lab.kernel.execute(SubmitRun(plan(step("other")), "ada"), "ada")
            await until(lambda: lab.is_over("R1"), 10.0)
            assert lab.dispatcher._reporting, "it was still being told"
            await lab.kernel.execute(SubmitRun(plan(step("arm")), "ada"), "ada")
            await until(lambda: bool(liar.heard), 10.0)
            assert lab.dispatcher._reporting, "a start on the module itself waits for a moment only"
            liar.settles.set()

    asyncio.run(main())

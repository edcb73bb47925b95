"""Every wait has a sentence, with names."""

from __future__ import annotations

import random
import string
from typing import Any, get_args

import msgspec
import pytest

from labos.core import reasons
from labos.core.reasons import AnyReason, Reason
from labos.core.waits import Wait
from tests.support.bench import Driver
from tests.unit.planning.cases import Case

KINDS: tuple[type[Reason], ...] = get_args(AnyReason)


def example(kind: type[Reason]) -> Reason:
    """A reason with a name of a workcell in each field."""
    fields: list[Any] = msgspec.structs.fields(kind)
    return kind(*((f.name,) if f.type is not str else f"c/{f.name}" for f in fields))


def fields_in(template: str) -> set[str]:
    return {name for _, name, _, _ in string.Formatter().parse(template) if name}


def list_leaves(base: type[Reason]) -> set[type[Reason]]:
    """The reasons below a common base that are no base of others."""
    return {leaf for kind in base.__subclasses__() for leaf in list_leaves(kind) or {kind}}


def test_every_reason_is_one_of_them() -> None:
    assert set(KINDS) == list_leaves(Reason)
    assert len({kind.__struct_config__.tag for kind in KINDS}) == len(KINDS) > 40


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.__name__)
def test_its_sentence_and_remedy_are_whole(kind: type[Reason]) -> None:
    reason = example(kind)
    for text in (reason.sentence, reason.remedy):
        assert not {"{", "}", "/"} & set(text), text
    assert reason.sentence
    assert not kind.__dict__.get("__doc__"), "what it says is its sentence"
    known = {field.name for field in msgspec.structs.fields(kind)}
    if "_in_words" not in kind.__dict__:
        assert fields_in(kind.SENTENCE) | fields_in(kind.REMEDY) <= known


@pytest.mark.parametrize(
    ("wait", "text"),
    [
        (Wait(reasons.Occupied("rpl/ot2.deck1", "P7")), "ot2.deck1 is occupied by P7"),
        (Wait(reasons.Held("rpl/ot2", "run:R12")), "ot2 is held by run R12"),
        (Wait(reasons.Unsafe("to ot2", ("R12", "R3"))), "starting 'to ot2' now would trap run R12, run R3"),
        (
            Wait(reasons.Unsafe("to ot2", ("experiment:E1",))),
            "starting 'to ot2' now would trap experiment E1",
        ),
        (
            Wait(reasons.Reserved("rpl/hidex", "R12", "Read")),
            "hidex is reserved for run R12, whose step 'Read' has to start in time",
        ),
        (Wait(reasons.NotInTime("rpl/hidex", "Read")), "hidex will not be free in time for 'Read'"),
        (Wait(reasons.ModuleDown("rpl/x", "GONE")), "x is GONE"),
    ],
)
def test_sentences_name_what_is_meant(wait: Wait, text: str) -> None:
    assert wait.reason.sentence == text


def test_whatever_a_crowded_cell_waits_for_is_explained() -> None:
    seen: set[str] = set()
    for seed in range(30):
        rng = random.Random(seed)
        lab = Case(rng).submit_all()

        def look(lab: Driver = lab) -> None:
            lab.pump()
            for run in [*lab.state.runs.active.values(), *lab.state.runs.queued.values()]:
                for _, wait in lab.scheduler.list_waits(lab.state, run, lab.now):
                    seen.add(wait.code)
                    assert "{" not in wait.reason.sentence
                    kind = type(wait.reason)
                    assert {key.partition(":")[0] for key in wait.on} <= {*kind.WAKES}, (wait, kind)

        lab.work(rng, look)
    assert {"module_busy", "occupied", "held", "unsafe"} <= seen

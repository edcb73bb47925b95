"""Every wait has a sentence, with names."""

from __future__ import annotations

import ast
import inspect
import random
from types import ModuleType

import pytest

from labos.core import binding, expiry, rules, watching
from labos.core.waits import Wait
from labos.planning import aside, explain, keeping, reservations, scheduler, stuck
from labos.planning.explain import SENTENCES, sentence
from labos.services import waits
from tests.support.bench import Driver
from tests.unit.planning.cases import Case


def codes_in(module: ModuleType) -> set[str]:
    """The codes of all waits that a module makes."""
    found: set[str] = set()
    for node in ast.walk(ast.parse(inspect.getsource(module))):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "Wait":
            found |= strings(node.args[0])
        elif isinstance(node, ast.Assign) and any(getattr(t, "id", "") == "code" for t in node.targets):
            found |= strings(node.value)
    return found


def strings(node: ast.expr) -> set[str]:
    if isinstance(node, ast.IfExp):
        return strings(node.body) | strings(node.orelse)
    return {node.value} if isinstance(node, ast.Constant) and isinstance(node.value, str) else set()


MODULES = (aside, rules, binding, expiry, scheduler, reservations, keeping, stuck, watching, waits)
CODES = set[str]().union(*map(codes_in, MODULES)) - {""}


def test_the_codes_are_found() -> None:
    assert {"held", "occupied", "unsafe", "no_way_out", "after_elder", "gone", "buried"} <= CODES
    assert len(CODES) > 20


def test_every_code_has_a_sentence_and_every_sentence_a_code() -> None:
    assert CODES - {"unsafe"} <= set(SENTENCES)
    assert set(SENTENCES) <= CODES
    assert "unsafe" in inspect.getsource(explain)


@pytest.mark.parametrize("code", sorted(CODES))
def test_a_sentence_is_whole_with_any_number_of_names(code: str) -> None:
    for count in range(1 if code == "unsafe" else 0, 4):
        text = sentence(Wait(code, tuple(f"name{i}" for i in range(count))))
        assert text
        assert not {"{", "}", "/"} & set(text), text


@pytest.mark.parametrize(
    ("wait", "text"),
    [
        (Wait("occupied", ("rpl/ot2.deck1", "P7")), "ot2.deck1 is occupied by P7"),
        (Wait("held", ("rpl/ot2", "run:R12")), "ot2 is held by run R12"),
        (Wait("unsafe", ("to ot2", "R12", "R3")), "starting 'to ot2' now would trap run R12, run R3"),
        (
            Wait("unsafe", ("to ot2", "experiment:E1")),
            "starting 'to ot2' now would trap experiment E1",
        ),
        (
            Wait("reserved", ("rpl/hidex", "R12", "Read")),
            "hidex is reserved for run R12, whose step 'Read' has to start in time",
        ),
        (Wait("not_in_time", ("rpl/hidex", "Read")), "hidex would not be free in time for 'Read'"),
        (Wait("brand_new", ("rpl/x",)), "brand_new x"),
    ],
)
def test_sentences_name_what_is_meant(wait: Wait, text: str) -> None:
    assert sentence(wait) == text


def test_whatever_a_crowded_cell_waits_for_is_explained() -> None:
    seen: set[str] = set()
    for seed in range(30):
        rng = random.Random(seed)
        lab = Case(rng).submitted()

        def look(lab: Driver = lab) -> None:
            lab.pump()
            for run in [*lab.state.runs.active.values(), *lab.state.runs.queued.values()]:
                for _, wait in lab.scheduler.waits(lab.state, run, lab.now):
                    seen.add(wait.code)
                    assert "{" not in sentence(wait)

        lab.work(rng, look)
    assert {"module_busy", "occupied", "held", "unsafe"} <= seen
    assert seen <= set(SENTENCES) | {"unsafe"}

"""Every workflow of a public laboratory runs on a simulated bench, or is refused for a fault of its own."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from labos.core.arguments import list_names
from labos.core.decide.runs import SubmitRun
from labos.core.decide.stock import LoadStation
from labos.core.ids import local
from labos.core.model import Arg
from labos.errors import SpecError
from labos.spec import Compiled, CompiledWorkcell, SpecErrors, compile_workcell, compile_workflow
from labos.spec.about import find_description
from labos.spec.dialects import find_kind
from labos.spec.references import list_keys
from labos.spec.source import Source, read
from labos.spec.uses import read_uses, read_workflow, sort_workflows_by_workcell
from labos.spec.workflow import StartingLabware
from labos.testing.faults import QUIET
from labos.testing.lab import Job, SimulatedLab, Stand
from tests.simulation.mixes import DESCRIPTIONS, NODES
from tests.support.corpus import corpus

REFUSED = {
    "there is no module": 7,
    "joint angles do not show which station it is": 6,
    "needs lid of biometra closed, but then lid of biometra open": 3,
    "The labware of this run is no longer at peeler.default": 3,
    "needs lid of chemspeed closed, but then lid of chemspeed open": 2,
    "needs lid of hidex closed, but then lid of hidex open": 1,
}
"""Why the others are refused. Each is a fault of the file: a step on a module that the workcell does not
have, or that is switched off there; angles instead of a place; a program behind an open lid; a plate that was
carried away before."""

EVERY = 6
"""In the short test, each so many-th workflow runs."""


class Case(NamedTuple):
    """A workflow of the corpus and the workcell that it is for, as files."""

    flow: Source
    cell: Source


@cache
def cases() -> list[Case]:
    """All workflows that can be read, each with one workcell."""
    sources = []
    for path in sorted((corpus() / "corpus").rglob("*.y*ml")):
        try:
            source = read(path, last_wins=True)
            if find_kind(source) is not None:
                sources.append(source)
        except SpecError:
            continue
    by_file = {source.file: source for source in sources}
    found = {
        flow.file: Case(flow, by_file[cell])
        for cell, flows in sort_workflows_by_workcell(sources).items()
        for flow in flows
    }
    return [found[file] for file in sorted(found)]


def compile_case(case: Case) -> tuple[CompiledWorkcell, Compiled, dict[str, Any]]:
    """Raises SpecErrors."""
    cell = compile_workcell(case.cell, DESCRIPTIONS, uses=read_uses([case.flow]))
    payload = payload_for(case.flow, cell)
    plan = compile_workflow(case.flow, payload, cell.workcell, DESCRIPTIONS, simulate=True, bench=cell.bench)
    return cell, plan, payload


def payload_for(flow: Source, cell: CompiledWorkcell) -> dict[str, Any]:
    """What an application would send: something that fits each argument."""
    modules = {local(module.name): module for module in cell.workcell.modules}
    file = read_workflow(flow)[1]
    assert file is not None
    found: dict[str, Any] = {}
    for step in file.steps:
        module = modules.get(step.module)
        offers = find_description(module, DESCRIPTIONS) if module is not None else None
        action = offers.action(step.action) if offers is not None else None
        for name, value in step.args.items():
            arg = list_names(action).get(name) if action is not None else None
            for key in list_keys(value):
                *tables, last = key.split(".")
                here = found
                for table in tables:
                    here = here.setdefault(table, {})
                here.setdefault(last, make_value(arg, key))
    return found


def make_value(arg: Arg | None, key: str) -> Any:
    if arg is not None and arg.choices:
        return arg.choices[0]
    least = 1 if arg is None or arg.minimum is None else arg.minimum
    wells, motors = "well" in key, "motor" in key
    values: dict[str, Any] = {
        "list": ["A1"] if wells else ["motor_1"] if motors else [20.0],
        "int": int(least),
        "float": float(least),
        "bool": False,
        "dict": {},
        "file": "protocol.yaml",
    }
    return values.get(arg.type if arg is not None else "list" if wells else "", "1")


def run(case: Case) -> str:
    """What happened: ``ran``, or why not."""
    try:
        cell, plan, payload = compile_case(case)
    except SpecErrors as errors:
        texts = " ".join(f.message for f in errors.findings if f.severity == "error")
        return next((why for why in REFUSED if why in texts), texts)
    stock = tuple((item.station, item.labware, item.count) for item in cell.bench.stock)
    stocked = {place for place, *_ in stock}
    loads = tuple(load_of(brought) for brought in plan.brought if brought.station not in stocked)
    lab = SimulatedLab(Stand(cell.workcell, stock, NODES, loads), 1, QUIET)
    try:
        lab.run([Job("it", "ada", (SubmitRun(plan.plan, "ada", payload),))])
        crashes = lab.world.crashes()
        kinds = Counter(record.head.type for record in lab.store.records)
        return f"crashed: {crashes[0].facts}" if crashes else "ran" if kinds["run.completed"] else "failed"
    finally:
        lab.close()


def load_of(brought: StartingLabware) -> LoadStation:
    """A person brings what a run needs."""
    has = tuple(name for name, value in brought.variables.items() if value)
    lacks = tuple(name for name, value in brought.variables.items() if not value)
    return LoadStation(brought.station, brought.labware, 1, set=has, unset=lacks)


def outcomes(of: Iterator[Case] | list[Case]) -> Counter[str]:
    return Counter(run(case) for case in of)


def test_some_of_them() -> None:
    found = outcomes(cases()[::EVERY])
    assert set(found) <= {"ran", *REFUSED}, found
    assert found["ran"] >= 0.6 * sum(found.values()), found


@pytest.mark.full
def test_all_of_them(capsys: pytest.CaptureFixture[str]) -> None:
    found = outcomes(cases())
    with capsys.disabled():
        print(f"\n{sum(found.values())} workflows: {dict(found)}")
    assert {why: count for why, count in found.items() if why != "ran"} == REFUSED, found


def test_the_files_are_there() -> None:
    assert {Path(case.flow.file).suffix for case in cases()} <= {".yaml", ".yml"}
    assert len(cases()) == 92

"""Every file of a public laboratory loads, or is refused for the right reason at the right place."""

from __future__ import annotations

import re
from collections import Counter
from functools import cache
from pathlib import Path

import pytest
from spec_bench import PAPER
from test_spec_madsci import FLOW, SETTINGS

from labos.bootstrap import descriptions as installed
from labos.core.model import Description
from labos.errors import SpecError
from labos.spec import Finding, SpecErrors, compile_workcell, compile_workflow, find_spec, load_workcell
from labos.spec.comments import read_comments
from labos.spec.dialects import convert_workcell, convert_workflow, find_kind, make_unknown_error
from labos.spec.findings import FindingList, make_finding
from labos.spec.importing import complete_workcell, import_spec
from labos.spec.models import WorkcellFile, WorkflowFile
from labos.spec.source import Source, parse, read
from labos.spec.validation import validate
from tests.support.corpus import corpus

LOADED = {"workcell (wei)": 13, "workflow (wei)": 92}
REFUSED = {
    "holds `_`": 10,
    "empty": 3,
    "not YAML": 1,
    "not a table": 2,
    "`actions:` are a draft": 2,
    "commands in one step are a draft": 1,
}
"""How many of the files load, and why the others do not. A change of these is a change of what
LabOS understands: look at each file before you change a number."""

PLACES = {
    "biometra_test.yaml": (20, 3),
    "PCR1.yaml": (1, 1),
    "PCR_PURIFICATION.yaml": (1, 1),
    "example.yml": (38, 1),
    "example_wf.yml": (23, 5),
    "proposed.yaml": (15, 1),
    "workcell.yml": (1, 1),
    "rpl_modular_workcell.compose.yaml": (3, 1),
}


@cache
def drivers() -> dict[str, Description]:
    return installed()


def files() -> list[Path]:
    return sorted((corpus() / "corpus").rglob("*.y*ml"))


def load(path: Path) -> tuple[str, list[Finding]]:
    """What a file is, and what is wrong with it. Nothing but SpecError may be raised."""
    try:
        source = read(path, last_wins=True)
        found = find_kind(source)
        if found is None:
            return "", [make_finding(make_unknown_error(source))]
        text = import_spec(source, drivers()).text
        kept = Counter(comment.text for comment in read_comments(text))
        assert not Counter(comment.text for comment in read_comments(source.text)) - kept, path
    except SpecErrors as errors:
        return "", [finding for finding in errors.findings if finding.severity == "error"]
    except SpecError as error:
        return "", [make_finding(error)]
    return f"{found[0]} ({found[1]})", []


def test_every_file_loads_or_says_why_not(capsys: pytest.CaptureFixture[str]) -> None:
    loaded: Counter[str] = Counter()
    refused: Counter[str] = Counter()
    for path in files():
        kind, findings = load(path)
        if kind:
            loaded[kind] += 1
            continue
        [finding] = findings
        message = re.sub(r"`\w+`(, `\w+`)*\.", "`_`.", finding.message)
        refused[next((reason for reason in REFUSED if reason in message), message)] += 1
        assert (finding.file, bool(finding.remedy)) == (str(path), True)
        if path.name in PLACES:
            assert (finding.line, finding.column) == PLACES[path.name], path
    total = sum(loaded.values()) + sum(refused.values())
    with capsys.disabled():
        print(f"\n{total} public files: {dict(loaded)} loaded, {dict(refused)} refused")
    assert (dict(loaded), dict(refused)) == (LOADED, REFUSED)


def test_a_key_that_stands_twice_is_told() -> None:
    path = corpus() / "corpus/rpl_workcell/_history/color_picker_app/workflows/cp_wf_trashplate.yaml"
    found = import_spec(read(path, last_wins=True), drivers())
    [double] = [finding for finding in found.findings if "is there twice" in finding.message]
    assert (double.line, double.column, double.severity) == (11, 1, "warning")
    assert "modules: [pf400, barty]" in found.text


# -- what is written loads again ---------------------------------------------------------------


def check_round_trip(source: Source) -> None:
    found = import_spec(source, drivers())
    again = parse(found.text, "again.yaml")
    report = FindingList("again.yaml")
    if found.kind == "workflow":
        form, _ = convert_workflow(source, FindingList(source.file))
        written, dialect = convert_workflow(again, report)
        assert dialect == "labos"
        assert validate(WorkflowFile, written, report) == validate(WorkflowFile, form, report)
        assert report.sort_findings() == ()
        return
    form, _ = convert_workcell(source, FindingList(source.file))
    written, dialect = convert_workcell(again, report)
    assert dialect == "labos"
    file = validate(WorkcellFile, form, report)
    before, after = compile_workcell(source, drivers()), compile_workcell(again, drivers())
    assert file is not None
    assert validate(WorkcellFile, written, report) == complete_workcell(file, before, drivers())
    assert after.findings == ()
    assert after.workcell.modules == before.workcell.modules
    assert {s.name: s for s in after.workcell.stations} == {s.name: s for s in before.workcell.stations}
    assert set(after.bench.stock) == set(before.bench.stock)


def test_public_files_are_the_same_in_labos_own_form() -> None:
    count = 0
    for path in files():
        if load(path)[0]:
            check_round_trip(read(path, last_wins=True))
            count += 1
    assert count == sum(LOADED.values())


@pytest.mark.parametrize("name", ["rpl_modular_workcell", "pcr_demo_wf", "cp_wf_mixcolor"])
def test_the_papers_files_are_the_same_in_labos_own_form(name: str) -> None:
    check_round_trip(read(PAPER / f"{name}.yaml"))


@pytest.mark.parametrize("text", [SETTINGS, SETTINGS.replace("arm:", "pf400:"), FLOW])
def test_madsci_files_are_the_same_in_labos_own_form(text: str) -> None:
    check_round_trip(parse(text, "settings.yaml"))


def test_the_papers_workflow_plans_the_same_in_labos_own_form() -> None:
    cell = load_workcell(PAPER / "rpl_modular_workcell.yaml", drivers())
    source = read(PAPER / "pcr_demo_wf.yaml")
    own = parse(import_spec(source, drivers()).text)
    payload = {"seal": {"time": 3}}
    plans = [
        compile_workflow(flow, payload, cell.workcell, drivers(), simulate=True, bench=cell.bench).plan
        for flow in (source, own)
    ]
    assert plans[0] == plans[1]


def test_own_files_are_left_as_they_are() -> None:
    for kind, name in (("workcells", "rpl"), ("workflows", "pcr"), ("labware", "plates")):
        found = import_spec(read(find_spec(kind, name)), drivers())
        assert (found.dialect, found.text, found.findings) == ("labos", "", ())

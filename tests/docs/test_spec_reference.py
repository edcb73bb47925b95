"""The languages of workflow and workcell files: their keys are told, their examples compile."""

from __future__ import annotations

import re
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any, get_args

import pytest
import yaml
from pydantic import BaseModel

from labos.bootstrap import descriptions
from labos.core.model import Description, StationKind
from labos.errors import SpecError
from labos.planning.certified import check_windows
from labos.spec import (
    CompiledWorkcell,
    SpecErrors,
    compile_workflow,
    find_spec,
    list_specs,
    load_labware,
    load_workcell,
    parse_workcell,
    parse_workflow,
)
from labos.spec.dialects import detect_kind
from labos.spec.durations import SECONDS
from labos.spec.importing import import_spec
from labos.spec.models import (
    ForEach,
    LabwareType,
    ModuleEntry,
    Parameter,
    StationEntry,
    StepEntry,
    Wait,
    Within,
    WorkcellFile,
    WorkflowFile,
)
from tests.docs.markdown import REFERENCE, Block, blocks, first_codes, section, table

WORKFLOW, WORKCELL = REFERENCE / "workflow.md", REFERENCE / "workcell.md"
DIALECTS = REFERENCE / "dialects.md"


@cache
def drivers() -> dict[str, Description]:
    return descriptions()


@cache
def rpl() -> CompiledWorkcell:
    return load_workcell(find_spec("workcells", "rpl"), drivers())


def examples(page: Path) -> list[Any]:
    return [
        pytest.param(block, id=f"line {block.line}")
        for block in blocks(page.read_text())
        if block.language == "yaml"
    ]


def compile_example(block: Block) -> list[str]:
    """The findings' words. Raises SpecError or SpecErrors."""
    text = block.text
    if "fragment" in block.attributes:
        text = f"labos: 1\nname: example\nsteps:\n{text}"
    payload = yaml.safe_load(block.attributes.get("payload", "{}"))
    cell = rpl()
    used = block.attributes.get("uses", "")
    compiled = compile_workflow(
        parse_workflow(text, block.title or "example.yaml"),
        payload,
        cell.workcell,
        drivers(),
        bench=cell.bench,
        files={b.title: b.text.encode() for b in blocks(WORKFLOW.read_text()) if used and b.title == used},
    )
    return [str(finding) for finding in check_windows(compiled, cell.workcell).findings]


def check(block: Block, compiled: Callable[[], list[str]]) -> None:
    """Compiles without a word, or with just the error or warning that the page announces."""
    if error := block.attributes.get("error"):
        with pytest.raises((SpecError, SpecErrors), match=re.escape(error)):
            compiled()
        return
    warning, findings = block.attributes.get("warning", ""), compiled()
    assert all(warning and warning in finding for finding in findings), findings
    assert bool(findings) == bool(warning)


@pytest.mark.parametrize("block", examples(WORKFLOW))
def test_workflow_examples_compile(block: Block) -> None:
    check(block, lambda: compile_example(block))


def test_workflows_on_the_page_of_workcells_compile() -> None:
    known = blocks(WORKCELL.read_text())
    workflows = [block for block in known if block.language == "yml"]
    assert workflows
    for block in workflows:
        text = next(b.text for b in known if b.title == block.attributes["workcell"])
        cell = parse_workcell(text, drivers())
        source = parse_workflow(block.text, block.title)
        assert not compile_workflow(source, {}, cell.workcell, drivers(), bench=cell.bench).findings


@pytest.mark.parametrize("block", examples(WORKCELL))
def test_workcell_examples_compile(block: Block) -> None:
    if detect_kind(parse_workflow(block.text, block.title))[0] == "labware":
        assert load_labware(parse_workflow(block.text, block.title))
        return
    beside = {b.title: b.text.encode() for b in blocks(WORKCELL.read_text()) if b.title}

    def compile_block() -> list[str]:
        cell = parse_workcell(block.text, drivers(), block.title, beside)
        return [str(finding) for finding in cell.findings]

    check(block, compile_block)


@pytest.mark.parametrize("block", examples(DIALECTS))
def test_examples_of_other_labs_load_and_are_rewritten(block: Block) -> None:
    if origin := block.attributes.get("from"):
        source = next(b for b in blocks(DIALECTS.read_text()) if b.title == origin)
        assert import_spec(parse_workflow(source.text, origin), drivers()).text == block.text
        return
    kind, dialect = detect_kind(parse_workflow(block.text, block.title))
    assert dialect != "labos"
    if kind == "workflow":
        check(block, lambda: compile_example(block))
    else:
        check(block, lambda: [str(f) for f in parse_workcell(block.text, drivers(), block.title).findings])


@pytest.mark.parametrize(
    ("page", "heading", "model"),
    [
        (WORKFLOW, "Keys of the file", WorkflowFile),
        (WORKFLOW, "Keys of a parameter", Parameter),
        (WORKFLOW, "Keys of a step", StepEntry),
        (WORKCELL, "Keys of the file", WorkcellFile),
        (WORKCELL, "Keys of a module", ModuleEntry),
        (WORKCELL, "Keys of a station", StationEntry),
        (WORKCELL, "Labware types", LabwareType),
    ],
)
def test_every_key_is_told_and_no_other(page: Path, heading: str, model: type[BaseModel]) -> None:
    check_keys(first_table(section(page.read_text(), heading)), model)


@pytest.mark.parametrize(("key", "model"), [("wait", Wait), ("within", Within)])
def test_every_key_of_a_window_is_told(key: str, model: type[BaseModel]) -> None:
    text = section(WORKFLOW.read_text(), "Times between steps")
    check_keys(first_table(text[text.index(f"| key of `{key}`") :]), model)


def test_every_key_of_for_each_is_told() -> None:
    rows = first_table(section(WORKFLOW.read_text(), "Once for each element"))
    told = {row[0].strip("`"): row[1] for row in rows}
    fields = {field.alias or name: field for name, field in ForEach.model_fields.items()}
    assert {name: field.is_required() for name, field in fields.items()} == {
        name: word == "required" for name, word in told.items()
    }


def check_keys(rows: list[list[str]], model: type[BaseModel]) -> None:
    told = {row[0].strip("`"): row[1] for row in rows}
    assert list(told) == list(model.model_fields)
    for name, field in model.model_fields.items():
        assert (told[name] == "required") == field.is_required(), name
        literal = re.fullmatch(r"`(.*)`|(true|false)", told[name])
        if literal:
            assert str(field.default).lower() == (literal[1] or literal[2]), name


def first_table(text: str) -> list[list[str]]:
    """The rows of a text's first table."""
    start = text.index("| ")
    return table(text[start : (text + "\n\n").index("\n\n", start)])


def test_units_and_kinds_are_told() -> None:
    text = section(WORKFLOW.read_text(), "Times between steps")
    assert all(
        unit in SECONDS for unit in re.findall(r"with a unit: (.*?)\.", text)[0].replace("`", "").split(", ")
    )
    kinds = section(WORKCELL.read_text(), "Keys of a station")
    assert sorted(first_codes(kinds[kinds.index("| kind |") :])) == sorted(get_args(StationKind))


def test_the_packaged_specs_are_told() -> None:
    text = (REFERENCE / "cli.md").read_text()
    names = [*list_specs("workcells"), *list_specs("workflows")]
    assert [name for name in names if f"`{name}`" not in text] == []

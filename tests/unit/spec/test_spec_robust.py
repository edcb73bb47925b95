"""Whatever a file holds, it compiles or is refused with a place: nothing else is ever raised."""

from __future__ import annotations

import contextlib
from typing import Any

import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from spec_bench import BENCH, DESCRIPTIONS, PAPER, WORKCELL
from test_spec_madsci import FLOW, SETTINGS

from labos.errors import SpecError
from labos.spec import (
    Finding,
    SpecErrors,
    find_spec,
    load_labware,
    parse_workflow,
    validate_workcell,
    validate_workflow,
)
from labos.spec.findings import make_finding
from labos.spec.importing import import_spec

ODD = ["", "~", "5", "-1", "[]", "{}", "true", "x", "{a: {b: []}}", "[[1]]", "payload.x", "steps.a.result"]
FILES = {
    "paper's workflow": (PAPER / "pcr_demo_wf.yaml").read_text("utf-8"),
    "paper's workcell": (PAPER / "rpl_modular_workcell.yaml").read_text("utf-8"),
    "pcr": find_spec("workflows", "pcr").read_text("utf-8"),
    "rpl": find_spec("workcells", "rpl").read_text("utf-8"),
    "MADSci workflow": FLOW,
    "MADSci settings": SETTINGS,
}
JSON = st.recursive(
    st.none() | st.booleans() | st.integers(-5, 5) | st.floats(allow_nan=False) | st.text(max_size=5),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=5), inner, max_size=3),
    max_leaves=5,
)
KEYS = ["labos", "name", "modules", "steps", "flowdef", "stations", "stock", "locations", "args"]
KEYS += ["after", "module", "action", "command", "config", "parameters", "wait", "within", "files"]
KEYS += ["nodes", "workcell_nodes", "node", "use_parameters", "json_inputs", "feed_forward", "key", "label"]
KEYS += ["dimensions", "ordering", "wells", "xDimension", "x", "y", "A1", "command", "instruction", "nodes"]
KEYS += ["step", "data_labels", "location_name", "representations", "positions", "default", "type"]
WORDS = st.sampled_from(KEYS)
FORM = st.recursive(
    JSON | st.sampled_from(["sealer", "seal", "arm", "A4S_sealer", "pf400", "transfer", "payload.x", 1]),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(WORDS, inner, max_size=5),
    max_leaves=25,
)


def judge(text: str, payload: dict[str, Any]) -> list[Finding]:
    try:
        source = parse_workflow(text, "f.yaml")
    except SpecError as error:
        return [make_finding(error)]
    found = validate_workflow(source, payload, BENCH.workcell, DESCRIPTIONS)
    found += validate_workcell(source, DESCRIPTIONS)
    try:
        found += import_spec(source, DESCRIPTIONS).findings
    except SpecErrors as errors:
        found += errors.findings
    except SpecError as error:
        found.append(make_finding(error))
    with contextlib.suppress(SpecError, SpecErrors):
        load_labware(source)
    return found


@pytest.mark.parametrize("name", FILES)
@settings(max_examples=40, deadline=None)
@given(data=st.data())
def test_damaged_files(name: str, data: st.DataObject) -> None:
    lines = FILES[name].splitlines()
    for _ in range(data.draw(st.integers(1, 4))):
        at = data.draw(st.integers(0, len(lines) - 1))
        match data.draw(st.sampled_from(["drop", "twice", "odd", "key", "indent"])):
            case "drop":
                lines[at] = ""
            case "twice":
                lines.insert(at, lines[at])
            case "odd":
                lines[at] = lines[at].partition(":")[0] + ": " + data.draw(st.sampled_from(ODD))
            case "key":
                lines[at] = lines[at].replace("e", "i", 1)
            case "indent":
                lines[at] = "  " + lines[at]
    for finding in judge("\n".join(lines), {"x": 1}):
        assert finding.line > 0
        assert finding.remedy


@settings(max_examples=150, deadline=None)
@given(
    form=st.dictionaries(WORDS, FORM, max_size=8),
    payload=st.dictionaries(st.text(max_size=3), JSON, max_size=3),
)
def test_strange_shapes(form: dict[str, Any], payload: dict[str, Any]) -> None:
    for finding in judge(yaml.safe_dump(form, allow_unicode=True), payload):
        assert finding.remedy


@settings(max_examples=100, deadline=None)
@given(
    args=st.dictionaries(
        st.sampled_from(["time", "temperature", "source", "target", "loc", "config_path", "x"]),
        FORM,
        max_size=4,
    ),
    target=st.sampled_from(
        [("sealer", "seal"), ("arm", "transfer"), ("stack", "get_plate"), ("ot2", "run_protocol")]
    ),
    payload=st.dictionaries(st.sampled_from(["x", "y"]), JSON),
)
def test_strange_arguments(args: dict[str, Any], target: tuple[str, str], payload: dict[str, Any]) -> None:
    step = {"name": "s", "module": target[0], "action": target[1], "args": args}
    for finding in judge(yaml.safe_dump({"labos": 1, "name": "w", "steps": [step]}), payload):
        assert finding.remedy


@settings(max_examples=200, deadline=None)
@given(st.text(alphabet="ab: -[]{}&*!|>'\"#\n\t0.<~%@`,?\\é\x00", max_size=60))
def test_noise(text: str) -> None:
    judge(text, {})
    judge(WORKCELL + text, {})

"""What does not fit a model is said in LabOS' words, never in those of a library."""

from __future__ import annotations

from typing import Any

import msgspec
import pytest

from labos.spec import parse_workflow, validate_workflow
from labos.spec.mismatch import explain_plainly
from labos.spec.models import WorkcellFile, WorkflowFile
from labos.spec.validation import find_first_flaw

LIBRARY = (
    "List",
    "Input",
    "valid",
    "validation",
    "field",
    "Extra",
    "dictionary",
    "integer",
    "instance",
    "after",
)
STEP = {"name": "s", "module": "m", "action": "a"}


@pytest.mark.parametrize(
    ("told", "says"),
    [
        ({"steps": []}, "steps: should have at least 1 entry"),
        ({"steps": "x"}, "steps: should be a list"),
        ({"steps": [STEP] * 2001}, "steps: should have at most 2000 entries"),
        ({"steps": ["x"]}, "steps.0: should be a table of keys and values"),
        ({"steps": [{**STEP, "args": [1]}]}, "steps.0.args: should be a table of keys and values"),
        ({"steps": [{**STEP, "timeout": 0}]}, "should be greater than 0"),
        ({"steps": [{**STEP, "retry": {"times": 1.5}}]}, "times: should be a whole number"),
        ({"steps": [{**STEP, "retry": {"times": 101}}]}, "times: should be at most 100"),
        ({"steps": [{**STEP, "retry": {}}]}, "times: is missing"),
        ({"steps": [{**STEP, "for": 1}]}, "steps.0.for: is not known here"),
        ({"steps": [STEP], "labos": 2}, "labos: should be 1"),
        ({"steps": [STEP], "hold": {"m": 3}}, "hold.m"),
        ({"steps": [STEP], "name": 4}, "name: should be text"),
        (
            {"steps": [{**STEP, "for_each": {"item": "a", "in": [], "parallel": 7}}]},
            "should be true or false",
        ),
    ],
)
def test_in_plain_words(told: dict[str, Any], says: str) -> None:
    found = find_first_flaw(WorkflowFile, {"name": "w", **told})
    assert says in found
    _, _, words = found.partition(": ")
    assert not [word for word in words.split() if word.strip(",.") in LIBRARY], found


def test_a_workflow_without_steps() -> None:
    (found,) = validate_workflow(parse_workflow("labos: 1\nname: w\nsteps: []\n"), {}, None, {})  # type: ignore[arg-type]
    assert found.message == "The value [] does not fit: it should have at least 1 entry."


def test_a_workcell_without_modules() -> None:
    assert (
        find_first_flaw(WorkcellFile, {"name": "w", "modules": []}) == "modules: should have at least 1 entry"
    )


class Asked(msgspec.Struct, forbid_unknown_fields=True):
    user: str
    count: int = 0
    names: list[str] = []


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (b"{}", "'user' is missing"),
        (b'{"user": "a", "cuont": 1}', "'cuont' is not known here"),
        (b'{"user": "a", "count": "x"}', "count should be a whole number, not text"),
        (b'{"user": "a", "names": [1]}', "names[0] should be text, not a whole number"),
        (b"[]", "it should be a table of keys and values, not a list"),
        (b"{", "Input data was truncated"),
    ],
)
def test_a_request_in_plain_words(text: bytes, says: str) -> None:
    with pytest.raises(msgspec.MsgspecError) as error:
        msgspec.json.decode(text, type=Asked)
    assert explain_plainly(error.value) == says

"""What is written as YAML is read back as it was; comments stand where they belong."""

from __future__ import annotations

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from labos.bootstrap import descriptions
from labos.spec.emit import to_yaml
from labos.spec.importing import import_spec
from labos.spec.source import make_plain, parse

TEXT = st.text(st.characters(exclude_categories=["Cs"]), max_size=12) | st.sampled_from(
    ["yes", "No", "null", "~", "1e3", "5", "0x10", ".5", "<<", "- a", "a: b", "a #b", "{x}", "'", "payload.x"]
)
SCALAR = (
    st.none()
    | st.booleans()
    | st.integers(-(2**63), 2**63 - 1)
    | st.floats(allow_nan=False, allow_infinity=False)
    | TEXT
)
VALUE = st.recursive(
    SCALAR,
    lambda inner: st.lists(inner, max_size=5) | st.dictionaries(TEXT, inner, max_size=5),
    max_leaves=25,
)


@given(st.dictionaries(TEXT, VALUE, min_size=1, max_size=6))
def test_every_value_is_read_back_as_it_was(value: dict[str, Any]) -> None:
    assert make_plain(parse(to_yaml(value, {"": ["é # x"], "a.b": ["y\n- z"]})).data) == value


def test_comments_stand_above_what_they_speak_of() -> None:
    value = {"name": "x", "steps": [{"name": "a", "args": {"b": 1}}, {"name": "c", "args": {}}]}
    comments = {"": ["top"], "steps[1].args.gone": ["second"], "steps[0].args.b": ["first"], "nowhere": ["n"]}
    assert to_yaml(value, comments) == (
        "# top\n# n\nname: x\n\nsteps:\n  - name: a\n    # first\n    args: {b: 1}\n\n"
        "  # second\n  - name: c\n    args: {}\n"
    )


ASSUMED = [
    ("# Line 3: There is no driver for the module 'robot' (no model); it is left out.", "- {name: robot"),
    (
        "# Line 5: The place 'shelf' is assumed to be a nest: 'shelf' is not a module of this workcell.",
        "shelf: ",
    ),
]


@pytest.mark.parametrize(("comment", "line"), ASSUMED)
def test_what_was_assumed_stands_at_its_place(comment: str, line: str) -> None:
    text = """\
name: x
modules:
  - name: robot
  - {name: pf400, model: pf400}
locations: {pf400: {shelf: [1]}}
"""
    lines = [part.strip() for part in import_spec(parse(text, "x.yaml"), descriptions()).text.splitlines()]
    assert lines[lines.index(comment) + 1].startswith(line)

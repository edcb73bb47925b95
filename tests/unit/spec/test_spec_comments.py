"""Comments of a foreign file stand in the imported one, each beside what it speaks of."""

from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from labos.bootstrap import descriptions
from labos.spec.comments import read_comments
from labos.spec.importing import import_spec
from labos.spec.source import make_plain, parse

FLOW = """\
# Made by Ada.
#   Not for plates with lids.

name: Warm  # a short one
# the steps
flowdef:
  - name: heat  # at first
    module: heater
    action: warm
    args:
      # in degrees
      to: "37 # not a comment"
      note: |
        # neither is this
        #  nor this
      list: [1, 2]   # two
  # - name: shake
  #   module: heater

  #
  - name: cool
    module: heater
    action: warm
    args: {to: 20}
    # slowly
  # - name: later
  #     action: off
"""

WRITTEN = """\
# Imported from warm.yaml (WEI).
# Made by Ada.
#   Not for plates with lids.
labos: 1
# a short one
name: Warm

# the steps
steps:
  # at first
  - name: heat
    module: heater
    action: warm
    args:
      # in degrees
      to: "37 # not a comment"
      note: "# neither is this\\n#  nor this\\n"
      # two
      list: [1, 2]

  # - name: shake
  #   module: heater
  - name: cool
    module: heater
    action: warm
    args: {to: 20}

# slowly
# - name: later
#     action: off
"""


def test_each_comment_stands_beside_what_it_speaks_of() -> None:
    text = import_spec(parse(FLOW, "warm.yaml"), descriptions()).text
    assert text == WRITTEN


def test_a_workcells_comments_are_kept_too() -> None:
    cell = """\
name: cell
modules:
  # the arm
  - name: arm   # in the middle
    model: pf400
    config: {host: arm.lab}   # its address
locations:
  arm:
    # it is behind the arm
    nest: [1, 2, 3, 4, 5, 6]
"""
    lines = import_spec(parse(cell, "cell.yaml"), descriptions()).text.splitlines()
    for comment, entry in {
        "# the arm": "  # in the middle",
        "# in the middle": "  - name: arm",
        "# its address": "    config: {host: arm.lab}",
    }.items():
        (index,) = [index for index, line in enumerate(lines) if line.strip() == comment]
        assert lines[index + 1].startswith(entry), lines[index : index + 2]
    assert lines.count("    # it is behind the arm") == 1


@pytest.mark.parametrize("newline", ["\r\n", "\n"])
def test_lines_may_end_in_any_way(newline: str) -> None:
    text = "name: x # a\n# b\nflowdef: []\n# c".replace("\n", newline)
    assert [(comment.line, comment.text) for comment in read_comments(text)] == [
        (1, "# a"), (2, "# b"), (4, "# c")
    ]  # fmt: skip


@settings(max_examples=30)
@given(st.text(st.characters(exclude_categories=["Cs", "Cc"]), max_size=30))
def test_no_comment_changes_what_a_file_says(comment: str) -> None:
    text = f"name: x # {comment}\n# {comment}\nflowdef: [{{name: a, module: m, action: b}}]\n# {comment}\n"
    try:
        source = parse(text, "x.yaml")
    except Exception:  # not even YAML
        return
    bare = import_spec(
        parse("name: x\nflowdef: [{name: a, module: m, action: b}]\n", "x.yaml"), descriptions()
    )
    if make_plain(source.data) == make_plain(
        parse("name: x\nflowdef: [{name: a, module: m, action: b}]\n").data
    ):
        found = parse(import_spec(source, descriptions()).text)
        assert make_plain(found.data) == make_plain(parse(bare.text).data)

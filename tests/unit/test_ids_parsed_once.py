"""Names and ids are taken apart in ``labos/core/ids.py``, and the keys that name them are made there; those
that only planning knows, in its own modules."""

from __future__ import annotations

import ast
from collections import Counter
from collections.abc import Iterator, Sequence, Set
from pathlib import Path

import pytest

LABOS = Path(__file__).parents[2] / "labos"
SPLIT = ("partition", "rpartition", "split", "rsplit")
BEGINS = ("startswith", "removeprefix")
KINDS = ("access:", "deck:", "experiment:", "group:", "module:", "run:", "station:", "user:", "zone:")
OF_PLANNING = {
    "planning/held.py": ("door:", "hold:", "joint:", "ready:", "setpoint:", "variable:"),
    "planning/touch.py": (
        "begun:",
        "bench:",
        "cell:",
        "due:",
        "near:",
        "over:",
        "standing:",
        "window:",
    ),
}
"""Kinds of keys that are made in one module of planning."""

NAMES_OF_STATIONS = ("core", "planning", "spec")
"""Here a text that is taken apart at a point may be the name of a station."""

OTHER_TEXTS = {
    "adapter/registry.py": 1,  # the place of a Python class
    "adapter/ros_bridge.py": 2,  # names of ROS
    "adapter/sila/client.py": 1,  # names of gRPC services
    "adapter/sila/node.py": 2,  # an address, an identifier of SiLA
    "adapter/wei.py": 2,  # paths of files
    "audit/graph.py": 1,  # a well of labware
    "audit/liquids.py": 2,  # a well of labware
    "audit/provenance.py": 1,  # what a person asks about
    "bootstrap/_lab.py": 1,  # an address
    "bootstrap/_node.py": 1,  # a key of the bus
    "cli/_node_install.py": 1,  # a name that is checked
    "cli/do.py": 1,  # a name with or without its workcell
    "client/_calls.py": 1,  # a call of Python
    "client/_globus.py": 1,  # an address
    "client/_runs.py": 1,  # a name with or without its workcell
    "core/users.py": 2,  # the subjects of roles
    "http/desk.py": 1,  # a key of the bus
    "http/door.py": 1,  # an address
    "http/service.py": 1,  # a name with or without its workcell
    "node/_name.py": 2,  # keys of the bus
    "node/protocol.py": 2,  # keys of the bus
    "pki/_party.py": 1,  # a URN
    "runtime/dispatcher.py": 1,  # a key of the bus
    "runtime/incoming.py": 2,  # keys of the bus
    "runtime/marks.py": 1,  # the mark of a request
    "runtime/registry.py": 1,  # a key of the bus
    "settings.py": 3,  # settings
    "spec/interfaces.py": 1,  # an address
    "spec/stations.py": 1,  # a name with or without its workcell
    "store/_objects.py": 1,  # a path
    "testing/bus.py": 1,  # keys of the bus
    "torture/process.py": 1,  # the place of a Python class
}
"""Where something else than an id is taken apart at a colon or a slash, and how often."""

OTHER_POINTS = {
    "core/effects.py": 1,  # a field of a result
    "spec/amounts.py": 1,  # a value in a file
    "spec/references.py": 1,  # a field of a result
    "spec/rows.py": 1,  # a key of a payload
    "spec/unroll.py": 1,  # a key of a payload
}
"""Where something else than the name of a station is taken apart at a point, and how often."""


def find_calls(
    tree: ast.AST, marks: Set[str] = frozenset({":", "/"}), kinds: Set[str] = frozenset(KINDS)
) -> Iterator[ast.expr]:
    """Where a text is taken apart at a mark, compared with a kind of key, or made into a key."""
    for node in ast.walk(tree):
        match node:
            case ast.Call(func=ast.Attribute(attr=name), args=[first, *_]):
                texts = first.elts if isinstance(first, ast.Tuple) else [first]
                words = [text.value for text in texts if isinstance(text, ast.Constant)]
                if (name in SPLIT and marks & set(words)) or (name in BEGINS and kinds & set(words)):
                    yield node
            case ast.JoinedStr(values=[ast.Constant(value=text), *_]) if text in kinds:
                yield node


def count_calls(home: str, parts: Sequence[str] = ("",), **looked_for: Set[str]) -> Counter[str]:
    files = [file for part in parts for file in (LABOS / part).rglob("*.py") if file != LABOS / home]
    return Counter(
        str(file.relative_to(LABOS))
        for file in files
        for _ in find_calls(ast.parse(file.read_text()), **looked_for)
    )


def test_nothing_but_ids_takes_ids_apart() -> None:
    assert count_calls("core/ids.py") == OTHER_TEXTS


def test_nothing_but_ids_takes_names_of_stations_apart() -> None:
    found = count_calls("core/ids.py", NAMES_OF_STATIONS, marks={"."}, kinds=frozenset())
    assert found == OTHER_POINTS


@pytest.mark.parametrize("home", OF_PLANNING)
def test_keys_of_planning_are_made_in_one_module(home: str) -> None:
    assert not count_calls(home, marks=frozenset(), kinds={*OF_PLANNING[home]})


def test_such_calls_are_found() -> None:
    texts = [
        'a.partition(":")[2]',
        'a.startswith(("x", "run:"))',
        'f"station:{a}"',
        'a.rsplit("/", 1)',
        "a[0]",
        'a.partition(".")[0]',
    ]
    assert [len(list(find_calls(ast.parse(text)))) for text in texts] == [1, 1, 1, 1, 0, 0]
    assert len(list(find_calls(ast.parse(texts[-1]), marks={"."}))) == 1

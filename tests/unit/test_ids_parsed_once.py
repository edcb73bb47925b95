"""Names and ids are taken apart in ``labos/core/ids.py``, and the keys that name them are made there."""

from __future__ import annotations

import ast
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

LABOS = Path(__file__).parents[2] / "labos"
SPLIT = ("partition", "rpartition", "split", "rsplit")
BEGINS = ("startswith", "removeprefix")
KINDS = ("access:", "deck:", "experiment:", "group:", "module:", "run:", "station:", "user:", "zone:")

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
    "torture/process.py": 1,  # the place of a Python class
}
"""Where something else than an id is taken apart at a colon or a slash, and how often."""


def find_calls(tree: ast.AST) -> Iterator[ast.expr]:
    """Where a text is taken apart at a colon or a slash, compared with a kind of key, or made into a key."""
    for node in ast.walk(tree):
        match node:
            case ast.Call(func=ast.Attribute(attr=name), args=[first, *_]):
                texts = first.elts if isinstance(first, ast.Tuple) else [first]
                words = [text.value for text in texts if isinstance(text, ast.Constant)]
                if (name in SPLIT and {":", "/"} & set(words)) or (name in BEGINS and {*KINDS} & set(words)):
                    yield node
            case ast.JoinedStr(values=[ast.Constant(value=text), *_]) if text in KINDS:
                yield node


def test_nothing_but_ids_takes_ids_apart() -> None:
    files = [file for file in LABOS.rglob("*.py") if file != LABOS / "core" / "ids.py"]
    found = Counter(
        str(file.relative_to(LABOS)) for file in files for _ in find_calls(ast.parse(file.read_text()))
    )
    assert found == OTHER_TEXTS


def test_such_calls_are_found() -> None:
    texts = [
        'a.partition(":")[2]',
        'a.startswith(("x", "run:"))',
        'f"station:{a}"',
        'a.rsplit("/", 1)',
        "a[0]",
    ]
    assert [len(list(find_calls(ast.parse(text)))) for text in texts] == [1, 1, 1, 1, 0]

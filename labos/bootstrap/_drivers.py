"""Drivers are found by their entry points, so that installing a package adds an instrument."""

from __future__ import annotations

from importlib.metadata import EntryPoint, entry_points

import msgspec

from labos.core.model import Description
from labos.errors import NotFound
from labos.node.node import Node

GROUP = "labos.drivers"


class Drivers(msgspec.Struct):
    """Node classes by driver name, and why the others cannot be used."""

    classes: dict[str, type[Node]] = {}
    broken: dict[str, str] = {}

    def descriptions(self) -> dict[str, Description]:
        return {name: node.describe() for name, node in self.classes.items()}


def load_drivers() -> Drivers:
    """Every installed driver. One that cannot be loaded is reported, and spoils no other."""
    found = Drivers()
    for entry in entry_points(group=GROUP):
        try:
            node = _load(entry)
            node.describe()
        except Exception as error:
            found.broken[entry.name] = f"{type(error).__name__}: {error}"
        else:
            found.classes[entry.name] = node
    return found


def load_driver(name: str) -> type[Node]:
    """The node class of a driver. Raises NotFound."""
    for entry in entry_points(group=GROUP, name=name):
        return _load(entry)
    known = ", ".join(sorted({entry.name for entry in entry_points(group=GROUP)}))
    raise NotFound(f"There is no driver {name!r}.", remedy=f"Installed: {known or 'none'}.")


def descriptions() -> dict[str, Description]:
    """What each installed driver says of itself."""
    return load_drivers().descriptions()


def _load(entry: EntryPoint) -> type[Node]:
    node = entry.load()
    if not (isinstance(node, type) and issubclass(node, Node)):
        raise TypeError(f"{entry.value} is not a Node class")
    return node

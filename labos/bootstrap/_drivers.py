"""Drivers are found by their entry points, so that installing a package adds an instrument."""

from __future__ import annotations

import importlib.util
import inspect
import sys
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING

import msgspec

from labos.errors import BadInput, NotFound, SpecError
from labos.node.node import Node

if TYPE_CHECKING:
    from labos.spec.description import DescriptionFile
    from labos.spec.tables import Descriptions

GROUP = "labos.drivers"
DESCRIPTION = "description.yaml"


class Drivers(msgspec.Struct):
    """Node classes by driver name, and why the others cannot be used."""

    classes: dict[str, type[Node]] = {}
    broken: dict[str, str] = {}

    def descriptions(self) -> Descriptions:
        # Not loaded by nodes: reading specs takes time and memory.
        from labos.spec.tables import Descriptions

        known = {name: node.describe() for name, node in self.classes.items()}
        tables = {name: node.config_table for name, node in self.classes.items() if node.config_table}
        counters = {name: node.counters for name, node in self.classes.items() if node.counters}
        return Descriptions(known, tables, counters)


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
    """The node class of an installed driver, or of a file: ``shaker.py``, or ``shaker.py:Shaker`` if it
    holds several. Raises NotFound, BadInput."""
    path, _, wanted = name.partition(".py")
    if (wanted == "" and path != name) or wanted.startswith(":"):
        return _in_file(Path(f"{path}.py"), wanted[1:])
    for entry in entry_points(group=GROUP, name=name):
        return _load(entry)
    known = ", ".join(sorted({entry.name for entry in entry_points(group=GROUP)}))
    raise NotFound(
        f"There is no driver {name!r}.",
        remedy=f"Installed: {known or 'none'}. One in a file is named by it: shaker.py.",
    )


def description_path(node: type[Node]) -> Path:
    """Where a driver describes its instrument as a thing in space: the file beside its class. Raises
    NotFound."""
    path = Path(inspect.getfile(node)).with_name(DESCRIPTION)
    if not path.is_file():
        raise NotFound(
            f"The driver {node.driver!r} has no {DESCRIPTION}.",
            remedy=f"Write {path}; `labos driver new` begins with one.",
        )
    return path


def shape_of(driver: str) -> DescriptionFile | None:
    """A driver's instrument as a thing in space; None for one that is not described, or not well."""
    from labos.spec.describing import load_description

    try:
        return load_description(description_path(load_driver(driver)))
    except (BadInput, NotFound, SpecError):
        return None


def descriptions() -> Descriptions:
    """What each installed driver says of itself."""
    return load_drivers().descriptions()


def _load(entry: EntryPoint) -> type[Node]:
    node = entry.load()
    if not (isinstance(node, type) and issubclass(node, Node)):
        raise TypeError(f"{entry.value} is not a Node class")
    return node


def _in_file(path: Path, wanted: str) -> type[Node]:
    if not path.is_file():
        raise NotFound(f"There is no file {path}.", remedy="Name a Python file that holds a driver.")
    module = _imported(path.resolve())
    found = {
        name: kind
        for name, kind in vars(module).items()
        if isinstance(kind, type) and issubclass(kind, Node) and kind.__module__ == module.__name__
    }
    named = {name: kind for name, kind in found.items() if name == wanted or (not wanted and kind.driver)}
    if len(named) != 1:
        raise BadInput(
            f"{path} holds {'no' if not named else 'more than one'} driver{f' {wanted}' if wanted else ''}.",
            remedy=f"Write {path}:CLASS; it has {', '.join(found) or 'no class of Node'}.",
        )
    return next(iter(named.values()))


def _imported(path: Path) -> ModuleType:
    """The module of a file, as a program in its folder would import it."""
    sys.path.insert(0, str(path.parent))
    known = sys.modules.get(path.stem)
    if known is not None and Path(known.__file__ or "").resolve() == path:
        return known
    spec = importlib.util.spec_from_file_location(path.stem, path)
    if spec is None or spec.loader is None:
        raise BadInput(f"{path} cannot be imported.", remedy="Give it a name that Python can import.")
    module = sys.modules[path.stem] = importlib.util.module_from_spec(spec)
    try:
        spec.loader.exec_module(module)
    except Exception as error:
        del sys.modules[path.stem]
        raise BadInput(f"{path} cannot be imported: {type(error).__name__}: {error}.") from error
    return module

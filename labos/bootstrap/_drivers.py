"""Drivers are found by their entry points, so an instrument is added by installing a package."""

from __future__ import annotations

import importlib.util
import inspect
import sys
from collections.abc import Sequence
from importlib import import_module
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
    """Node classes by driver name, and the reasons why other drivers cannot be used."""

    classes: dict[str, type[Node]] = {}
    broken: dict[str, str] = {}

    def make_descriptions(self) -> Descriptions:
        # Nodes do not load this: reading specs takes time and memory.
        from labos.spec.tables import Descriptions

        known = {name: node.describe() for name, node in self.classes.items()}
        tables = {name: node.config_table for name, node in self.classes.items() if node.config_table}
        counters = {name: node.counters for name, node in self.classes.items() if node.counters}
        return Descriptions(known, tables, counters, self.broken)


def load_drivers() -> Drivers:
    """Every installed driver. A driver that cannot be loaded, or whose name is used by two packages, is
    reported; the other drivers can be used."""
    found = Drivers()
    for name, entries in list_installed().items():
        try:
            node = _choose_only(name, entries)
            node.describe()
        except BadInput as error:
            found.broken[name] = str(error)
        except Exception as error:
            found.broken[name] = f"{type(error).__name__}: {error}"
        else:
            found.classes[name] = node
    return found


def list_installed() -> dict[str, list[EntryPoint]]:
    """The entry points for each driver's name; there are several if packages use the same name."""
    found: dict[str, list[EntryPoint]] = {}
    for entry in entry_points(group=GROUP):
        same = found.setdefault(entry.name, [])
        # A package that was renamed may have left its old entry points, which name the same class.
        if entry.value not in [other.value for other in same]:
            same.append(entry)
    return found


def load_driver(name: str) -> type[Node]:
    """The node class of an installed driver, or of a file: ``shaker.py``, or ``shaker.py:Shaker`` if it
    holds several. Raises NotFound, BadInput: also if two packages install a driver of that name."""
    path, _, wanted = name.partition(".py")
    if (wanted == "" and path != name) or wanted.startswith(":"):
        return _load_from_file(Path(f"{path}.py"), wanted[1:])
    found = list_installed()
    if name in found:
        return _choose_only(name, found[name])
    raise NotFound(
        f"There is no driver {name!r}.",
        remedy=f"Installed: {', '.join(sorted(found)) or 'none'}. For a driver in a file, give the file: "
        "shaker.py.",
    )


def find_description_path(node: type[Node]) -> Path:
    """The file with the geometry of a driver's instrument, beside its class. Raises NotFound."""
    path = Path(inspect.getfile(node)).with_name(DESCRIPTION)
    if not path.is_file():
        raise NotFound(
            f"The driver {node.driver!r} has no {DESCRIPTION}.",
            remedy=f"Write {path}; `labos driver new` begins with one.",
        )
    return path


def shape_of(driver: str) -> DescriptionFile | None:
    """The geometry of a driver's instrument; None if it has no description or a faulty one."""
    from labos.spec.describing import load_description

    try:
        return load_description(find_description_path(load_driver(driver)))
    except (BadInput, NotFound, SpecError):
        return None


def descriptions() -> Descriptions:
    """The descriptions of all installed drivers."""
    return load_drivers().make_descriptions()


def source_of(entry: EntryPoint) -> str:
    """The package that installs a driver, and the driver's class."""
    package = f"{entry.dist.name} {entry.dist.version}" if entry.dist else "a package without a name"
    return f"{package} ({entry.value})"


def _choose_only(name: str, entries: Sequence[EntryPoint]) -> type[Node]:
    """The only class with a name. If there are two, the lab might plan with one while its node runs the
    other, so none is used. Raises BadInput."""
    if len(entries) > 1:
        raise BadInput(
            f"{len(entries)} packages install a driver named {name!r}: "
            f"{' and '.join(sorted(source_of(entry) for entry in entries))}.",
            remedy="Uninstall one of them, or give its driver another name: in its class and in its "
            "pyproject.toml.",
        )
    entry = entries[0]
    node = entry.load()
    if not (isinstance(node, type) and issubclass(node, Node)):
        raise TypeError(f"{entry.value} is not a Node class")
    return node


def _load_from_file(path: Path, wanted: str) -> type[Node]:
    if not path.is_file():
        raise NotFound(f"There is no file {path}.", remedy="Name a Python file that holds a driver.")
    module = _import_package(path.resolve())
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


def import_module_beside(node: type[Node], name: str) -> ModuleType | None:
    """The module of that name in the folder of a driver's class, imported like the class; None if there is no
    such file. Raises BadInput."""
    package = node.__module__.rpartition(".")[0]
    if package:
        return import_module(f"{package}.{name}") if importlib.util.find_spec(f"{package}.{name}") else None
    path = Path(inspect.getfile(node)).with_name(f"{name}.py")
    return _import_package(path.resolve()) if path.is_file() else None


def _import_package(path: Path) -> ModuleType:
    """The module of a file. It is imported as by a program with the file's folder, or the folder of its
    outermost package, in its path. So imports of its package and of files beside it work."""
    folder, name = path.parent, path.stem
    while (folder / "__init__.py").is_file():
        name, folder = f"{folder.name}.{name}", folder.parent
    sys.path.insert(0, str(folder))
    try:
        module = import_module(name) if "." in name else _import_file(path)
    except BadInput:
        raise
    except Exception as error:
        raise BadInput(f"{path} cannot be imported: {type(error).__name__}: {error}.") from error
    if Path(module.__file__ or "").resolve() != path:
        raise BadInput(
            f"{path} cannot be imported as {name}: {module.__file__} is already loaded with that name.",
            remedy="Give its package another name.",
        )
    return module


def _import_file(path: Path) -> ModuleType:
    """The module of a file that is not part of a package."""
    known = sys.modules.get(path.stem)
    if known is not None and Path(known.__file__ or "").resolve() == path:
        return known
    spec = importlib.util.spec_from_file_location(path.stem, path)
    if spec is None or spec.loader is None:
        raise BadInput(f"{path} cannot be imported.", remedy="Give it a name that Python can import.")
    module = sys.modules[path.stem] = importlib.util.module_from_spec(spec)
    try:
        spec.loader.exec_module(module)
    except Exception:
        del sys.modules[path.stem]
        raise
    return module

"""The one place that names concrete parts: drivers, the kernel's process, a node's process.

Names are imported when they are used: a node's process must not load the kernel's parts.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from labos.bootstrap._api import ApiSettings, open_api
    from labos.bootstrap._drivers import (
        Drivers,
        descriptions,
        find_description_path,
        import_module_beside,
        list_installed,
        load_driver,
        load_drivers,
        shape_of,
        source_of,
    )
    from labos.bootstrap._lab import open_lab
    from labos.bootstrap._node import run_node
    from labos.bootstrap._node_class import find_own_class
    from labos.bootstrap._notify import find_contacts, make_notifier
    from labos.bootstrap._runtime import LabRuntime
    from labos.bootstrap._secure import Guard
    from labos.bootstrap._stop import stop_over_bus
    from labos.bootstrap._thread import LabThread

_HOME = {
    "ApiSettings": "_api",
    "Drivers": "_drivers",
    "Guard": "_secure",
    "LabRuntime": "_runtime",
    "LabThread": "_thread",
    "find_description_path": "_drivers",
    "descriptions": "_drivers",
    "find_contacts": "_notify",
    "list_installed": "_drivers",
    "load_driver": "_drivers",
    "load_drivers": "_drivers",
    "import_module_beside": "_drivers",
    "open_api": "_api",
    "open_lab": "_lab",
    "find_own_class": "_node_class",
    "run_node": "_node",
    "shape_of": "_drivers",
    "source_of": "_drivers",
    "make_notifier": "_notify",
    "stop_over_bus": "_stop",
}

__all__ = [
    "ApiSettings",
    "Drivers",
    "Guard",
    "LabRuntime",
    "LabThread",
    "descriptions",
    "find_contacts",
    "find_description_path",
    "find_own_class",
    "import_module_beside",
    "list_installed",
    "load_driver",
    "load_drivers",
    "make_notifier",
    "open_api",
    "open_lab",
    "run_node",
    "shape_of",
    "source_of",
    "stop_over_bus",
]


def __getattr__(name: str) -> Any:
    from importlib import import_module

    if name not in _HOME:
        raise AttributeError(name)
    return getattr(import_module(f"labos.bootstrap.{_HOME[name]}"), name)

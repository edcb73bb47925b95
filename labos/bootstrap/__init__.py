"""The one place that names concrete parts: drivers, the kernel's process, a node's process.

Names are imported when they are used: a node's process must not load the kernel's parts.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from labos.bootstrap._api import ApiSettings as ApiSettings
    from labos.bootstrap._api import open_api as open_api
    from labos.bootstrap._drivers import descriptions as descriptions
    from labos.bootstrap._drivers import find_description_path as find_description_path
    from labos.bootstrap._drivers import import_module_beside as import_module_beside
    from labos.bootstrap._drivers import list_installed as list_installed
    from labos.bootstrap._drivers import load_driver as load_driver
    from labos.bootstrap._drivers import load_drivers as load_drivers
    from labos.bootstrap._drivers import shape_of as shape_of
    from labos.bootstrap._drivers import source_of as source_of
    from labos.bootstrap._lab import open_lab as open_lab
    from labos.bootstrap._node import run_node as run_node
    from labos.bootstrap._node_class import find_own_class as find_own_class
    from labos.bootstrap._notify import find_contacts as find_contacts
    from labos.bootstrap._notify import make_notifier as make_notifier
    from labos.bootstrap._runtime import LabRuntime as LabRuntime
    from labos.bootstrap._secure import Guard as Guard
    from labos.bootstrap._stop import stop_over_bus as stop_over_bus
    from labos.bootstrap._thread import LabThread as LabThread

_HOMES = {
    "_api": ("ApiSettings", "open_api"),
    "_drivers": (
        *("descriptions", "find_description_path", "import_module_beside", "list_installed"),
        *("load_driver", "load_drivers", "shape_of", "source_of"),
    ),
    "_lab": ("open_lab",),
    "_node": ("run_node",),
    "_node_class": ("find_own_class",),
    "_notify": ("find_contacts", "make_notifier"),
    "_runtime": ("LabRuntime",),
    "_secure": ("Guard",),
    "_stop": ("stop_over_bus",),
    "_thread": ("LabThread",),
}


def __getattr__(name: str) -> Any:
    from importlib import import_module

    home = next((home for home, names in _HOMES.items() if name in names), None)
    if home is None:
        raise AttributeError(name)
    return getattr(import_module(f"labos.bootstrap.{home}"), name)

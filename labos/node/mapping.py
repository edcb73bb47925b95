"""Parts for drivers with a configuration table, and functions for reading such tables.

A driver gives its class a ``config_table``. The workcell file has the table below that key of ``config``, or
names a file with it. Faults in it are reported with file, line, column and remedy.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from labos.spec.about import About as About
    from labos.spec.about import ArgAbout as ArgAbout
    from labos.spec.about import BadEffect as BadEffect
    from labos.spec.about import StationAbout as StationAbout
    from labos.spec.about import make_description as make_description
    from labos.spec.findings import suggest_name as suggest_name
    from labos.spec.parts import Many as Many
    from labos.spec.parts import Name as Name
    from labos.spec.parts import Part as Part
    from labos.spec.parts import Seconds as Seconds
    from labos.spec.tables import DriverTable as DriverTable
    from labos.spec.tables import Flaw as Flaw
    from labos.spec.tables import read_table as read_table

_HOMES = {
    "labos.spec.about": ("About", "ArgAbout", "BadEffect", "StationAbout", "make_description"),
    "labos.spec.findings": ("suggest_name",),
    "labos.spec.parts": ("Many", "Name", "Part", "Seconds"),
    "labos.spec.tables": ("DriverTable", "Flaw", "read_table"),
}


def __getattr__(name: str) -> Any:
    # Reading specs takes time and memory, which nodes without a table do not need.
    for home, names in _HOMES.items():
        if name in names:
            return getattr(import_module(home), name)
    raise AttributeError(name)

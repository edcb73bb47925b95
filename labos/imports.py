"""Imports that leave out what a library loads only because it happens to be installed."""

from __future__ import annotations

import sys
from importlib import import_module
from types import ModuleType


def import_without(name: str, *optional: str) -> ModuleType:
    """Import a module as if the ``optional`` packages were not installed, which saves their time and memory.

    What is loaded already is left as it is, and the packages can be imported afterwards. Meanwhile they are
    missing in all threads, so call this before other threads import them.
    """
    hidden = [package for package in optional if package not in sys.modules]
    for package in hidden:
        sys.modules[package] = None  # type: ignore[assignment]
    try:
        return import_module(name)
    finally:
        for package in hidden:
            del sys.modules[package]

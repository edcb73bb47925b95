"""The version of this LabOS."""

from __future__ import annotations

from importlib.metadata import PackageNotFoundError, version

try:
    VERSION = version("labos-sdl")
except PackageNotFoundError:  # run from its sources, without an installation
    VERSION = "unknown"

"""Which LabOS this is."""

from __future__ import annotations

from importlib.metadata import PackageNotFoundError, version

try:
    VERSION = version("labos-sdl")
except PackageNotFoundError:  # run from its sources, without having been installed
    VERSION = "unknown"

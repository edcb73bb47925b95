"""What a file of tests needs beside LabOS."""

from __future__ import annotations

from importlib.util import find_spec

import pytest


def need(module: str, extra: str) -> None:
    """Skip the file where a module of an extra is not installed. It is not imported: every process that
    collects the tests would spend its time on that."""
    if find_spec(module) is None:
        pytest.skip(f"needs labos-sdl[{extra}]", allow_module_level=True)

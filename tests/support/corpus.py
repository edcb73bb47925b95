"""Public files of another laboratory, where the environment names them."""

from __future__ import annotations

import os
from pathlib import Path

import pytest


def corpus() -> Path:
    """The folder of public files that LABOS_CORPUS points to; skips without it."""
    folder = os.environ.get("LABOS_CORPUS")
    if not folder:
        pytest.skip("LABOS_CORPUS is not set")
    return Path(folder)

"""LabOS in another version: a copy of its source that says so of itself."""

from __future__ import annotations

import re
import shutil
from importlib.metadata import distribution
from pathlib import Path

ROOT = Path(__file__).parents[2]


def copy_as(version: str, to: Path) -> str:
    """Copy what is installed here; returns the PYTHONPATH by which it is used."""
    for name in ("labos", "drivers", "migrations", "specs", "deploy"):
        shutil.copytree(ROOT / name, to / name, ignore=shutil.ignore_patterns("__pycache__"))
    here = next(
        Path(str(file.locate())).parent
        for file in distribution("labos-sdl").files or ()
        if file.name == "METADATA"
    )
    there = to / f"labos_sdl-{version}.dist-info"
    shutil.copytree(here, there)
    told = there / "METADATA"
    told.write_text(
        re.sub(r"^Version: .*$", f"Version: {version}", told.read_text(), count=1, flags=re.MULTILINE)
    )
    return f"{to}:{to / 'drivers'}"

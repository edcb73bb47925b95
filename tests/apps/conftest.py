"""The applications' own modules can be imported, as they can when one is started; a lab on which they run."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import Any

import pytest

from labos.bootstrap import LabThread, descriptions
from labos.settings import Settings
from labos.spec import find_spec, load_workcell, parse_workcell
from labos.spec.library import find_specs_folder

for app in ("polymers", "pendant_drop", "color_picker", "pcr"):
    sys.path.append(str(find_specs_folder() / "apps" / app))

OpenLab = Callable[..., AbstractContextManager[LabThread]]


@pytest.fixture
def open_lab(tmp_path: Path) -> OpenLab:
    """A simulated lab with a packaged workcell, in which texts may be replaced."""

    @contextmanager
    def open_it(workcell: str, speed: float, *changes: tuple[str, Any], seed: int = 0) -> Iterator[LabThread]:
        path, known = find_spec("workcells", workcell), descriptions()
        text = path.read_text("utf-8")
        for old, new in changes:
            assert old in text
            text = text.replace(old, str(new))
        cell = parse_workcell(text, known) if changes else load_workcell(path, known)
        settings = Settings.make(tmp_path / "lab", speed=speed, simulate=True, seed=seed)
        with LabThread(settings, [cell]) as lab:
            yield lab

    return open_it

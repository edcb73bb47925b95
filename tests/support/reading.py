"""A lab of one plate reader, for those who try the client."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from labos.bootstrap import LabThread, descriptions
from labos.settings import Settings
from labos.spec import load_workcell

CELL = "labos: 1\nname: reading\nmodules:\n  - {name: hidex, model: Hidex}\n"

WORKFLOW = """\
labos: 1
name: read
parameters:
  assay: {default: OD590}
steps:
  - {name: Close, module: hidex, action: close_lid}
  - {name: Read, module: hidex, action: read_plate, args: {assay: payload.assay}}
  - {name: Open, module: hidex, action: open_lid}
"""


@contextmanager
def open_reading_lab(folder: Path, *, speed: float = 5000) -> Iterator[LabThread]:
    """The lab, in ``folder/lab``; the workflow stands beside it as ``read.yaml``. The plate is the first
    run's to bring."""
    (folder / "cell.yaml").write_text(CELL)
    (folder / "read.yaml").write_text(WORKFLOW)
    cell = load_workcell(folder / "cell.yaml", descriptions())
    with LabThread(Settings.make(folder / "lab", simulate=True, speed=speed), [cell]) as lab:
        yield lab

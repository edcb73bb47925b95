"""Commands that run a file look at it as the lab does, whatever laboratory it comes from."""

from __future__ import annotations

from pathlib import Path

from labos.cli._lab import check_first, read_workcell
from labos.client import workflow_text

TWICE = """\
name: twice
name: Seal
flowdef:
  - {name: s, module: sealer, command: seal, args: {foo: bar}}
"""


def test_a_foreign_file_with_a_key_written_twice_is_not_refused_first(tmp_path: Path) -> None:
    file = tmp_path / "twice.yaml"
    file.write_text(TWICE)
    check_first(workflow_text(file), {}, read_workcell("rpl"), simulate=True)

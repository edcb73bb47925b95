"""Where a node keeps its journal is said, and does not follow from where its command was typed."""

from __future__ import annotations

from pathlib import Path

import pytest

from labos.errors import BadInput
from labos.settings import HOME
from tests.unit.cli_files.calls import call


def test_a_node_of_a_real_device_does_not_make_its_folder_where_it_happens_to_start(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv(HOME, raising=False)
    words = ["node", "start", "a4s_sealer", "--name", "sealer", "--workcell", "rpl"]
    with pytest.raises(BadInput) as refused:
        call(*words)
    assert str(tmp_path / "lab") in refused.value.message
    assert "--home DIR" in refused.value.remedy
    assert list(tmp_path.iterdir()) == []

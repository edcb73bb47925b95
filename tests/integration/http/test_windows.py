"""Submissions whose windows cannot be kept for all durations: let in with a warning, or refused."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from labos.bootstrap import LabThread, descriptions
from labos.client import LabClient
from labos.errors import BadInput
from labos.settings import Settings
from labos.spec import find_spec, load_workcell

TIGHT = """\
labos: 1
name: tight
{top}
steps:
- {{name: Open, module: biometra, action: open_lid}}
- {{name: Close, module: biometra, action: close_lid}}
- name: Open again
  module: biometra
  action: open_lid
  within: {{after: Open, at_most: {most}}}
"""
MISSED = "'Open again' within 20 s of the end of 'Open': can be missed by 2 s, if 'Close' takes 22 s."


@pytest.fixture(scope="module")
def client(tmp_path_factory: pytest.TempPathFactory) -> Iterator[LabClient]:
    cell = load_workcell(find_spec("workcells", "rpl"), descriptions())
    settings = Settings.make(tmp_path_factory.mktemp("lab"), speed=5000.0, simulate=True)
    with LabThread(settings, [cell], nodes="none") as lab, LabClient(lab.url) as found:
        yield found


def write(folder: Path, top: str = "", most: int = 20) -> Path:
    file = folder / "tight.yaml"
    file.write_text(TIGHT.format(top=top, most=most))
    return file


def test_a_run_is_let_in_with_a_warning(client: LabClient, tmp_path: Path) -> None:
    client.submit(write(tmp_path), user="ada")
    [warning] = client.warnings
    assert MISSED in warning
    client.submit(write(tmp_path, "windows: accept"), user="ada")
    assert not client.warnings


def test_a_run_is_refused_where_its_workflow_says_so(client: LabClient, tmp_path: Path) -> None:
    before = client.runs()
    with pytest.raises(BadInput) as refused:
        client.submit(write(tmp_path, "windows: refuse"), user="ada")
    assert "tight.yaml:10:11: steps[2].within: " + MISSED in str(refused.value)
    assert client.runs() == before
    assert client.submit(write(tmp_path, "windows: refuse", 22), user="ada")
    assert not client.warnings


def test_a_campaign_is_refused_by_its_row(client: LabClient, tmp_path: Path) -> None:
    write(tmp_path, "windows: refuse")
    screen = tmp_path / "screen.yaml"
    screen.write_text("labos: 1\ncampaign: screen\nworkflow: tight.yaml\nrows: {list: [{}]}\n")
    with pytest.raises(BadInput, match="can be missed by 2 s"):
        client.submit_campaign(screen, user="ada")

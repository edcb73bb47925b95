"""Every byte on a device's wires, of a node that runs and from the start of a lab."""

from __future__ import annotations

from pathlib import Path

from tests.support.lab_process import Up, labos, until

CELL = """\
labos: 1
name: corner
modules:
  - {name: sealer, model: A4S_sealer}
"""


def test_a_running_node_writes_down_what_goes_over_its_wires_until_it_is_told_to_stop(tmp_path: Path) -> None:
    cell = tmp_path / "corner.yaml"
    cell.write_text(CELL)
    lab = Up(tmp_path / "lab", "--simulate", "--wire", "--speed", "1000")
    home = ("--home", str(lab.home))
    file = lab.home / "traces" / "corner.sealer.txt"
    try:
        lab.start(str(cell))
        with lab.client() as client:
            until(lambda: client.ask_nodes()[0]["answer"] == "IDLE", "the sealer is there")
            assert not file.exists()
            assert labos("node", "trace", "sealer", *home).stdout == f"sealer: written to {file}\n"
            assert labos("reset", "sealer", *home).returncode == 0
            assert "\tsealer\t>\t*00SR" in file.read_text()
            assert "*Y00" in file.read_text()
            assert file.stat().st_mode & 0o077 == 0
            assert labos("node", "trace", "sealer", "--off", *home).returncode == 0
            written = file.stat().st_size
            assert labos("reset", "sealer", *home).returncode == 0
            assert file.stat().st_size == written
        assert lab.interrupt() == 0
    finally:
        lab.clean_up()


def test_a_lab_writes_down_all_wires_from_the_start(tmp_path: Path) -> None:
    cell = tmp_path / "corner.yaml"
    cell.write_text(CELL)
    lab = Up(tmp_path / "lab", "--simulate", "--wire", "--speed", "1000", "--trace")
    try:
        lab.start(str(cell))
        with lab.client() as client:
            until(lambda: client.ask_nodes()[0]["answer"] == "IDLE", "the sealer is there")
        lines = (lab.home / "traces" / "corner.sealer.txt").read_text().splitlines()
        assert lines[0] == "# labos transcript 1"
        assert lines[1].endswith("\tsealer\topen\t")
        assert lab.interrupt() == 0
    finally:
        lab.clean_up()

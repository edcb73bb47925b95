"""``labos validate``: findings with places, what is needed, how many copies, and the modules' word."""

from __future__ import annotations

import json
import os
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

from labos.cli.app import main
from labos.cli.validate import command
from labos.errors import NoAnswer, NotFound
from labos.settings import KernelInfo, announce

WRONG = """\
labos: 1
name: wrong
steps:
  - name: Seal
    module: sealr
    action: seal
  - name: Move
    module: pf400
    action: transfer
    args: {source: sciclops.exchange, target: nowhere.at_all}
"""


def ask(*args: str, code: int = 0) -> str:
    result = CliRunner().invoke(command, args)
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    assert result.exit_code == code, result.output
    return result.stdout


def test_a_sound_workflow_tells_what_it_needs_and_how_often_it_fits() -> None:
    told = ask("pcr", "--workcell", "rpl").splitlines()
    assert told == [
        "pcr on rpl: 14 steps, no errors.",
        "Labware needed at the start: none.",
        "Labware at the end: wc.output.",
        "6 copies can be active at once; one more would wait: sciclops.exchange is occupied by P6.",
    ]


def test_findings_name_file_line_column_and_remedy(tmp_path: Path) -> None:
    file = tmp_path / "wrong.yaml"
    file.write_text(WRONG)
    told = ask(str(file), "--workcell", "rpl", code=1)
    assert f"error: {file}:5:13: steps[0].module: Step 'Seal': there is no module 'sealr' in 'rpl'." in told
    assert "Did you mean 'sealer'?" in told
    assert f"{file}:10:47:" in told
    assert told.endswith("2 errors.\n")
    found = json.loads(ask(str(file), "--workcell", "rpl", "--json", code=1))
    assert found["sound"] is False
    assert [(f["line"], f["severity"]) for f in found["findings"]] == [(5, "error"), (10, "error")]


def test_broken_yaml_is_a_finding_too(tmp_path: Path) -> None:
    file = tmp_path / "broken.yaml"
    file.write_text("labos: 1\nsteps: [")
    assert f"error: {file}:" in ask(str(file), "--workcell", "rpl", code=1)


def test_payloads_are_laid_over_one_another(tmp_path: Path) -> None:
    values = tmp_path / "values.yaml"
    values.write_text("color_A_volumes: [1]\ncolor_B_volumes: [1]\n")
    told = ask(
        *("cp_mixcolor", "--workcell", "rpl", "--payload", str(values)),
        *("--payload", '{"color_C_volumes": [1]}', "--payload", 'destination_wells=["A1"]'),
    )
    assert "Labware needed at the start: wc.parking." in told
    assert "The payload has no 'color_A_volumes'" in ask("cp_mixcolor", "--workcell", "rpl", code=1)
    assert "must be a number" in ask("pcr", "--workcell", "rpl", "--payload", "seal.time=long", code=1)


def test_names_that_mean_nothing() -> None:
    with pytest.raises(NotFound, match="neither a file nor a packaged workflow 'pcrr'"):
        ask("pcrr", "--workcell", "rpl")
    with pytest.raises(NotFound, match="neither a file nor a packaged workcell 'rpll'"):
        ask("pcr", "--workcell", "rpll")
    assert main(["validate", "pcr"]) == 2


@contextmanager
def lab_that_says(home: Path, modules: Any) -> Iterator[None]:
    """A lab whose modules' nodes answer so."""

    class Answer(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            body = json.dumps({"modules": modules}).encode()
            self.send_response(200 if self.path.startswith("/api/v1/nodes?") else 404)
            self.send_header("Content-Length", str(len(body)))
            self.end_headers()
            self.wfile.write(body)

        def log_message(self, *args: object) -> None:
            pass

    with HTTPServer(("127.0.0.1", 0), Answer) as server:
        thread = threading.Thread(target=server.serve_forever, args=(0.02,))
        thread.start()
        url = f"http://127.0.0.1:{server.server_port}"
        announce(home, KernelInfo(os.getpid(), url, "", "lab", "sqlite:///none.db"))
        try:
            yield
        finally:
            server.shutdown()
            thread.join()


def modules(**status: str) -> list[dict[str, Any]]:
    names = ("sciclops", "pf400", "ot2_pcr_alpha", "sealer", "biometra", "peeler", "camera_module")
    return [{"module": f"rpl/{name}", "answer": status.get(name, "IDLE"), "why": ""} for name in names]


def test_online_asks_the_running_lab(tmp_path: Path) -> None:
    args = ("pcr", "--workcell", "rpl", "--online", "--home", str(tmp_path))
    with lab_that_says(tmp_path, modules(sealer="BUSY")):
        told = ask(*args)
        assert "sealer         BUSY" in told
        assert "Not ready" not in told
    with lab_that_says(tmp_path, modules(peeler="silent")[:-1]):
        told = ask(*args, code=1)
        assert "Not ready: peeler, camera_module." in told
        found = json.loads(ask(*args, "--json", code=1))
        assert found["modules"]["camera_module"] == "not in the running lab"
    with lab_that_says(tmp_path, "nonsense"), pytest.raises(NoAnswer, match="gives no answer"):
        ask(*args)
    with pytest.raises(NoAnswer, match="No lab runs in"):
        ask("pcr", "--workcell", "rpl", "--online", "--home", str(tmp_path / "none"))

"""Traces of runs at a real receiver of OpenTelemetry (Rotel, a program in Rust), and without one."""

from __future__ import annotations

import os
import re
import socket
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import httpx
import pytest

from labos.bootstrap import LabThread, descriptions
from labos.cli.app import main
from labos.client import LabClient
from labos.settings import Settings
from labos.spec import find_spec, load_workcell
from labos.telemetry.otlp import OtlpSender
from labos.telemetry.spans import make_trace_id
from tests.support.foreign import python_of
from tests.support.lab_process import until
from tests.unit.telemetry.test_series import read
from tests.unit.telemetry.test_spans import spans_of

IDS = re.compile(
    r"Trace ID +: (\w+)\n +Parent ID +: (\w*)\n +ID +: (\w+)\n +Name +: (.*)\n"
    r".*\nStart time: (\d+)\nEnd time: (\d+)"
)


class Receiver:
    """Rotel, which writes down what it receives."""

    def __init__(self, log: Path, port: int) -> None:
        self.log, self.url = log, f"http://127.0.0.1:{port}"

    def spans(self) -> list[tuple[int, int, int, str, int, int]]:
        """Trace, parent, id, name, start, end of each."""
        return [
            (int(trace, 16), int(parent or "0", 16), int(id_, 16), name, int(start), int(end))
            for trace, parent, id_, name, start, end in IDS.findall(self.log.read_text())
        ]


@pytest.fixture(scope="module")
def agent() -> Path:
    """The receiver's program."""
    return next(python_of("otlp").parents[1].glob("lib/python*/site-packages/rotel/rotel-agent"))


@pytest.fixture
def receiver(agent: Path, tmp_path: Path) -> Iterator[Receiver]:
    with socket.create_server(("127.0.0.1", 0)) as http, socket.create_server(("127.0.0.1", 0)) as grpc:
        port, other = http.getsockname()[1], grpc.getsockname()[1]
    log = tmp_path / "received.log"
    argv: list[Any] = [agent, "start", "--exporter", "blackhole", "--debug-log", "traces"]
    argv += ["--debug-log-verbosity", "detailed", "--otlp-http-endpoint", f"127.0.0.1:{port}"]
    argv += ["--otlp-grpc-endpoint", f"127.0.0.1:{other}"]
    environment = {**os.environ, "NO_COLOR": "1"}
    with log.open("wb") as file, subprocess.Popen(argv, stdout=file, stderr=file, env=environment) as process:
        try:
            until(lambda: is_open(port), "the receiver listens", 20.0)
            yield Receiver(log, port)
        finally:
            process.kill()


def is_open(port: int) -> bool:
    with socket.socket() as probe:
        return probe.connect_ex(("127.0.0.1", port)) == 0


def test_a_receiver_gets_each_span_as_it_was(receiver: Receiver) -> None:
    sent = spans_of("simulated-2")
    sender = OtlpSender(receiver.url, {"service.name": "labos", "service.namespace": "lab 7"})
    for span in sent:
        sender.send(span)
    sender.close()
    assert (sender.offered, sender.taken) == (len(sent), len(sent))
    until(lambda: len(receiver.spans()) == len(sent), "all spans arrive", 10.0)
    wanted = sorted((s.trace, s.parent, s.id, s.name, s.start, s.end) for s in sent)
    assert sorted(receiver.spans()) == wanted
    told = receiver.log.read_text()
    assert "service.namespace: Str(lab 7)" in told
    assert "labos.attempt: Int(1)" in told
    assert any(span.error and f"Status message : {span.error}" in told for span in sent)


def test_a_lab_sends_traces_of_its_runs_and_counts_them(receiver: Receiver, tmp_path: Path) -> None:
    with run_receiver(tmp_path, receiver.url) as lab, LabClient(lab.url) as client:
        run = client.submit("pcr", user="ada")
        client.cancel(run, "ada")
        trace = make_trace_id(client.health()["lab"], run)
        until(lambda: any(s[:1] + s[3:4] == (trace, "run pcr") for s in receiver.spans()), "its span", 15.0)
        told = read(httpx.get(f"{lab.url}/metrics").text)
        assert told[("labos_trace_spans_total", ())] >= told[("labos_trace_spans_sent_total", ())] >= 1
    assert "labos.user: Str(ada)" in receiver.log.read_text()


@pytest.mark.parametrize("kind", ["refuses", "hangs"])
def test_a_receiver_that_is_away_costs_spans_and_nothing_else(kind: str, tmp_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as silent:
        port = silent.getsockname()[1]
        if kind == "refuses":
            silent.close()
        with run_receiver(tmp_path, f"http://127.0.0.1:{port}") as lab, LabClient(lab.url) as client:
            run = client.submit("pcr", user="ada")
            client.cancel(run, "ada")
            assert client.status(run).status == "cancelled"
            told = read(httpx.get(f"{lab.url}/metrics").text)
            assert told[("labos_trace_spans_total", ())] >= 1
            assert told[("labos_trace_spans_sent_total", ())] == 0


def test_an_address_that_is_none_is_refused_and_leaves_nothing_behind(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    home = tmp_path / "new" / "lab"
    for address in ("127.0.0.1:4318", "grpc://127.0.0.1:4317", "http://", "nonsense"):
        words = ["up", "rpl", "--simulate", "--no-nodes", "--home", str(home), "--otlp", address]
        assert main(words) == 1
        told = capsys.readouterr().err
        assert repr(address) in told
        assert "http://HOST:4318" in told
    assert not home.parent.exists()


@contextmanager
def run_receiver(folder: Path, otlp: str) -> Iterator[LabThread]:
    cell = load_workcell(find_spec("workcells", "rpl"), descriptions())
    settings = Settings.make(folder / "lab", speed=5000.0, simulate=True, otlp=otlp)
    with LabThread(settings, [cell], nodes="none") as lab:
        yield lab

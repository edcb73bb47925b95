"""Large files that people send take time, and the lab goes on meanwhile."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from typing import Any

import httpx
import pytest

from labos.bootstrap import LabThread, descriptions
from labos.client import LabClient
from labos.client._lab import API
from labos.settings import Settings
from labos.spec import find_spec, load_workcell
from labos.spec.findings import FindingList
from labos.spec.sheet import MOST_FAULTS, MOST_ROWS, read_sheet

ODD_SHEETS: dict[str, Callable[[int], str]] = {
    "one line of commas": lambda n: "well,sample\n" + "," * n,
    "one line of spaces": lambda n: "well,sample\nA1," + " " * n + "x",
    "one line of quotes": lambda n: 'well,sample\nA1,"' + '""' * (n // 2) + '"',
    "an open quote": lambda n: 'well,sample\n"' + "x" * n,
    "a long name": lambda n: "well,sample\nA1," + "x" * n,
    "many rows": lambda n: "well,sample\n" + "A1,x\n" * (n // 5),
    "many faulty rows": lambda n: "well,sample\n" + "??,x\n" * (n // 5),
    "many columns": lambda n: "well,sample," * (n // 12),
}


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Iterator[LabThread]:
    cell = load_workcell(find_spec("workcells", "rpl"), descriptions())
    settings = Settings.make(tmp_path_factory.mktemp("lab"), speed=5000.0, simulate=True)
    with LabThread(settings, [cell], nodes="none") as running:
        yield running


def work_of(text: str) -> float:
    """Processor time that reading takes, in seconds."""
    began = time.thread_time()
    read_sheet(text, FindingList("sheet"))
    return time.thread_time() - began


@pytest.mark.slow
@pytest.mark.parametrize("kind", ODD_SHEETS)
def test_a_sheet_is_read_in_linear_time(kind: str) -> None:
    make = ODD_SHEETS[kind]
    small, large = (min(work_of(make(size)) for _ in range(3)) for size in (200_000, 1_600_000))
    assert large < 0.02 + 20 * small, (kind, small, large)
    assert large < 3.0


def test_a_sheet_has_an_end() -> None:
    report = FindingList("sheet")
    assert read_sheet("well,sample\n" + "A1,x\n" * (MOST_ROWS + 1), report) == []
    assert "Divide it." in str(report.sort_findings())
    report = FindingList("sheet")
    read_sheet("well,sample\n" + "??,x\n" * 30_000, report)
    assert report.errors <= MOST_FAULTS + 1


@pytest.mark.slow
def test_eight_large_files_do_not_hold_the_lab_up(lab: LabThread) -> None:
    rows = "".join(
        f"{'ABCDEFGH'[n % 8]}{n % 12 + 1},sample number {n} of a long series,{n % 90}\n"
        for n in range(24_000)
    )
    sheet: dict[str, Any] = {"text": f"well,sample,volume\n{rows}", "by": "ada", "labware": "P1"}
    deep = "\n".join(f"  key{n}: {{a: [1, 2], b: text}}" for n in range(4_000))
    files = [
        ("/samples", sheet),
        ("/workcells", {"text": f"labos: 1\nname: x\nconfig:\n{deep}\nmodules: []\n", "by": "ada"}),
    ]
    with LabClient(lab.url) as client:
        sheet["labware"] = client.place("hidex.default", "plate96", "ada")
    answers: list[int] = []

    def send(path: str, body: dict[str, Any]) -> None:
        with httpx.Client(base_url=lab.url + API, timeout=120) as raw:
            answers.append(raw.post(path, json=body).status_code)

    senders = [threading.Thread(target=send, args=files[n % 2]) for n in range(8)]
    waits: list[float] = []
    with LabClient(lab.url) as client:
        for sender in senders:
            sender.start()
        while any(sender.is_alive() for sender in senders):
            began = time.monotonic()
            experiment = client.start_experiment("e", "ada")
            client.end_experiment(experiment)
            waits.append(time.monotonic() - began)
    assert len(answers) == 8
    assert all(400 <= status < 500 for status in answers), answers
    assert len(waits) > 3
    assert sorted(waits)[len(waits) // 2] < 1.0, waits
    assert max(waits) < 5.0, max(waits)

"""What the commands answer, on a lab in this process without nodes."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import msgspec
import pytest

from labos.bootstrap import LabThread, descriptions
from labos.cli.app import main
from labos.client import LabClient
from labos.settings import Settings
from labos.spec import find_spec, load_workcell


class Said(msgspec.Struct):
    """What a command answered."""

    code: int
    out: str
    err: str


Labos = Callable[..., Said]


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Iterator[LabThread]:
    cell = load_workcell(find_spec("workcells", "rpl"), descriptions())
    settings = Settings.of(tmp_path_factory.mktemp("lab"), speed=5000.0, simulate=True)
    with LabThread(settings, [cell], nodes="none") as running:
        yield running


@pytest.fixture
def home(lab: LabThread, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("LABOS_HOME", str(lab.settings.home))
    monkeypatch.setenv("LABOS_USER", "ada")
    monkeypatch.delenv("LABOS_DATABASE_URL", raising=False)
    return lab.settings.home


@pytest.fixture
def labos(home: Path, capsys: pytest.CaptureFixture[str]) -> Labos:
    """Runs ``labos`` with these words in the lab's home."""

    def labos_(*words: str) -> Said:
        capsys.readouterr()
        code = main(list(words))
        return Said(code, *capsys.readouterr())

    return labos_


@pytest.fixture
def client(lab: LabThread) -> Iterator[LabClient]:
    with LabClient(lab.url) as found:
        yield found


def test_the_reason_of_a_cancellation_is_shown_with_the_run(labos: Labos, client: LabClient) -> None:
    run = client.submit("pcr", user="ada")
    assert labos("cancel", run, "--why", "wrong plate", "--wait").out == f"{run} is cancelled.\n"
    assert "Why: wrong plate" in labos("runs", run).out
    assert "It was cancelled: wrong plate" in labos("explain", run).out
    assert client.status(run).why == "wrong plate"

"""What an application publishes is found over HTTP, by a process that keeps the search index by itself."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator
from pathlib import Path

import pytest

from labos.bootstrap import LabThread, descriptions
from labos.client import Experiment, LabClient
from labos.errors import BadInput
from labos.settings import Settings, free_port
from labos.spec import load_workcell
from tests.support.api_process import ApiProcess
from tests.support.lab_process import until

CELL = "labos: 1\nname: corner\nmodules:\n  - {name: sealer, model: A4S_sealer}\n"


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Iterator[LabThread]:
    folder = tmp_path_factory.mktemp("lab")
    (folder / "cell.yaml").write_text(CELL)
    cell = load_workcell(folder / "cell.yaml", descriptions())
    with LabThread(Settings.make(folder / "home", speed=1.0, simulate=True), [cell]) as running:
        yield running


def publish(client: LabClient, title: str, folder: Path) -> str:
    """One experiment that publishes one file; returns its id."""
    (folder / "spectrum.csv").write_text("nm,au\n500,0.7\n")
    with Experiment(client, "spectra", "ada") as experiment:
        files = [folder / "spectrum.csv"]
        experiment.publish(title, about="One dye.", keywords=["dye", "UV"], files=files)
    return experiment.id


@pytest.mark.slow
def test_what_is_published_is_found_with_its_files(lab: LabThread, tmp_path: Path) -> None:
    with LabClient(lab.url) as client:
        experiment = publish(client, "Absorbance of a dye", tmp_path)
        (noted,) = client.events(type="experiment.noted", stream=experiment)
        found = client.find("dye absor*", kind=["publication"], facets=True)
        (entry,) = found["entries"]
        assert found["behind"] == 0
        assert entry["name"] == f"{experiment}@{noted['position']}"
        assert (entry["title"], entry["creators"]) == ("Absorbance of a dye", ["ada"])
        assert found["facets"]["keyword"] == [{"value": "UV", "count": 1}, {"value": "dye", "count": 1}]
        (file,) = entry["files"]
        assert file["file"] == "spectrum.csv"
        assert client.file(file) == b"nm,au\n500,0.7\n"
        with pytest.raises(BadInput, match="no word"):
            client.find("!!")
        with (
            pytest.raises(BadInput, match=r"gone\.csv cannot be read"),
            Experiment(client, "x", "ada") as bad,
        ):
            bad.publish("x", files=[tmp_path / "gone.csv"])


@pytest.mark.slow
def test_a_search_process_that_is_killed_is_started_again(lab: LabThread, tmp_path: Path) -> None:
    with LabClient(lab.url) as client:
        publish(client, "Before the kill", tmp_path)
        assert client.find("before kill")["total"] == 1
        finder = lab.runtime.service.finder
        assert finder is not None
        assert finder._process is not None
        os.kill(finder._process.pid, signal.SIGKILL)
        publish(client, "After it", tmp_path)
        until(lambda: _is_found(client, "after"), "what was published after the kill")


def _is_found(client: LabClient, words: str) -> bool:
    from labos.errors import Refused

    try:
        return bool(client.find(words)["total"] == 1)
    except Refused:
        return False


@pytest.mark.slow
def test_an_api_process_finds_too(lab: LabThread, tmp_path: Path) -> None:
    api = ApiProcess(tmp_path, "api-find", free_port(), "--home", str(lab.settings.home))
    with LabClient(lab.url) as client:
        publish(client, "Through the side door", tmp_path)
        try:
            api.start()
            with LabClient(api.url) as beside:
                found = beside.find("side door")
            assert [entry["title"] for entry in found["entries"]] == ["Through the side door"]
        finally:
            api.kill()

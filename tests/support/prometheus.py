"""A real Prometheus for tests, and its tool ``promtool``."""

from __future__ import annotations

import os
import shutil
import socket
import subprocess
import time
from pathlib import Path
from typing import Any

import httpx
import pytest

REQUIRED = "LABOS_REQUIRE_PROMETHEUS"


def need(program: str) -> str:
    """Where ``prometheus`` or ``promtool`` is; skips the test where it is missing, unless it is required."""
    found = shutil.which(program)
    if found is None:
        assert not os.environ.get(REQUIRED), f"{program} is missing, and {REQUIRED} is set"
        pytest.skip(f"{program} is missing (Debian package prometheus)")
    return found


def promtool(*words: str, given: str = "") -> str:
    """What ``promtool`` says; empty if it is content. Fails the test if it is not."""
    command = [need("promtool"), *words]
    done = subprocess.run(command, input=given, capture_output=True, text=True, timeout=30, check=False)
    said = f"{done.stdout}{done.stderr}"
    assert done.returncode == 0, said
    return said


class Prometheus:
    """A server that scrapes what its configuration says, until ``stop``."""

    def __init__(self, folder: Path, config: str) -> None:
        program = need("prometheus")
        with socket.socket() as probe:
            probe.bind(("127.0.0.1", 0))
            self.url = f"http://127.0.0.1:{probe.getsockname()[1]}"
        (folder / "prometheus.yml").write_text(config)
        self._log = (folder / "prometheus.log").open("wb")
        self._process = subprocess.Popen(
            [
                program,
                f"--config.file={folder / 'prometheus.yml'}",
                f"--storage.tsdb.path={folder / 'data'}",
                f"--web.listen-address={self.url.removeprefix('http://')}",
            ],
            stdout=self._log,
            stderr=self._log,
        )
        self._client = httpx.Client(base_url=self.url, timeout=10.0)

    def __enter__(self) -> Prometheus:
        give_up = time.monotonic() + 20.0
        while time.monotonic() < give_up:
            try:
                if self._client.get("/-/ready").status_code == 200:
                    return self
            except httpx.HTTPError:
                pass
            time.sleep(0.05)
        self.stop()
        raise AssertionError("Prometheus does not get ready")

    def __exit__(self, *error: object) -> None:
        self.stop()

    def stop(self) -> None:
        self._client.close()
        self._process.kill()
        self._process.wait()
        self._log.close()

    def ask(self, query: str) -> list[dict[str, Any]]:
        """What a query gives now. Fails the test for one that is refused."""
        return self._data("/api/v1/query", query=query)

    def ask_over(self, query: str, seconds: float, step: float) -> list[dict[str, Any]]:
        """What a query gives over the last ``seconds``."""
        now = time.time()
        return self._data("/api/v1/query_range", query=query, start=now - seconds, end=now, step=step)

    def labels(self, name: str, match: str) -> list[str]:
        """The values of a label in the series that match."""
        answer = self._client.get(f"/api/v1/label/{name}/values", params={"match[]": match})
        return list(answer.json()["data"])

    def _data(self, path: str, **params: Any) -> list[dict[str, Any]]:
        answer = self._client.get(path, params=params).json()
        assert answer["status"] == "success", (params["query"], answer.get("error"))
        return list(answer["data"]["result"])

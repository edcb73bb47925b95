"""The services of a compose file as processes of this computer: commands, environment, health checks.

Containers are not needed for it. What differs from one: addresses and ports, since all services share one
network here, and the places of the lab's folder and of secrets.
"""

from __future__ import annotations

import os
import random
import subprocess
import sys
from pathlib import Path
from typing import Any

import yaml

from labos.settings import is_free
from tests.docs.markdown import ROOT
from tests.support.lab_process import PATIENCE_S, until

FOLDER = ROOT / "deploy" / "compose"

Service = dict[str, Any]


def services_of(*files: str) -> dict[str, Service]:
    """The services of compose files, those of a later file laid over those of the ones before."""
    found: dict[str, Service] = {}
    for file in files:
        text = (FOLDER / file).read_text().replace("!override", "")
        for name, service in yaml.safe_load(text)["services"].items():
            found[name] = {**found.get(name, {}), **service}
    return found


def modules_of(services: dict[str, Service]) -> dict[str, str]:
    """The services that are nodes, and the modules they are for."""
    return {
        name: service["environment"]["LABOS_MODULE"]
        for name, service in services.items()
        if name.startswith("node-")
    }


BUS_NAME = "lab.example.org"
"""What whoever starts the composition says beside it."""


def environment_of(service: Service) -> dict[str, str]:
    own = service.get("environment", {})
    return {name: BUS_NAME if value.startswith("${BUS_NAME") else value for name, value in own.items()}


def environment_file() -> dict[str, str]:
    lines = (FOLDER / "lab.env.example").read_text().splitlines()
    return dict(line.split("=", 1) for line in lines if line and not line.startswith("#"))


def _choose_port() -> int:
    """A free port that the system gives to nobody else: it takes ports from 32768 on for connections."""
    for _ in range(1000):
        port = random.randrange(20000, 32000)
        if is_free(port):
            return port
    raise AssertionError("no port is free between 20000 and 32000")


class Composition:
    """Services that are started one by one. ``told`` takes the place of lines of lab.env."""

    def __init__(self, folder: Path, database: str, told: dict[str, str], *files: str) -> None:
        self.home = folder / "lab"
        self._folder, self._told = folder, {**environment_file(), **told}
        self._services = services_of(*(files or ("compose.yaml",)))
        self._processes: dict[str, subprocess.Popen[bytes]] = {}
        self._metrics: dict[str, int] = {}
        (folder / "secrets").mkdir()
        (folder / "secrets" / "postgres").write_text("not asked for here")
        (folder / "secrets" / "admin").write_text("correct horse battery")
        self._bus, self._http = _choose_port(), _choose_port()
        self.url = f"http://127.0.0.1:{self._http}"
        self._places = {
            "@postgres/labos": f"@{database.rpartition('@')[2]}",
            "/run/secrets": str(folder / "secrets"),
            "/bus:7447": f"/127.0.0.1:{self._bus}",
            "/0.0.0.0:7447": f"/127.0.0.1:{self._bus}",
            "('127.0.0.1', 7447)": f"('127.0.0.1', {self._bus})",
            "--host 0.0.0.0": "--host 127.0.0.1",
            "--metrics-host 0.0.0.0": "--metrics-host 127.0.0.1",
            "8720": str(self._http),
            "$$": "$",
        }

    def start(self, *names: str) -> None:
        for name in names:
            self._metrics[name] = _choose_port()  # one of before may be somebody else's by now
            log = (self._folder / f"{name}.log").open("ab")
            with log:
                self._processes[name] = subprocess.Popen(
                    self._localise(name, self._services[name]["entrypoint"]),
                    stdin=subprocess.DEVNULL,
                    stdout=log,
                    stderr=log,
                    env=self._environment(name),
                )

    def is_healthy(self, name: str) -> bool:
        """What the service's own health check says. Fails if the service has ended."""
        assert self._processes[name].poll() is None, self.read_log(name)
        kind, *command = self._localise(name, self._services[name]["healthcheck"]["test"])
        assert kind == "CMD"
        done = subprocess.run(command, env=self._environment(name), capture_output=True, check=False)
        return done.returncode == 0

    def await_healthy(self, name: str) -> None:
        """Raises AssertionError with what all services have written."""
        try:
            until(lambda: self.is_healthy(name), f"{name} is healthy")
        except AssertionError as error:
            said = [self.read_log(each) for each in self._processes]
            raise AssertionError("\n".join([str(error), *said])) from None

    def pids(self) -> dict[str, int]:
        return {name: process.pid for name, process in self._processes.items() if process.poll() is None}

    def kill(self, name: str) -> None:
        """kill -9 of one service."""
        self._processes[name].kill()
        self._processes[name].wait(PATIENCE_S)

    def wait(self, name: str) -> int:
        """The exit code of a service that ends by itself."""
        return self._processes[name].wait(PATIENCE_S)

    def read_log(self, name: str) -> str:
        return f"{name}: {(self._folder / f'{name}.log').read_text()[-2000:]}"

    def clean_up(self) -> None:
        for process in self._processes.values():
            if process.poll() is None:
                process.kill()
                process.wait()

    def _localise(self, name: str, words: list[str]) -> list[str]:
        port = str(self._metrics[name])
        made = []
        for word in words:
            for there, here in {**self._places, "9101": port}.items():
                word = word.replace(there, here)
            made.append(word)
        return made

    def _environment(self, name: str) -> dict[str, str]:
        """As in the container: the image's, that of lab.env if the service reads it, its own."""
        service = self._services[name]
        bare = {key: value for key, value in os.environ.items() if not key.startswith("LABOS_")}
        path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
        told = self._told if service.get("env_file") else {}
        return {**bare, "PATH": path, "LABOS_HOME": str(self.home), **told, **environment_of(service)}

"""A lab at rest with a key, its checkpoints elsewhere, and commands that ask it."""

from __future__ import annotations

import shutil
import subprocess
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import msgspec
import pytest
from click.testing import CliRunner

from labos.core.canonical import digest
from labos.core.envelope import GENESIS, Record, seal
from labos.errors import LabosError
from labos.services.trust.keys import SigningKeys
from labos.services.trust.publish import PublishResult, Targets, publish
from labos.store import open_store
from tests.unit.cli_queries.conftest import command_of
from tests.unit.services.logbook import save, two_users

NAME = "chem.example.org/lab1"


class Lab:
    """The folder of a lab whose log a test may put another one in the place of."""

    def __init__(self, home: Path) -> None:
        self.home = home
        self.safe = home.parent / "safe"
        self.public = home.parent / "lab.pub"

    def write(self, records: Sequence[Record]) -> None:
        """Put a log in the place of the one that is there."""
        for path in self.home.glob("labos.*"):
            if path.suffix != ".tree":
                path.unlink()
        save(records, self.home)

    def publish(self, *witnesses: str, stamp: str = "") -> PublishResult:
        store = open_store(f"sqlite:///{self.home / 'labos.db'}", create=False, read_only=True)
        try:
            return publish(store, self.home, Targets((str(self.safe),), witnesses, stamp=stamp))
        finally:
            store.close()

    def ask(self, name: str, *args: str, code: int = 0) -> str:
        """Run a command; an expected error becomes exit code 1 and its words."""
        result = CliRunner().invoke(command_of(name), [*args, "--home", str(self.home)])
        if isinstance(result.exception, LabosError):
            assert code == 1, result.exception
            return str(result.exception)
        if result.exception is not None and not isinstance(result.exception, SystemExit):
            raise result.exception
        assert result.exit_code == code, result.output
        return result.output

    def bundle(self, run: str = "R1") -> Path:
        path = self.home.parent / f"{run}.zip"
        self.ask("bundle", run, "-o", str(path))
        return path


@pytest.fixture(scope="session")
def kept(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A lab with a checkpoint at half of its log, and one at its end."""
    records = two_users().records
    made = Lab(tmp_path_factory.mktemp("kept") / "lab")
    made.write(records[: len(records) // 2])
    made.public.write_text(SigningKeys(made.home).create(NAME).text)
    made.publish()
    made.write(records)
    made.publish()
    return made.home.parent


@pytest.fixture
def lab(kept: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Lab:
    """A copy of it, for one test."""
    monkeypatch.delenv("LABOS_DATABASE_URL", raising=False)
    shutil.copytree(kept, tmp_path, dirs_exist_ok=True)
    return Lab(tmp_path / "lab")


def chain_anew(records: Sequence[Record]) -> list[Record]:
    """What somebody makes of changed records who knows how the chain is made: no position is missing, and
    each hash follows from the one before."""
    made: list[Record] = []
    versions: dict[str, int] = {}
    previous = GENESIS
    for position, record in enumerate(records, 1):
        versions[record.head.stream] = versions.get(record.head.stream, 0) + 1
        head = msgspec.structs.replace(
            record.head,
            position=position,
            version=versions[record.head.stream],
            digest=digest(record.payload),
        )
        made.append(seal(previous, head, record.payload))
        previous = made[-1].hash
    return made


Answer = Callable[[str, str, bytes], tuple[int, str, bytes]]


@contextmanager
def serve_http(answer: Answer) -> Iterator[str]:
    """A real HTTP server; ``answer(method, path, body)`` gives status, type and body."""

    class Handler(BaseHTTPRequestHandler):
        def reply(self) -> None:
            body = self.rfile.read(int(self.headers.get("content-length", 0)))
            status, kind, data = answer(self.command, self.path, body)
            self.send_response(status)
            self.send_header("content-type", kind)
            self.send_header("content-length", str(len(data)))
            self.end_headers()
            self.wfile.write(data)

        do_PUT = do_POST = reply  # noqa: N815

        def log_message(self, *_: Any) -> None:
            pass

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    thread = threading.Thread(target=server.serve_forever, args=(0.02,))
    thread.start()
    try:
        yield f"http://127.0.0.1:{server.server_port}"
    finally:
        server.shutdown()
        thread.join()
        server.server_close()


def run_openssl(folder: Path, *args: str) -> None:
    subprocess.run(["openssl", *args], cwd=folder, check=True, capture_output=True)

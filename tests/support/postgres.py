"""A real PostgreSQL server for tests: its own data folder, its own port, fsync on."""

from __future__ import annotations

import contextlib
import os
import shutil
import signal
import socket
import subprocess
import tempfile
import time
from pathlib import Path

_USER = "labos"


def find_binaries() -> Path | None:
    """The folder with ``initdb`` and ``pg_ctl``; None if this machine has no server."""
    candidates = sorted(Path("/usr/lib/postgresql").glob("*/bin"), reverse=True)
    pg_config = shutil.which("pg_config")
    if pg_config:
        asked = subprocess.run([pg_config, "--bindir"], capture_output=True, text=True, check=False)
        candidates.append(Path(asked.stdout.strip()))
    on_path = shutil.which("initdb")
    if on_path:
        candidates.append(Path(on_path).resolve().parent)
    for folder in candidates:
        if (folder / "initdb").exists() and (folder / "pg_ctl").exists():
            return folder
    return None


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


class PostgresServer:
    """One server, from ``start`` to ``stop``; every test may ask for a database of its own.

    PostgreSQL refuses to run as root, so root runs it as the user ``postgres``.
    """

    def __init__(self, binaries: Path | None = None) -> None:
        found = binaries or find_binaries()
        if found is None:
            raise FileNotFoundError("no PostgreSQL server (initdb, pg_ctl) on this machine")
        self.binaries = found
        self.port = free_port()
        self.folder: Path | None = None
        self._frozen: list[int] = []

    @property
    def url(self) -> str:
        """The maintenance database."""
        return self._url("postgres")

    def start(self) -> None:
        """Create the cluster at the first call; start the server and wait until it answers."""
        if self.folder is None:
            # Directly in /tmp: the parents must be traversable for the user postgres.
            self.folder = Path(tempfile.mkdtemp(prefix="labos-pg-", dir="/tmp"))
            if os.geteuid() == 0:
                shutil.chown(self.folder, "postgres", "postgres")
            self._run("initdb", "-D", self._data, "-A", "trust", "-U", _USER, "-E", "UTF8", "--no-sync")
        options = f"-p {self.port} -k {self.folder} -h 127.0.0.1"
        log = str(self.folder / "log")
        self._run("pg_ctl", "-w", "-t", "60", "-D", self._data, "-l", log, "-o", options, "start")

    def replica(self) -> PostgresServer:
        """Another server, started, that follows this one and can only be read (a hot standby)."""
        made = PostgresServer(self.binaries)
        made.folder = Path(tempfile.mkdtemp(prefix="labos-pg-", dir="/tmp"))
        if os.geteuid() == 0:
            shutil.chown(made.folder, "postgres", "postgres")
        here = ("-h", "127.0.0.1", "-p", str(self.port), "-U", _USER)
        self._run("pg_basebackup", "-D", made._data, *here, "-R", "-X", "stream", "-c", "fast", "--no-sync")
        made.start()
        return made

    def url_of(self, database: str) -> str:
        """A database of that name, which is there."""
        return self._url(database)

    def stop(self, *, immediate: bool = False) -> None:
        """Stop the server; ``immediate`` does so without a checkpoint, as a crash would."""
        mode = "immediate" if immediate else "fast"
        self._run("pg_ctl", "-w", "-t", "60", "-D", self._data, "-m", mode, "stop")

    def restart(self, *, immediate: bool = False) -> None:
        self.stop(immediate=immediate)
        self.start()

    def kill(self) -> None:
        """Kill the server's first process at once; its children follow."""
        pid = self._pid()
        if pid is None:
            return
        os.kill(pid, signal.SIGKILL)
        deadline = time.monotonic() + 10
        while _lives(pid) and time.monotonic() < deadline:
            time.sleep(0.02)

    def freeze(self) -> None:
        """Stop all of its processes where they stand; its system goes on acknowledging what comes."""
        first = self._pid()
        assert first is not None
        os.kill(first, signal.SIGSTOP)  # so that there will be no more of them
        self._frozen = [first]
        for pid in _children(first):
            os.kill(pid, signal.SIGSTOP)
            self._frozen.append(pid)

    def thaw(self) -> None:
        frozen, self._frozen = self._frozen, []
        for pid in frozen:
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, signal.SIGCONT)

    def remove(self) -> None:
        """Stop whatever still runs and delete the data folder."""
        self.thaw()
        if self.folder is None:
            return
        if self._pid() is not None:
            try:
                self.stop(immediate=True)
            except RuntimeError:
                self.kill()
        shutil.rmtree(self.folder, ignore_errors=True)
        self.folder = None

    def create_database(self, name: str) -> str:
        """Create an empty database and return its URL."""
        import psycopg
        from psycopg import sql

        with psycopg.connect(self.url, autocommit=True) as connection:
            connection.execute(sql.SQL("CREATE DATABASE {}").format(sql.Identifier(name)))
        return self._url(name)

    def _url(self, database: str) -> str:
        return f"postgresql://{_USER}@127.0.0.1:{self.port}/{database}"

    @property
    def _data(self) -> str:
        return str(self.folder / "data") if self.folder else ""

    def _pid(self) -> int | None:
        try:
            pid = int(Path(self._data, "postmaster.pid").read_text().splitlines()[0])
        except (OSError, IndexError, ValueError):
            return None
        return pid if _lives(pid) else None

    def _run(self, program: str, *arguments: str) -> None:
        command = [str(self.binaries / program), *arguments]
        if os.geteuid() == 0:
            command = ["setpriv", "--reuid=postgres", "--regid=postgres", "--clear-groups", *command]
        # To a file, not a pipe: the server inherits it and would keep a pipe open for ever.
        with tempfile.TemporaryFile() as output:
            done = subprocess.run(
                command, stdin=subprocess.DEVNULL, stdout=output, stderr=output, cwd="/", check=False
            )
            if done.returncode:
                output.seek(0)
                raise RuntimeError(f"{program} failed: {output.read().decode(errors='replace').strip()}")


def _children(parent: int) -> list[int]:
    found = []
    for stat in Path("/proc").glob("[0-9]*/stat"):
        with contextlib.suppress(OSError):
            if int(stat.read_text().rpartition(") ")[2].split()[1]) == parent:
                found.append(int(stat.parent.name))
    return found


def _lives(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except PermissionError:
        return True
    return True

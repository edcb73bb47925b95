"""A sealer with an HTTP interface of its own: what a vendor might sell. It keeps its own truth.

``python -m tests.integration.adapter.sealer PORT`` is one that can be killed: it seals for as long as it is
told, and every seal is a line in the file named by TRUTH, synced before it begins. With MEMORY, a file, it
knows after a restart which jobs it had.
"""

from __future__ import annotations

import json
import os
import sys
import threading
import time
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any
from urllib.parse import parse_qs, urlsplit


class Sealer:
    """``POST /action`` with ``{"action_handle", "action_vars"}`` blocks until it is done, as the paper
    has it; ``POST /jobs`` answers at once, and ``GET /jobs/ID`` tells how the job is, in the words of
    ``jobs_say``. It seals until ``go`` is set, then ``ends_with`` another HTTP status, if that is set. It
    says which job it was when it may ``name`` it; a ``nameless`` one never does, one that is ``closed``
    takes none."""

    def __init__(self, port: int = 0) -> None:
        self.seals: list[dict[str, Any]] = []
        self.jobs: dict[str, dict[str, Any]] = {}
        self.broken = ""
        self.nameless = self.closed = False
        self.jobs_say: dict[str, str] = {}  # its own words for states of jobs
        self.ends_with = 0  # an HTTP status, in place of 200
        self.working = 0
        self.asked: list[str] = []
        self.go, self.name = threading.Event(), threading.Event()
        self.go.set()
        self.name.set()
        self._server = ThreadingHTTPServer(("127.0.0.1", port), self._handler())
        self.port = self._server.server_address[1]
        threading.Thread(target=self._server.serve_forever, args=(0.02,), daemon=True).start()

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self.port}"

    def close(self) -> None:
        self.go.set()
        self.name.set()
        self._server.shutdown()
        self._server.server_close()

    def act(self, handle: str, told: dict[str, Any]) -> tuple[int, Any]:
        if handle != "seal":
            return 404, {"detail": f"no action {handle}"}
        if self.broken:
            return 200, {"status": "failed", "error": self.broken}
        self.working += 1
        self.note_begin(told)
        self.seal(told)
        self.working -= 1
        if self.ends_with:
            return self.ends_with, {"detail": "the foil is torn"}
        return 200, {"status": "succeeded", "data": {"foil": 1000 - len(self.seals)}}

    def note_begin(self, told: dict[str, Any]) -> None:
        """A seal begins."""
        self.seals.append(told)

    def seal(self, told: dict[str, Any]) -> None:
        """It takes its time."""
        time.sleep(0.2)
        self.go.wait()

    def keep(self) -> None:
        """Write down which jobs there are, where somebody does that."""

    def answer(self, method: str, path: str, query: dict[str, list[str]], body: Any) -> tuple[int, Any]:
        self.asked.append(f"{method} {path}")
        match method, path.strip("/").split("/"):
            case "POST", ["action"]:
                told = body or {
                    "action_handle": query["action_handle"][0],
                    "action_vars": json.loads(query["action_vars"][0]),
                }
                return self.act(told["action_handle"], told["action_vars"])
            case "POST", ["jobs"]:
                if self.closed:
                    return 200, {"state": "closed", "error": "out of service"}
                name = body.get("id") or f"j{len(self.jobs) + 1}"
                job = self.jobs[name] = {"state": "running"}
                self.keep()

                def work() -> None:
                    _, ended = self.act("seal", body["settings"])
                    job.update(state=ended["status"], error=ended.get("error"), data=ended.get("data"))
                    self.keep()

                threading.Thread(target=work, daemon=True).start()
                self.name.wait()
                return 202, {"job": {} if self.nameless else {"id": name}}
            case "GET", ["jobs", name]:
                if name not in self.jobs:
                    return 404, {"detail": "no such job"}
                job = self.jobs[name]
                return 200, {**job, "state": self.jobs_say.get(job["state"], job["state"])}
            case "GET", ["state"]:
                state = "ERROR" if self.broken else "BUSY" if self.working else "IDLE"
                return 200, {"State": state, "why": self.broken}
            case "POST", ["reset"]:
                self.broken = ""
                return 200, {}
            case "GET", ["levels"]:
                return 200, {"levels": {"foil": 1000 - len(self.seals)}}
        return 404, {"detail": "not found"}

    def _handler(self) -> type[BaseHTTPRequestHandler]:
        sealer = self

        class Handler(BaseHTTPRequestHandler):
            def do_GET(self) -> None:
                self._reply("GET", None)

            def do_POST(self) -> None:
                size = int(self.headers.get("Content-Length") or 0)
                self._reply("POST", json.loads(self.rfile.read(size)) if size else None)

            def _reply(self, method: str, body: Any) -> None:
                parts = urlsplit(self.path)
                status, told = sealer.answer(method, parts.path, parse_qs(parts.query), body)
                data = json.dumps(told).encode()
                try:
                    self.send_response(status)
                    self.send_header("Content-Type", "application/json")
                    self.send_header("Content-Length", str(len(data)))
                    self.end_headers()
                    self.wfile.write(data)
                except ConnectionError:
                    pass  # the proxy has cut the line

            def log_message(self, *args: Any) -> None:
                pass

        return Handler


class LastingSealer(Sealer):
    """What it did is on disk, and what it knows of its jobs is if ``memory`` says where."""

    def __init__(self, port: int, truth: Path, memory: Path | None) -> None:
        self.truth, self.memory = truth, memory
        super().__init__(port)
        if memory is not None and memory.exists():
            self.jobs.update(json.loads(memory.read_text()))
            for job in self.jobs.values():
                if job["state"] == "running":
                    job.update(state="failed", error="The power was lost.")

    def note_begin(self, told: dict[str, Any]) -> None:
        with self.truth.open("a") as file:
            file.write(json.dumps({"what": "seal", **told}) + "\n")
            file.flush()
            os.fsync(file.fileno())
        super().note_begin(told)

    def seal(self, told: dict[str, Any]) -> None:
        time.sleep(told["time"])

    def keep(self) -> None:
        if self.memory is not None:
            written = self.memory.with_suffix(".new")
            written.write_text(json.dumps(self.jobs))
            written.replace(self.memory)


def main() -> None:
    memory = os.environ.get("MEMORY")
    LastingSealer(int(sys.argv[1]), Path(os.environ["TRUTH"]), Path(memory) if memory else None)
    print("the server is up", flush=True)
    threading.Event().wait()


if __name__ == "__main__":
    main()

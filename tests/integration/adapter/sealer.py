"""A sealer with an HTTP interface of its own: what a vendor might sell. It keeps its own truth."""

from __future__ import annotations

import json
import threading
import time
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any
from urllib.parse import parse_qs, urlsplit


class Sealer:
    """``POST /action`` with ``{"action_handle", "action_vars"}`` blocks until it is done, as the paper
    has it; ``POST /jobs`` answers at once, and ``GET /jobs/ID`` tells how the job is."""

    def __init__(self) -> None:
        self.seals: list[dict[str, Any]] = []
        self.jobs: dict[str, dict[str, Any]] = {}
        self.broken = ""
        self._server = ThreadingHTTPServer(("127.0.0.1", 0), self._handler())
        self.port = self._server.server_address[1]
        threading.Thread(target=self._server.serve_forever, daemon=True).start()

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self.port}"

    def close(self) -> None:
        self._server.shutdown()
        self._server.server_close()

    def act(self, handle: str, told: dict[str, Any]) -> tuple[int, Any]:
        if handle != "seal":
            return 404, {"detail": f"no action {handle}"}
        if self.broken:
            return 200, {"status": "failed", "error": self.broken}
        self.seals.append(told)
        time.sleep(0.2)
        return 200, {"status": "succeeded", "data": {"foil": 1000 - len(self.seals)}}

    def answer(self, method: str, path: str, query: dict[str, list[str]], body: Any) -> tuple[int, Any]:
        match method, path.strip("/").split("/"):
            case "POST", ["action"]:
                told = body or {
                    "action_handle": query["action_handle"][0],
                    "action_vars": json.loads(query["action_vars"][0]),
                }
                return self.act(told["action_handle"], told["action_vars"])
            case "POST", ["jobs"]:
                name = body.get("id") or f"j{len(self.jobs) + 1}"
                job = self.jobs[name] = {"state": "running"}

                def work() -> None:
                    _, ended = self.act("seal", body["settings"])
                    job.update(state=ended["status"], error=ended.get("error"), data=ended.get("data"))

                threading.Thread(target=work, daemon=True).start()
                return 202, {"job": {"id": name}}
            case "GET", ["jobs", name]:
                return (200, self.jobs[name]) if name in self.jobs else (404, {"detail": "no such job"})
            case "GET", ["state"]:
                return 200, {"State": "ERROR" if self.broken else "IDLE", "why": self.broken}
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

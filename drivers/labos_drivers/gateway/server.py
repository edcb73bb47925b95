"""The reference gateway. It runs on the PC of an instrument whose own protocol is not published.

It needs only Python (3.9 or later), and this file can be copied alone. You write the class that uses the
maker's software::

    class Cycler(Hands):
        instrument = "biometra"
        actions = ("open_lid", "close_lid", "run_program")

        def do(self, action, args, folder):
            if action == "open_lid":
                self.library.OpenMotLid()
                self.wait_for_lid("open")

    python server.py cycler:Cycler --port 2100 --journal C:/labos/cycler.jsonl

The protocol, in JSON over HTTP:

- ``GET /``: the instrument, its actions, ``serial``, ``firmware``, and ``journal``: the name of the journal.
  If the journal was lost, the name is another. Then an unknown id does not show that nothing happened.
- ``PUT /actions/ID`` ``{"action": …, "args": {…}, "journal": …}``: start the action (201). An id is started
  only once; for a known id the answer is its state (200). 409: the instrument is busy, or the gateway has
  another journal. 422: refused. 503: the gateway is shutting down. After 409, 422 and 503 nothing has moved.
- ``GET /actions/ID``: the state: ``running``, ``succeeded``, ``failed``, ``void``, or ``interrupted`` (the
  gateway died during the action, and the outcome is unknown). With ``result``, ``error``, ``remedy``,
  ``effects``, ``files``, ``journal``. 404: the id is unknown.
- ``DELETE /actions/ID``: an unknown id becomes ``void`` and can never start; for a known id, its state.
- ``GET /actions/ID/files/NAME``: a file that the action left.
- ``GET /state``: ``busy``, the ``action`` in progress, and ``seen``, the values of the instrument's sensors.
- ``POST /stop``: end all motion: ``{"stopped": true}``, or false if the instrument cannot be stopped.
"""

from __future__ import annotations

import argparse
import functools
import importlib
import json
import os
import re
import secrets
import sys
import threading
from collections.abc import Callable
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any
from urllib.parse import unquote

VERSION = 1
LARGEST = 8 * 1024 * 1024
NAME = re.compile(r"\w[\w.\-]{0,99}")


class Refused(Exception):
    """The action was refused, or failed before anything moved."""

    effects = "none"

    def __init__(self, message: str, remedy: str = "") -> None:
        super().__init__(message)
        self.remedy = remedy


class Failed(Refused):
    """The action failed. ``effects`` says what it has done: none, partial, all, or unknown if not clear."""

    def __init__(self, message: str, remedy: str = "", effects: str = "unknown") -> None:
        super().__init__(message, remedy)
        self.effects = effects


class Unknown(Exception):
    """The outcome of the action cannot be found out."""


class Hands:
    """The part that controls the instrument. Subclasses set ``instrument`` and ``actions``."""

    instrument = ""
    actions: tuple[str, ...] = ()

    def serial(self) -> str:
        """The serial number that the instrument itself reports; empty if it reports none. If a PC has several
        instruments, their order may change: select yours by this number, not by its place in a list."""
        return ""

    def firmware(self) -> str:
        """The version of the instrument's firmware; empty if it is not reported."""
        return ""

    def do(self, action: str, args: dict[str, Any], folder: Path) -> Any:
        """Carry out an action (or ``reset``); return its result when it has really ended. Put files that it
        leaves into ``folder``. Raise Refused or Failed."""
        raise NotImplementedError

    def check(self, action: str, args: dict[str, Any]) -> None:
        """Raise Refused if the action cannot be done now. Called before any action or ``reset`` starts."""

    def look_back(self, action: str, folder: Path) -> Any:
        """Find out from sensors and files how an action ended during which the gateway died. Called when the
        instrument stands still. Return the result if the action was completed. Raise Failed if it was not,
        Unknown if sensors and files show neither."""
        raise Unknown("the gateway was restarted in mid-action")

    def is_idle(self) -> bool:
        """Whether the instrument stands still. Motions that this program did not start count too."""
        return True

    def read_sensors(self) -> dict[str, Any]:
        """The values of the instrument's sensors, as ``{"lid": "open"}``."""
        return {}

    def stop(self) -> bool:
        """End all motion; returns False if this is not possible."""
        return False


class Gateway:
    """Carries out actions by their ids, each id only once. A start is journalled before anything moves."""

    def __init__(self, hands: Hands, journal: Path) -> None:
        self.hands = hands
        self.busy = ""
        self._entries: dict[str, dict[str, Any]] = {}
        self._lock = threading.Lock()
        self._folder = journal.with_suffix(".files")
        journal.parent.mkdir(parents=True, exist_ok=True)
        self.journal = ""
        for entry in _read_entries(journal):
            if "journal" in entry:
                self.journal = entry["journal"]
            else:
                self._entries[entry["id"]] = entry
        self._left = [entry for entry in self._entries.values() if entry["status"] == "running"]
        torn = journal.exists() and not journal.read_bytes().endswith(b"\n")
        self._file = open(journal, "a", encoding="utf-8")  # noqa: SIM115 (open until ``close``)
        if torn:
            self._file.write("\n")
        if not self.journal:
            self.journal = secrets.token_hex(8)
            self._write({"journal": self.journal})

    def close(self) -> None:
        with self._lock:
            self._file.close()

    def start(self, name: str, body: Any) -> tuple[int, dict[str, Any]]:
        """Start an action; returns HTTP status and answer. Raises AttributeError if the body is no object."""
        action, args = body.get("action"), body.get("args") or {}
        with self._lock:
            self._look_back()
            if name in self._entries:
                return 200, self._entries[name]
            if self._file.closed:
                return 503, {"error": "the gateway shuts down"}
            if body.get("journal", self.journal) != self.journal:
                return 409, {"error": "its journal is not the one that was asked"}
            if self.busy or not self.hands.is_idle():
                return 409, {"error": "the instrument is at work"}
            if action != "reset" and action not in self.hands.actions:
                return 422, {"error": f"there is no action {action!r}"}
            try:
                self.hands.check(action, args)
            except Refused as error:
                return 422, {"error": str(error), "remedy": error.remedy}
            entry = {"id": name, "action": action, "status": "running"}
            self._keep(entry)
            self.busy = name
        threading.Thread(target=self._carry_out, args=(name, action, args), daemon=True).start()
        return 201, entry

    def state(self, name: str) -> dict[str, Any] | None:
        with self._lock:
            self._look_back()
            return self._entries.get(name)

    def void(self, name: str) -> dict[str, Any]:
        with self._lock:
            self._look_back()
            if name not in self._entries:
                self._keep({"id": name, "status": "void"})
            return self._entries[name]

    def file(self, name: str, file: str) -> bytes | None:
        path = self._folder / name / file
        plain = NAME.fullmatch(name) and file == path.name
        return path.read_bytes() if plain and path.is_file() else None

    def _carry_out(self, name: str, action: str, args: dict[str, Any]) -> None:
        end = self._run_action(name, action, lambda folder: self.hands.do(action, args, folder))
        with self._lock:
            self.busy = ""
            self._keep(end)

    def _look_back(self) -> None:
        """Find out how an action ended during which the gateway died. It counts as running until the
        instrument stands still."""
        while self._left and self.hands.is_idle():
            entry = self._left.pop()
            action = entry["action"]
            look = functools.partial(self.hands.look_back, action)
            self._keep(self._run_action(entry["id"], action, look))

    def _run_action(self, name: str, action: str, work: Callable[[Path], Any]) -> dict[str, Any]:
        """Do the work of an action; returns the journal entry with its outcome."""
        folder = self._folder / name
        end: dict[str, Any] = {"id": name, "action": action}
        try:
            folder.mkdir(parents=True, exist_ok=True)
            end.update(status="succeeded", result=work(folder))
            end["files"] = sorted(path.name for path in folder.iterdir())
            json.dumps(end)
        except Unknown as error:
            end.update(status="interrupted", error=str(error))
        except Refused as error:
            end.update(status="failed", error=str(error), remedy=error.remedy, effects=error.effects)
        except Exception as error:
            end.pop("result", None)
            end.update(status="failed", error=f"{type(error).__name__}: {error}", effects="unknown")
        return end

    def _keep(self, entry: dict[str, Any]) -> None:
        self._entries[entry["id"]] = entry
        if not self._file.closed:
            self._write(entry)

    def _write(self, entry: dict[str, Any]) -> None:
        self._file.write(json.dumps(entry) + "\n")
        self._file.flush()
        os.fsync(self._file.fileno())


def _read_entries(journal: Path) -> list[dict[str, Any]]:
    """The entries of a journal. A line that is cut off is skipped: its action has not started, or still
    counts as running."""
    entries = []
    for line in journal.read_text("utf-8").splitlines() if journal.exists() else ():
        try:
            entries.append(json.loads(line))
        except ValueError:
            continue
    return entries


class Server(ThreadingHTTPServer):
    """The HTTP server of a gateway."""

    daemon_threads = True
    block_on_close = False

    def __init__(self, gateway: Gateway, host: str = "127.0.0.1", port: int = 0) -> None:
        self.gateway = gateway
        super().__init__((host, port), Handler)

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Do nothing: a client that closes its connection is no error."""


class Handler(BaseHTTPRequestHandler):
    """Handles one request."""

    server: Server

    def do_GET(self) -> None:
        gateway, parts = self.server.gateway, self._split_path()
        if not parts:
            hands = gateway.hands
            about = {"gateway": VERSION, "instrument": hands.instrument, "actions": list(hands.actions)}
            unit = {"serial": hands.serial(), "firmware": hands.firmware()}
            self._send(200, {**about, **unit, "journal": gateway.journal})
        elif parts == ["state"]:
            busy = bool(gateway.busy) or not gateway.hands.is_idle()
            self._send(200, {"busy": busy, "action": gateway.busy, "seen": gateway.hands.read_sensors()})
        elif len(parts) == 2 and parts[0] == "actions":
            state = gateway.state(parts[1])
            self._send(*((200, self._with_journal(state)) if state else (404, {"error": "never heard of"})))
        elif len(parts) == 4 and (parts[0], parts[2]) == ("actions", "files"):
            data = gateway.file(parts[1], parts[3])
            self._send(*((200, data) if data is not None else (404, {"error": "there is no such file"})))
        else:
            self._send(404, {"error": "there is nothing here"})

    def do_PUT(self) -> None:
        parts = self._split_path()
        size = int(self.headers.get("Content-Length") or 0)
        if len(parts) != 2 or parts[0] != "actions" or not NAME.fullmatch(parts[1]) or size > LARGEST:
            self._send(422, {"error": "the request is no action"})
            return
        try:
            body = json.loads(self.rfile.read(size))
            status, answer = self.server.gateway.start(parts[1], body)
        except (ValueError, AttributeError):
            status, answer = 422, {"error": "the request is no JSON object"}
        self._send(status, self._with_journal(answer))

    def do_DELETE(self) -> None:
        parts = self._split_path()
        if len(parts) == 2 and parts[0] == "actions" and NAME.fullmatch(parts[1]):
            self._send(200, self._with_journal(self.server.gateway.void(parts[1])))
        else:
            self._send(404, {"error": "there is nothing here"})

    def do_POST(self) -> None:
        if self._split_path() == ["stop"]:
            self._send(200, {"stopped": bool(self.server.gateway.hands.stop())})
        else:
            self._send(404, {"error": "there is nothing here"})

    def log_message(self, format: str, *args: Any) -> None:
        """Do nothing: requests are not written to the terminal."""

    def _with_journal(self, entry: dict[str, Any]) -> dict[str, Any]:
        """An entry with the name of the gateway's journal."""
        return {**entry, "journal": self.server.gateway.journal}

    def _split_path(self) -> list[str]:
        return [unquote(part) for part in self.path.partition("?")[0].split("/") if part]

    def _send(self, status: int, body: Any) -> None:
        data = body if isinstance(body, bytes) else json.dumps(body).encode()
        self.send_response(status)
        kind = "application/octet-stream" if isinstance(body, bytes) else "application/json"
        self.send_header("Content-Type", kind)
        self.send_header("Content-Length", str(len(data)))
        self.end_headers()
        self.wfile.write(data)


def main() -> None:
    """Start the gateway, and serve until the process ends."""
    parser = argparse.ArgumentParser(description="A gateway between LabOS and an instrument's own software.")
    parser.add_argument("hands", help="your class, as module:Class")
    parser.add_argument("--host", default="127.0.0.1", help="0.0.0.0 lets other computers in; see the page")
    parser.add_argument("--port", type=int, default=2100)
    parser.add_argument("--journal", type=Path, required=True, help="a file that outlives the gateway")
    options = parser.parse_args()
    sys.path.insert(0, os.getcwd())
    module, _, name = options.hands.partition(":")
    hands = getattr(importlib.import_module(module), name)()
    server = Server(Gateway(hands, options.journal), options.host, options.port)
    sys.stdout.write(f"{hands.instrument} at http://{options.host}:{server.server_port}\n")
    sys.stdout.flush()
    server.serve_forever()


if __name__ == "__main__":
    # Call ``main`` of the imported module, not of ``__main__``. Then this file catches the same classes
    # Refused and Failed that your class raises.
    importlib.import_module(f"{__package__}.server" if __package__ else Path(__file__).stem).main()

"""The reference gateway: what runs on the PC of an instrument whose own protocol is closed.

It needs Python (3.9 or later) and nothing else; this file may be copied by itself. What knows the
maker's software is a class of yours::

    class Cycler(Hands):
        instrument = "biometra"
        actions = ("open_lid", "close_lid", "run_program")

        def do(self, action, args, folder):
            if action == "open_lid":
                self.library.OpenMotLid()
                self.wait_for_lid("open")

    python server.py cycler:Cycler --port 2100 --journal C:/labos/cycler.jsonl

The protocol, in JSON over HTTP:

- ``GET /``: which instrument this is, its actions, and the ``journal``: a name that each journal bears, so
  that what a lost journal knew is not taken for what never happened.
- ``PUT /actions/ID`` ``{"action": …, "args": {…}, "journal": …}``: start it. An id is started once and never
  again: a known one is answered with its state. 409: it is at work, or the journal is another. 422: refused.
  503: it shuts down. Then nothing moved.
- ``GET /actions/ID``: ``running``, ``succeeded``, ``failed``, ``void``, or ``interrupted``: the gateway died
  meanwhile, and nothing shows what became of it. With ``result``, ``error``, ``remedy``, ``effects``,
  ``files``, ``journal``. 404: never heard of.
- ``DELETE /actions/ID``: if it was never heard of, it is ``void`` and will never be started; else its state.
- ``GET /actions/ID/files/NAME``: a file that it left.
- ``GET /state``: ``busy``, the ``action`` under way, and ``seen``, what the instrument's own sensors see.
- ``POST /stop``: end all motion, if that can be done: ``{"stopped": true}``.
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
    """The action failed, and what it had done by then is ``effects``: unknown if you cannot tell."""

    def __init__(self, message: str, remedy: str = "", effects: str = "unknown") -> None:
        super().__init__(message, remedy)
        self.effects = effects


class Unknown(Exception):
    """Nothing shows what became of the action."""


class Hands:
    """What moves the instrument. Subclasses name it and its actions."""

    instrument = ""
    actions: tuple[str, ...] = ()

    def serial(self) -> str:
        """The instrument's serial number, as the instrument itself tells it; empty if it tells none. A PC may
        have several, in an order that changes: choose yours by it, not by its place in a list."""
        return ""

    def firmware(self) -> str:
        """The version of the instrument's firmware; empty if it is not told."""
        return ""

    def do(self, action: str, args: dict[str, Any], folder: Path) -> Any:
        """Carry an action (or ``reset``) out and return its result when it has truly ended. Files that it
        leaves go to ``folder``. Raise Refused or Failed."""
        raise NotImplementedError

    def check(self, action: str, args: dict[str, Any]) -> None:
        """Raise Refused for what cannot be done now; asked before an action is accepted."""

    def look_back(self, action: str, folder: Path) -> Any:
        """What became of an action in whose middle the gateway died, as sensors and files show it; asked when
        the instrument stands still. Return its result if it was done to its end. Raise Failed if they show
        that it was not, Unknown if they show neither."""
        raise Unknown("the gateway was restarted in mid-action")

    def is_idle(self) -> bool:
        """Whether the instrument stands still, also if it was not we who moved it."""
        return True

    def read_sensors(self) -> dict[str, Any]:
        """The values of the instrument's sensors, as ``{"lid": "open"}``."""
        return {}

    def stop(self) -> bool:
        """End all motion; False if that cannot be done."""
        return False


class Gateway:
    """Actions by their ids, each started once; each start is written down before anything moves."""

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
        self._file = open(journal, "a", encoding="utf-8")  # noqa: SIM115 (as long as it lives)
        if torn:
            self._file.write("\n")
        if not self.journal:
            self.journal = secrets.token_hex(8)
            self._write({"journal": self.journal})

    def close(self) -> None:
        with self._lock:
            self._file.close()

    def start(self, name: str, body: Any) -> tuple[int, dict[str, Any]]:
        """Start an action; returns HTTP status and answer. Raises ValueError."""
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
        """Find out how the action ended in whose middle the gateway died. It counts as running until the
        instrument stands still."""
        while self._left and self.hands.is_idle():
            entry = self._left.pop()
            action = entry["action"]
            look = functools.partial(self.hands.look_back, action)
            self._keep(self._run_action(entry["id"], action, look))

    def _run_action(self, name: str, action: str, work: Callable[[Path], Any]) -> dict[str, Any]:
        """Do the work of an action, and return the entry of its end."""
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
    """The entries of a journal, without a line that is cut off: what that is about was not begun."""
    entries = []
    for line in journal.read_text("utf-8").splitlines() if journal.exists() else ():
        try:
            entries.append(json.loads(line))
        except ValueError:
            continue
    return entries


class Server(ThreadingHTTPServer):
    """The gateway at a port."""

    daemon_threads = True
    block_on_close = False

    def __init__(self, gateway: Gateway, host: str = "127.0.0.1", port: int = 0) -> None:
        self.gateway = gateway
        super().__init__((host, port), Handler)

    def handle_error(self, request: Any, client_address: Any) -> None:
        """Clients that close their connection are no error."""


class Handler(BaseHTTPRequestHandler):
    """One request."""

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
        """Nothing is written to the terminal."""

    def _with_journal(self, entry: dict[str, Any]) -> dict[str, Any]:
        """An entry with the name of the journal that has it."""
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
    """Serve until the process is ended."""
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
    # Under its name, so that Refused and Failed of your class are those that are caught here.
    importlib.import_module(f"{__package__}.server" if __package__ else Path(__file__).stem).main()

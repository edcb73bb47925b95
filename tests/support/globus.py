"""A stand-in for the web services of Globus, on one address: Compute, Flows, Transfer and Search, as far as
LabOS asks them. Written from their public descriptions; it keeps its own truth of what arrived and was done.

A request can be made to fail: with a status; ``lost``, done but not answered; or ``cut``, not done and not
answered. With the id of a process, that is killed at the same moment.
"""

from __future__ import annotations

import hashlib
import json
import os
import signal
import threading
import traceback
import uuid
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any
from urllib.parse import parse_qs, urlsplit

TOKEN = "let-me-in"


class Fault(Exception):
    """An answer that is no success."""

    def __init__(self, status: int, code: str, message: str, **headers: str) -> None:
        super().__init__(message)
        self.status, self.code, self.message, self.headers = status, code, message, headers


class Globus:
    """What the services hold. ``requests`` counts what arrived, by method and path; ids stand there as *."""

    def __init__(self) -> None:
        self.lock = threading.RLock()
        self.requests: Counter[str] = Counter()
        self.faults: dict[str, list[Any]] = {}
        self.lets_in = {TOKEN}
        # Compute
        self.functions: dict[str, str] = {}
        self.groups: dict[str, list[str]] = {}
        self.tasks: dict[str, dict[str, Any]] = {}
        self.executed: list[str] = []
        self.deaths: list[str] = []
        self.holds = threading.Event()
        self.holds.set()
        # Flows
        self.runs: dict[str, dict[str, Any]] = {}
        self.run_ends: list[str] = []
        # Transfer
        self.files: dict[tuple[str, str], bytes] = {}
        self.submissions: dict[str, str] = {}
        self.transfers: dict[str, dict[str, Any]] = {}
        self.transfer_ends: list[str] = []
        # Search
        self.entries: dict[tuple[str, str], dict[str, Any]] = {}
        self.ingests: dict[str, dict[str, Any]] = {}
        self.ingest_ends: list[str] = []

    def fail(self, request: str, *how: Any) -> None:
        """The next requests of a kind, such as ``POST /v0.10/transfer``, fail like this."""
        self.faults.setdefault(request, []).extend(how)

    def count(self, part: str) -> int:
        """How many requests of a kind arrived."""
        return sum(number for name, number in self.requests.items() if part in name)

    # -- Compute ---------------------------------------------------------------------------------

    def register_function(self, body: dict[str, Any]) -> dict[str, Any]:
        name = str(uuid.uuid4())
        self.functions[name] = body["function_code"]
        return {"function_uuid": name}

    def submit_tasks(self, endpoint: str, body: dict[str, Any]) -> dict[str, Any]:
        group = body.get("task_group_id") or str(uuid.uuid4())
        if "task_group_id" in body and group not in self.groups:
            raise Fault(404, "TASK_GROUP_NOT_FOUND", f"There is no task group {group}")
        made: dict[str, list[str]] = {}
        for function, payloads in body["tasks"].items():
            if function not in self.functions:
                raise Fault(404, "FUNCTION_NOT_FOUND", f"There is no function {function}")
            for payload in payloads:
                task = str(uuid.uuid4())
                self.tasks[task] = {"task_id": task, "status": "waiting-for-nodes"}
                self.groups.setdefault(group, []).append(task)
                made.setdefault(function, []).append(task)
                threading.Thread(target=self._execute, args=(task, function, payload), daemon=True).start()
        return {
            "request_id": str(uuid.uuid4()),
            "task_group_id": group,
            "endpoint_id": endpoint,
            "tasks": made,
        }

    def _execute(self, task: str, function: str, payload: str) -> None:
        """As a worker at an endpoint: it knows of a task only what came over the wire."""
        from globus_compute_sdk.serialize import ComputeSerializer

        self.holds.wait(60)
        forms = ComputeSerializer()
        ended: dict[str, Any] = {"task_id": task, "completion_t": "1677183605.212898"}
        try:
            call = forms.unpack_and_deserialize(f"{self.functions[function]}{payload}")
            called, args, named = call
            with self.lock:
                if args:  # what begins a group has none
                    self.executed.append(task)
                death = self.deaths.pop(0) if args and self.deaths else ""
            if death:
                raise RuntimeError(death)
            ended |= {"status": "success", "result": forms.serialize(called(*args, **named))}
        except Exception:
            ended |= {"status": "failed", "exception": traceback.format_exc()}
        with self.lock:
            self.tasks[task] = ended

    # -- Flows -----------------------------------------------------------------------------------

    def run_flow(self, flow: str, body: dict[str, Any]) -> dict[str, Any]:
        run = str(uuid.uuid4())
        end = self.run_ends.pop(0) if self.run_ends else "SUCCEEDED"
        self.runs[run] = {
            "run_id": run,
            "flow_id": flow,
            "status": "ACTIVE",
            "tags": body.get("tags", []),
            "label": body.get("label"),
            "details": {"code": "FlowStarting", "description": "The Flow is starting execution"},
            "end": (end, body["body"]),
            "looks": 0,
        }
        return self._describe_run(run)

    def look_at_run(self, run: str) -> dict[str, Any]:
        found = self.runs[run]
        found["looks"] += 1
        if found["looks"] > 1:
            end, given = found["end"]
            found["status"] = end
            found["details"] = (
                {
                    "code": "FlowSucceeded",
                    "description": "The Flow run reached a successful completion state",
                    "output": {"input": given, "Fit": {"mean": sum(given.get("values", [0]))}},
                }
                if end == "SUCCEEDED"
                else {"code": "FlowFailed", "description": "State Fit of type Action failed"}
            )
        return self._describe_run(run)

    def _describe_run(self, run: str) -> dict[str, Any]:
        return {name: value for name, value in self.runs[run].items() if name not in ("end", "looks")}

    def list_runs(self, flow: str) -> dict[str, Any]:
        found = [self._describe_run(run) for run in reversed(self.runs) if self.runs[run]["flow_id"] == flow]
        return {"runs": found, "limit": 100, "has_next_page": False, "marker": None}

    def run_logs(self, run: str) -> dict[str, Any]:
        is_good = self.runs[run]["status"] == "SUCCEEDED"
        names = [
            ("Extract", "ActionStarted"),
            ("Extract", "ActionCompleted"),
            ("Fit", "ActionStarted"),
            ("Fit", "ActionCompleted" if is_good else "ActionFailed"),
        ]
        entries: list[dict[str, Any]] = [
            {
                "time": f"2023-04-25T18:54:3{number}+00:00",
                "code": code,
                "description": f"State {state}",
                "details": {"state_name": state, "state_type": "Action"},
            }
            for number, (state, code) in enumerate(names)
        ]
        begun = {"code": "FlowStarted", "description": "", "details": {}}
        return {
            "limit": 10,
            "has_next_page": False,
            "entries": [{"time": "2023-04-25T18:54:29+00:00", **begun}, *entries],
        }

    # -- Transfer --------------------------------------------------------------------------------

    def submit_transfer(self, body: dict[str, Any]) -> dict[str, Any]:
        submission = body["submission_id"]
        if submission not in self.submissions:
            raise Fault(400, "BadRequest", "The submission id is none of ours")
        code = "Duplicate"
        if not self.submissions[submission]:
            code, task = "Accepted", str(uuid.uuid4())
            self.submissions[submission] = task
            self.transfers[task] = {"task_id": task, "status": "ACTIVE", "of": body, "looks": 0}
        return {
            "DATA_TYPE": "transfer_result",
            "code": code,
            "submission_id": submission,
            "task_id": self.submissions[submission],
        }

    def look_at_transfer(self, task: str) -> dict[str, Any]:
        found = self.transfers[task]
        found["looks"] += 1
        if found["looks"] == 2:
            self._carry(found)
        return {name: value for name, value in found.items() if name not in ("of", "looks")}

    def _carry(self, found: dict[str, Any]) -> None:
        (item,) = found["of"]["DATA"]
        source = (found["of"]["source_endpoint"], item["source_path"])
        end = self.transfer_ends.pop(0) if self.transfer_ends else "SUCCEEDED"
        content = self.files.get(source)
        is_other = content is not None and item.get("external_checksum") not in (
            None,
            hashlib.sha256(content).hexdigest(),
        )
        found |= {"status": end, "bytes_transferred": 0, "fatal_error": None}
        if end == "FAILED" or content is None or is_other:
            code = "VERIFY_CHECKSUM_MISMATCH" if is_other else "ENDPOINT_ERROR"
            found |= {"status": "FAILED", "fatal_error": {"code": code, "description": "It cannot be had"}}
        elif end == "SUCCEEDED":
            self.files[found["of"]["destination_endpoint"], item["destination_path"]] = content
            found["bytes_transferred"] = len(content)

    def successful_transfers(self, task: str) -> dict[str, Any]:
        (item,) = self.transfers[task]["of"]["DATA"]
        told = {name: item[name] for name in ("source_path", "destination_path")}
        return {"DATA_TYPE": "successful_transfers", "marker": 0, "next_marker": None, "DATA": [told]}

    # -- Search ----------------------------------------------------------------------------------

    def ingest(self, index: str, body: dict[str, Any]) -> dict[str, Any]:
        task = str(uuid.uuid4())
        self.ingests[task] = {"task_id": task, "index_id": index, "state": "PENDING", "of": body, "looks": 0}
        return {"acknowledged": True, "success": True, "task_id": task, "num_documents_ingested": 0}

    def look_at_ingest(self, task: str) -> dict[str, Any]:
        found = self.ingests[task]
        found["looks"] += 1
        if found["looks"] == 2:
            end = self.ingest_ends.pop(0) if self.ingest_ends else "SUCCESS"
            found |= {"state": end, "message": None if end == "SUCCESS" else "The entry has no such type"}
            if end == "SUCCESS":
                entry = found["of"]["ingest_data"]
                self.entries[found["index_id"], entry["subject"]] = entry
        return {name: value for name, value in found.items() if name not in ("of", "looks")}

    # -- the wire --------------------------------------------------------------------------------

    def answer(self, method: str, target: str, body: dict[str, Any]) -> dict[str, Any]:
        url = urlsplit(target)
        asked = {name: values[0] for name, values in parse_qs(url.query).items()}
        parts = [part for part in url.path.split("/") if part]
        match method, parts:
            case "POST", ["v2", "functions"]:
                return self.register_function(body)
            case "POST", ["v3", "endpoints", endpoint, "submit"]:
                return self.submit_tasks(endpoint, body)
            case "GET", ["v2", "tasks", task] if task in self.tasks:
                return self.tasks[task]
            case "GET", ["v2", "taskgroup", group] if group in self.groups:
                made = [{"id": task, "created_at": "2021-05-05T15:00:00.0"} for task in self.groups[group]]
                return {"taskgroup_id": group, "tasks": made}
            case "POST", ["flows", flow, "run"]:
                return self.run_flow(flow, body)
            case "GET", ["runs"]:
                return self.list_runs(asked["filter_flow_id"])
            case "GET", ["runs", run] if run in self.runs:
                return self.look_at_run(run)
            case "GET", ["runs", run, "log"] if run in self.runs:
                return self.run_logs(run)
            case "GET", ["v0.10", "submission_id"]:
                made_id = str(uuid.uuid4())
                self.submissions[made_id] = ""
                return {"value": made_id}
            case "POST", ["v0.10", "transfer"]:
                return self.submit_transfer(body)
            case "GET", ["v0.10", "task", task] if task in self.transfers:
                return self.look_at_transfer(task)
            case "GET", ["v0.10", "task", task, "successful_transfers"] if task in self.transfers:
                return self.successful_transfers(task)
            case "POST", ["v1", "index", index, "ingest"]:
                return self.ingest(index, body)
            case "GET", ["v1", "task", task] if task in self.ingests:
                return self.look_at_ingest(task)
        raise Fault(404, "NOT_FOUND", f"There is no {url.path}")


@contextmanager
def serve() -> Iterator[tuple[Globus, str]]:
    """The services, and their address."""
    globus = Globus()

    class Handler(BaseHTTPRequestHandler):
        protocol_version = "HTTP/1.1"

        def do_GET(self) -> None:
            self._answer()

        def do_POST(self) -> None:
            self._answer()

        def _answer(self) -> None:
            body = json.loads(self.rfile.read(int(self.headers.get("Content-Length") or 0)) or b"{}")
            name = f"{self.command} {_shape(self.path)}"
            with globus.lock:
                globus.requests[name] += 1
                how = globus.faults[name].pop(0) if globus.faults.get(name) else None
                how, victim = how if isinstance(how, tuple) else (how, 0)
                try:
                    if self.headers.get("Authorization", "") not in {f"Bearer {t}" for t in globus.lets_in}:
                        raise Fault(401, "AUTHENTICATION_ERROR", "The token is not valid")
                    if isinstance(how, int):
                        after = {"Retry_After": "0"} if how in (429, 503) else {}
                        raise Fault(how, "FAULT", "As the test wants it", **after)
                    told = globus.answer(self.command, self.path, body) if how != "cut" else {}
                    status, headers = 200, {}
                except Fault as fault:
                    status, headers = fault.status, fault.headers
                    told = {"code": fault.code, "message": fault.message}
            if victim:
                os.kill(victim, signal.SIGKILL)
            if how in ("cut", "lost"):
                self.close_connection = True
                return
            content = json.dumps(told).encode()
            self.send_response(status)
            self.send_header("Content-Type", "application/json")
            self.send_header("Content-Length", str(len(content)))
            for key, value in headers.items():
                self.send_header(key.replace("_", "-"), value)
            self.end_headers()
            self.wfile.write(content)

        def log_message(self, format: str, *args: Any) -> None:
            pass

    with ThreadingHTTPServer(("127.0.0.1", 0), Handler) as server:
        server.daemon_threads = True
        thread = threading.Thread(target=server.serve_forever, daemon=True)
        thread.start()
        try:
            yield globus, f"http://127.0.0.1:{server.server_address[1]}"
        finally:
            server.shutdown()
            thread.join()


def _shape(path: str) -> str:
    """A path with * for each id."""

    def is_id(part: str) -> bool:
        return part.count("-") == 4 and len(part) == 36

    return "/".join("*" if is_id(part) else part for part in urlsplit(path).path.split("/"))

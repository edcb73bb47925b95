"""A simulated OT-2 behind its robot server: protocols, analyses, runs and their states, as in its public
OpenAPI.

If Opentrons' own software is available (``software``), it runs each protocol: for the analysis, and again at
``play``. Otherwise no protocol is run: the analysis checks only that the file is Python or JSON, and a run
works on all plates on the deck. In both cases a run takes as long as a usual run.
"""

from __future__ import annotations

import ast
import hashlib
import json
import os
import re
from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from email import policy
from email.parser import BytesParser
from typing import Any

from labos.node import Crash, Setup
from labos_drivers._onhttp import HttpEnd, OnHttp, Reply, Request
from labos_drivers.ot2 import protocol
from labos_drivers.ot2.simulator import COLUMN, SLOTS
from labos_drivers.ot2.software import VARIABLE, ProtocolOutput, RunningProtocol, Software

COMMANDS = ("home", "pickUpTip", "aspirate", "dispense", "blowout", "dropTip")
RUN_S, ANALYSIS_S, HOME_S = 600.0, 20.0, 15.0
WORKS_AT = 3
"""What a protocol does to the deck is done in one of its commands."""
LOOK_S = 0.05
"""How often it is seen whether the software has come to the end of a run, in real time."""
MOST_RUNS, MOST_PROTOCOLS = 20, 5
BEGAN = datetime(2024, 1, 1, tzinfo=UTC)


class Disk:
    """The data that survives a loss of power: protocols, and runs with their actions. The progress of a run
    is stored only when another run takes its place."""

    def __init__(self) -> None:
        self.protocols: dict[str, dict[str, Any]] = {}
        self.files: dict[str, tuple[str, bytes]] = {}
        self.runs: dict[str, dict[str, Any]] = {}
        self.number = 0


class OT2OnWire(OnHttp):
    """The simulated robot. ``simulate`` is the program ``opentrons_simulate``; empty for none. If it is None,
    the environment variable ``LABOS_OPENTRONS_SIMULATE`` names the program. Raises DeviceError if the program
    is not found."""

    drawers = SLOTS

    serial = "OT2CEP20200309B04"

    def __init__(
        self,
        setup: Setup,
        end: HttpEnd | None = None,
        disk: Disk | None = None,
        *,
        simulate: str | None = None,
    ) -> None:
        program = os.environ.get(VARIABLE, "") if simulate is None else simulate
        self._software = Software(program) if program else None
        self._running: dict[RunningProtocol, Callable[[ProtocolOutput], None]] = {}
        self._played: RunningProtocol | None = None
        self._ran: dict[str, ProtocolOutput] = {}
        super().__init__(setup, end)
        self._disk = disk or Disk()
        self.protocols, self._files, self.runs = self._disk.protocols, self._disk.files, self._disk.runs
        self.current = ""
        self.door_is_open = False
        self.lights = False
        self.fails_with = ""
        """A protocol fails with this error in its next command."""
        self.needs_person = False
        """A protocol meets an error in its next command that a person can mend."""
        self.takes_offsets = True
        self.starting = False
        self._at: dict[str, int] = {}
        self._next_ends = False
        self._start_up()

    def _start_up(self) -> None:
        """Discard analyses that the loss of power interrupted, and mark the current run as stopped."""
        for held in self.protocols.values():
            done = [analysis for analysis in held["analysisSummaries"] if analysis["status"] == "completed"]
            held["analysisSummaries"] = done
        for run in self.runs.values():
            if run["current"]:  # its record is lost: it is reported as stopped, however it ended
                run |= {"ok": False, "current": False, "status": protocol.STOPPED, "errors": []}

    def close(self) -> None:
        super().close()
        for running in self._running:
            running.kill()
        self._running.clear()

    # -- requests ----------------------------------------------------------------------------

    def listen(self, timeout_s: float) -> None:
        super().listen(timeout_s)
        for running in list(self._running):
            if (ran := running.poll()) is not None:
                self._running.pop(running)(ran)

    def answer(self, request: Request) -> Reply:
        if "opentrons-version" not in request.headers:
            return _make_error(422, "HeaderMissing", "Opentrons-Version is missing")
        if self.starting:
            return Reply(503, {"message": "Motor controller not ready", "errorCode": "4000"})
        try:
            reply = self._route(request)
        except ValueError as error:
            reply = _make_error(422, "InvalidRequest", str(error))
        reply.headers = {"Opentrons-Version": "4", "Opentrons-Min-Version": "2"}
        return reply

    def _route(self, request: Request) -> Reply:
        match request.method, *request.parts:
            case "GET", "health":
                return Reply(200, _HEALTH | {"name": self.name, "robot_serial": self.serial})
            case "POST", "protocols":
                return self._upload(request)
            case "GET", "protocols", name if name in self.protocols:
                return Reply(200, {"data": self.protocols[name]})
            case "GET", "protocols", name, "analyses" if name in self.protocols:
                return Reply(200, {"data": self.protocols[name]["analysisSummaries"]})
            case "POST", "runs":
                return self._create(request.json())
            case "GET", "runs":
                links = {"current": {"href": f"/runs/{self.current}"}} if self.current else {}
                size = int(request.query.get("pageLength", 20))
                return Reply(200, {"data": list(self.runs.values())[-size:], "links": links})
            case method, "runs", name, *more if name in self.runs:
                return self._about_run(method, self.runs[name], tuple(more), request)
            case "POST", "robot", "home":
                return self._home()
            case "POST", "robot", "lights":
                self.lights = bool(request.json()["on"])
                return Reply(200, {"on": self.lights})
            case "GET", "robot", "lights":
                return Reply(200, {"on": self.lights})
            case _, ("runs" | "protocols") as kind, name, *_:
                return _make_error(404, f"{kind.title()[:-1]}NotFound", f"{name} was not found.")
        return Reply(404, {"message": "Not found", "errorCode": "4000"})

    def _about_run(self, method: str, run: dict[str, Any], more: tuple[str, ...], request: Request) -> Reply:
        match method, *more:
            case ("GET",):
                return Reply(200, {"data": run})
            case "GET", "commands":
                done = self._list_commands(run)
                return Reply(200, {"data": done, "meta": {"cursor": 0, "totalLength": len(done)}})
            case "POST", "actions":
                return self._act(run, str(request.json()["data"]["actionType"]))
            case ("PATCH",):
                if run["id"] != self.current:
                    return _make_error(409, "RunStopped", f"Run {run['id']} is not the current run.")
                if run["status"] not in (protocol.IDLE, *protocol.TERMINAL):
                    return _make_error(409, "RunNotIdle", "The run is under way.")
                self._retire()
                return Reply(200, {"data": run})
            case ("DELETE",):
                if run["status"] not in (protocol.IDLE, *protocol.TERMINAL):
                    return _make_error(409, "RunNotIdle", "The run is under way.")
                if run["id"] == self.current:
                    self._retire()
                del self.runs[run["id"]]
                return Reply(200, {})
        return Reply(405, {"message": "Method not allowed", "errorCode": "4000"})

    # -- protocols and runs ------------------------------------------------------------------

    def _upload(self, request: Request) -> Reply:
        files = _parse_files(request)
        if not files:
            return _make_error(422, "ProtocolFilesInvalid", "No files were provided.")
        name, content = files[0]
        known = next((key for key, held in self._files.items() if held == (name, content)), "")
        if known:
            if not self.protocols[known]["analysisSummaries"]:
                self._analyse(known)
            return Reply(200, {"data": self.protocols[known]})
        if not name.endswith((".py", ".json")):
            return _make_error(422, "ProtocolFilesInvalid", f'"{name}" is not a valid protocol file.')
        used = {run["protocolId"] for run in self.runs.values()}
        unused = [key for key in self.protocols if key not in used]
        for key in unused[: max(len(unused) - MOST_PROTOCOLS + 1, 0)]:
            del self.protocols[key], self._files[key]
        key = self._make_name("protocol")
        self._files[key] = name, content
        self.protocols[key] = {
            "id": key,
            "createdAt": self._format_time(),
            "files": [
                {"name": name, "role": "main"},
                *({"name": n, "role": "labware"} for n, _ in files[1:]),
            ],
            "protocolType": "json" if name.endswith(".json") else "python",
            "robotType": "OT-2 Standard",
            "metadata": {},
            "analysisSummaries": [],
        }
        self._analyse(key)
        return Reply(201, {"data": self.protocols[key]})

    def _analyse(self, key: str) -> None:
        analysis: dict[str, Any] = {"id": self._make_name("analysis"), "status": "pending"}
        self.protocols[key]["analysisSummaries"].append(analysis)
        if self._software is None:
            self.after(ANALYSIS_S, lambda: analysis.update(_analyse(*self._files[key])))
        else:
            running = self._software.run(*self._files[key])
            self._running[running] = lambda ran: analysis.update(_make_analysis(ran.errors))

    def _create(self, body: Any) -> Reply:
        wanted = (body or {}).get("data", {})
        name = wanted.get("protocolId", "")
        if name not in self.protocols:
            return _make_error(404, "ProtocolNotFound", f"Protocol {name} was not found.")
        if self.current and self.runs[self.current]["status"] not in (protocol.IDLE, *protocol.TERMINAL):
            return _make_error(409, "RunAlreadyActive", f"{self.current} is still active.")
        self._retire()
        for old in list(self.runs)[: max(len(self.runs) - MOST_RUNS + 1, 0)]:
            del self.runs[old]
        self.current = self._make_name("run")
        self.runs[self.current] = run = {
            "id": self.current,
            "ok": True,
            "createdAt": self._format_time(),
            "status": protocol.IDLE,
            "current": True,
            "actions": [],
            "errors": [],
            "pipettes": [],
            "modules": [],
            "labware": [],
            "labwareOffsets": list(wanted.get("labwareOffsets", ())) if self.takes_offsets else [],
            "runTimeParameters": wanted.get("runTimeParameterValues", {}),
            "protocolId": name,
        }
        return Reply(201, {"data": run})

    def _retire(self) -> None:
        if self.current in self.runs:
            self.runs[self.current]["current"] = False
        self.current = ""

    def _act(self, run: dict[str, Any], action: str) -> Reply:
        status = run["status"]
        if run["id"] != self.current:
            return _make_error(409, "RunStopped", f"Run {run['id']} is not the current run.")
        if status in (*protocol.TERMINAL, "stop-requested", "finishing"):
            return _make_error(409, "RunActionNotAllowed", "The run has already stopped.")
        if action == "play" and self.door_is_open:
            return _make_error(409, "RunActionNotAllowed", "Front door or top window is currently open.")
        if action == "pause" and status != "running":
            return _make_error(409, "RunActionNotAllowed", "Cannot pause a run that is not running.")
        recovering = status in ("awaiting-recovery", "awaiting-recovery-paused")
        if recovering != (action == "resume-from-recovery") and action != "stop":
            return _make_error(409, "RunActionNotAllowed", f"Cannot {action} a run that is {status}.")
        if action not in ("play", "pause", "stop", "resume-from-recovery"):
            return _make_error(422, "InvalidRequest", f"{action} is not an action.")
        entry = {"id": self._make_name("action"), "createdAt": self._format_time(), "actionType": action}
        run["actions"].append(entry)
        if action == "stop":
            run["status"] = "stop-requested"
            self.forget_plans()
            self.after(HOME_S, lambda: self._end(run, protocol.STOPPED))
        elif action == "pause":
            run["status"] = "paused"  # the command in progress is completed first
        elif status == protocol.IDLE:
            run |= {"status": "running", "startedAt": self._format_time()}
            self._begin(run)
        else:
            run["status"] = "running"
            self._go_on(run)
        return Reply(201, {"data": entry})

    def open_door(self) -> None:
        """Open the front door. Its switch is enabled, so a run that is running waits."""
        self.door_is_open = True
        for run in self.runs.values():
            if run["status"] == "running":
                run["status"] = "blocked-by-open-door"

    def shut_door(self) -> None:
        self.door_is_open = False
        for run in self.runs.values():
            if run["status"] == "blocked-by-open-door":
                run["status"] = "paused"

    # -- motions -----------------------------------------------------------------------------

    def _home(self) -> Reply:
        if self.moving:
            return Reply(403, {"message": "A run is under way", "errorCode": "4000"})
        return Reply(200, {"message": "Homing robot"})

    def _begin(self, run: dict[str, Any]) -> None:
        self.moving = True
        self.world.enter(self.name, self.name)
        self.shut(*self.drawers)
        self._at[run["id"]] = 0
        self._next_ends = False
        if self._software is not None:
            self._played = self._software.run(*self._files[run["protocolId"]])
            self._running[self._played] = lambda ran: self._ran.update({run["id"]: ran})
        self._go_on(run)

    def forget_plans(self) -> None:
        """Also end the software of the played run: a run that is stopped or crashes does not continue."""
        super().forget_plans()
        if self._played is not None and self._running.pop(self._played, None) is not None:
            self._played.kill()

    def _go_on(self, run: dict[str, Any]) -> None:
        if not self._next_ends:
            self._next_ends = True
            self.after(RUN_S / len(COMMANDS), lambda: self._command_ends(run))

    def _command_ends(self, run: dict[str, Any]) -> None:
        self._next_ends = False
        number = self._at[run["id"]]
        if self.fails_with:
            detail, self.fails_with = self.fails_with, ""
            self._fail(run, "2001", "MotionFailedError", detail)
            return
        if self.needs_person:
            self.needs_person = False
            run["status"] = "awaiting-recovery"
            return
        if number == WORKS_AT and self._played in self._running:
            self._next_ends = True
            self.after(LOOK_S * self._pace, lambda: self._command_ends(run), exact=True)
            return
        if number == WORKS_AT:
            ran = self._ran.pop(run["id"], None)
            if ran is not None and ran.errors:
                self._break_off(run, ran.errors)
                return
            self._work(run, ran)
        self._at[run["id"]] = number + 1
        if number + 1 == len(COMMANDS):
            run["status"] = "finishing"
            self.after(HOME_S, lambda: self._end(run, protocol.SUCCEEDED))
        elif run["status"] == "running":
            self._go_on(run)

    def _work(self, run: dict[str, Any], ran: ProtocolOutput | None) -> None:
        """Record the work on the plates that receive liquid; on every plate if these are not known. Volumes
        and wells are those among the protocol's values."""
        plain, values = _split_values(self._files[run["protocolId"]][1])
        volumes = {
            key.removesuffix("_volumes"): doses
            for key, doses in values.items()
            if key.endswith("_volumes") and key != "source_volumes"
        }
        drawn = dict(zip(values.get("source_wells") or [], values.get("source_volumes") or [], strict=False))
        wells = values.get("destination_wells") or []
        reached = self._find_reached_plates(ran)
        for slot in reached:
            self.crash_if_sealed(slot, "drives its tips into a seal")
            self.crash_if_lidded(slot, "drives its tips into a lid")
        for liquid, doses in volumes.items():
            if self.world.find_level(self.name, liquid) is not None:
                self.world.use(self.name, liquid, sum(doses))
        if wells:
            self.world.use(self.name, "tips", min(len(wells), COLUMN))
        digest = hashlib.sha256(plain).hexdigest()
        for slot, received in reached.items():
            facts = {} if ran is None else {"received": received, "tips": ran.tips}
            if ran is None or received:
                self.world.work(
                    self.name,
                    "pipette",
                    slot,
                    protocol=digest,
                    volumes=volumes,
                    wells=wells,
                    drawn=drawn,
                    **facts,
                )

    def _find_reached_plates(self, ran: ProtocolOutput | None) -> dict[str, dict[str, float]]:
        """The plates that the tips reach, by station, with the volume that each well received (µL)."""
        full = [slot for slot in self.drawers if self.world.at(self.place(slot))]
        if ran is None:
            if not full:
                self.world.crash(self.name, self.place(self.drawers[0]), "pipettes into nothing")
            return {self.place(slot): {} for slot in full}
        # Slots without a plate of the lab have labware that is never moved: tips, reservoirs, waste.
        reached = {
            self.place(slot): {well: volume for well, volume in change.items() if volume > 0}
            for number, change in ran.sum_changes().items()
            for slot in full
            if re.fullmatch(rf"deck{number}(_.*)?", slot)
        }
        targets = [
            number
            for number, change in ran.sum_changes().items()
            if max(change.values()) > 0 and f"deck{number}" in self.drawers
        ]
        if targets and not any(reached.values()):
            self.world.crash(self.name, self.place(f"deck{targets[0]}"), "pipettes into nothing")
        return reached

    def _end(self, run: dict[str, Any], status: str) -> None:
        run |= {"status": status, "completedAt": self._format_time()}
        self.moving = False
        self.open(*self.drawers)
        self.world.leave(self.name)

    def _fail(self, run: dict[str, Any], code: str, kind: str, detail: str) -> None:
        inner = {"errorType": kind, "errorCode": code, "detail": detail, "wrappedErrors": []}
        outer = {"errorType": "ExceptionInProtocolError", "errorCode": "4000", "detail": "line 1"}
        self._break_off(run, ({**outer, "wrappedErrors": [inner]},))

    def _break_off(self, run: dict[str, Any], errors: tuple[dict[str, Any], ...]) -> None:
        run |= {"errors": list(errors), "status": "finishing"}
        self.after(HOME_S, lambda: self._end(run, protocol.FAILED))

    def damage(self, crash: Crash) -> None:
        if self.current:
            self.forget_plans()
            self._fail(self.runs[self.current], "2003", "StallOrCollisionDetectedError", str(crash))

    # -- parts of answers --------------------------------------------------------------------

    def _list_commands(self, run: dict[str, Any]) -> list[dict[str, Any]]:
        at = self._at.get(run["id"], 0)
        return [
            {"id": f"{run['id']}-{number}", "commandType": kind, "params": {}, "intent": "protocol"}
            | {"status": "succeeded" if number < at else "running" if number == at else "queued"}
            for number, kind in enumerate(COMMANDS)
        ]

    def _make_name(self, kind: str) -> str:
        self._disk.number += 1
        return f"{kind}-{self._disk.number}"

    def _format_time(self) -> str:
        return (BEGAN + timedelta(seconds=self.now_s())).isoformat()


_HEALTH = {
    "robot_model": "OT-2 Standard",
    "api_version": "8.1.0",
    "fw_version": "v1.1.0-25e5cea",
    "board_revision": "2.1",
    "system_version": "v1.20.0",
    "maximum_protocol_api_version": [2, 20],
    "minimum_protocol_api_version": [2, 0],
}


def _make_error(status: int, name: str, detail: str) -> Reply:
    return Reply(status, {"errors": [{"id": name, "title": name, "detail": detail, "errorCode": "4000"}]})


def _parse_files(request: Request) -> list[tuple[str, bytes]]:
    head = f"Content-Type: {request.headers.get('content-type', '')}\r\n\r\n".encode()
    message = BytesParser(policy=policy.HTTP).parsebytes(head + request.body)
    return [
        (part.get_filename() or "", bytes(part.get_payload(decode=True) or b""))
        for part in message.iter_parts()
        if part.get_param("name", header="content-disposition") == "files"
    ]


def _analyse(name: str, content: bytes) -> dict[str, Any]:
    """The analysis of a file; it checks only that the file can be parsed."""
    try:
        json.loads(content) if name.endswith(".json") else compile(content, name, "exec")
    except (SyntaxError, ValueError) as error:
        wrong = {"errorType": "ProtocolError", "errorCode": "4000", "detail": str(error), "wrappedErrors": []}
        return _make_analysis((wrong,))
    return _make_analysis(())


def _make_analysis(errors: tuple[dict[str, Any], ...]) -> dict[str, Any]:
    return {"status": "completed", "result": "not-ok" if errors else "ok", "errors": list(errors)}


def _split_values(content: bytes) -> tuple[bytes, dict[str, Any]]:
    """The protocol as it was written, and the values that were added to it; empty if there are none."""
    plain, mark, values = content.rpartition(protocol.MARK)
    return (plain, ast.literal_eval(values.decode())) if mark else (content, {})

"""A simulated MiR behind its REST interface: a map, missions, a queue, and a base that drives."""

from __future__ import annotations

from math import dist
from typing import Any

from labos.node import Crash, Setup
from labos_drivers._onhttp import HttpEnd, OnHttp, Reply, Request
from labos_drivers.mir import protocol

TEXTS = {
    protocol.READY: "Ready",
    protocol.PAUSE: "Pause",
    protocol.EXECUTING: "Executing",
    protocol.EMERGENCY_STOP: "EmergencyStop",
    protocol.MANUAL: "ManualControl",
    protocol.ERROR: "Error",
}
MAP, SPEED_M_S, DOCKING_S = "map-1", 0.5, 30.0
POSITIONS = {"charger": (0.0, 0.0), "bench1": (10.0, 4.0), "bench2": (22.0, 4.0), "bio_dock": (30.0, -6.0)}


class MiROnWire(OnHttp):
    """The simulated robot. ``positions`` in its configuration are those of its map. ``is_blocked``: an
    obstacle is in its way."""

    drawers = ("deck",)

    serial = "200100005001715"

    def __init__(
        self, setup: Setup, end: HttpEnd | None = None, *, user: str = "", password: str = ""
    ) -> None:
        super().__init__(setup, end)
        configured = setup.config.get("positions") or POSITIONS
        self.positions = {str(name): (float(x), float(y)) for name, (x, y) in configured.items()}
        drives = [motion for motion in self.world.motions("drive") if motion.device == self.name]
        last = drives[-1].facts["target"] if drives else next(iter(self.positions))
        self.at = self.positions[last]
        self.is_blocked = False
        self._path: tuple[tuple[float, float], tuple[float, float], float, float] | None = None
        self.state = protocol.READY
        self.errors: list[dict[str, Any]] = []
        self.queue: list[dict[str, Any]] = []
        self.missions: dict[str, dict[str, Any]] = {}
        self._key = protocol.make_authorization(user, password)

    # -- receiving ---------------------------------------------------------------------------

    def answer(self, request: Request) -> Reply:
        if request.headers.get("authorization") != self._key:
            return _refuse(401, "Authentication required")
        try:
            return self._route(request, *request.parts[2:])
        except (KeyError, ValueError, TypeError):
            return _refuse(400, "Argument error")

    def _route(self, request: Request, *parts: str) -> Reply:
        match request.method, *parts:
            case "GET", "status":
                return Reply(200, self._make_status())
            case "PUT", "status":
                return self._put(request.json())
            case "GET", "maps", _, "positions":
                return Reply(200, [{"guid": f"p-{name}", "name": name} for name in self.positions])
            case "GET", "positions", guid if guid.removeprefix("p-") in self.positions:
                x, y = self.positions[guid.removeprefix("p-")]
                name = guid.removeprefix("p-")
                return Reply(200, {"guid": guid, "name": name, "pos_x": x, "pos_y": y, "orientation": 0.0})
            case "GET", "mission_groups":
                return Reply(200, [{"guid": "group-1", "name": "Missions"}])
            case "POST", "missions":
                body = request.json()
                guid = f"mission-{len(self.missions) + 1}"
                self.missions[guid] = {"guid": guid, "name": body["name"], "actions": []}
                return Reply(201, {"guid": guid, "name": body["name"]})
            case "POST", "missions", "search":
                return Reply(200, _search(request, self.missions.values()))
            case "GET", "missions", guid, "actions" if guid in self.missions:
                return Reply(200, self.missions[guid]["actions"])
            case "POST", "missions", guid, "actions" if guid in self.missions:
                self.missions[guid]["actions"].append(request.json())
                return Reply(201, request.json())
            case "POST", "mission_queue":
                return self._add(request.json())
            case "POST", "mission_queue", "search":
                return Reply(200, _search(request, self.queue))
            case method, "mission_queue", number if number.isdecimal() and 0 < int(number) <= len(self.queue):
                entry = self.queue[int(number) - 1]
                if method == "DELETE":
                    self._abort(entry)
                    return Reply(204, b"")
                return Reply(200, entry)
        return _refuse(404, "Not found")

    def _put(self, body: dict[str, Any]) -> Reply:
        if body.get("clear_error"):
            self.errors.clear()
            if self.state == protocol.ERROR:
                self.state = protocol.PAUSE
        if "state_id" in body and self.state not in (protocol.EMERGENCY_STOP, protocol.MANUAL):
            if body["state_id"] not in (protocol.READY, protocol.PAUSE):
                return _refuse(400, "Only 3 and 4 can be set")
            if self.state == protocol.EXECUTING:
                self._halt()
            self.state = body["state_id"]
            if self.state == protocol.READY:
                self._start_next()
        return Reply(200, self._make_status())

    # -- carrying requests out ---------------------------------------------------------------

    def _add(self, body: dict[str, Any]) -> Reply:
        if body["mission_id"] not in self.missions:
            return _refuse(400, "There is no such mission")
        entry = {
            "id": len(self.queue) + 1,
            "state": "Pending",
            "mission_id": body["mission_id"],
            "message": body.get("message", ""),
        }
        self.queue.append(entry)
        self.after(1, self._start_next)
        return Reply(201, entry)

    def _start_next(self) -> None:
        """Begin or continue the oldest entry of the queue that has not ended."""
        if self.state != protocol.READY or self.errors:
            return
        entry = next((e for e in self.queue if e["state"] in ("Executing", "Pending")), None)
        if entry is None:
            return
        action = self.missions[entry["mission_id"]]["actions"][0]
        values = {parameter["id"]: parameter["value"] for parameter in action["parameters"]}
        name = str(values.get("position") or values.get("marker")).removeprefix("p-")
        self.state, entry["state"] = protocol.EXECUTING, "Executing"
        self.world.enter(self.name, self.name)
        self.shut(*self.drawers)
        takes_s = dist(self.at, self.positions[name]) / SPEED_M_S + 2
        if action["action_type"] == "docking":
            takes_s += DOCKING_S
        self._path = path = self.at, self.positions[name], self.now_s(), takes_s
        if self.is_blocked:
            self.after(0.5 * takes_s, lambda: self.fail("no path to the goal"))
        self.after(takes_s, lambda: self._arrive(entry, name, path))

    def _arrive(self, entry: dict[str, Any], name: str, path: Any) -> None:
        if self._path is not path:
            return  # the robot stopped before it arrived
        self.at, self._path = self.positions[name], None
        self.world.work(self.name, "drive", target=name)
        entry["state"] = protocol.DONE
        self._come_to_rest(protocol.READY)
        self._start_next()

    def _halt(self) -> None:
        """Stop the robot at its present position."""
        self.at, self._path = self._compute_position(), None

    def _compute_position(self) -> tuple[float, float]:
        if self._path is None:
            return self.at
        (x, y), (to_x, to_y), began_s, takes_s = self._path
        part = min((self.now_s() - began_s) / takes_s, 1.0)
        return x + part * (to_x - x), y + part * (to_y - y)

    def _abort(self, entry: dict[str, Any]) -> None:
        was, entry["state"] = entry["state"], protocol.ABORTED
        if was == protocol.DONE:
            entry["state"] = was
        elif was == "Executing":
            self._halt()
            self._come_to_rest(protocol.READY if self.state == protocol.EXECUTING else self.state)

    def _come_to_rest(self, state: int) -> None:
        self.state = state
        self.open(*self.drawers)
        self.world.leave(self.name)

    def press_stop(self) -> None:
        """A person presses the emergency stop."""
        self._halt()
        self.state = protocol.EMERGENCY_STOP

    def fail(self, why: str) -> None:
        """Stop the robot, and report an error with the description ``why``."""
        self._halt()
        self.state = protocol.ERROR
        self.errors.append({"code": 101, "module": "Planner", "description": why})

    def damage(self, crash: Crash) -> None:
        self.fail(str(crash))

    def _make_status(self) -> dict[str, Any]:
        return {
            "robot_name": self.name,
            "robot_model": "MiR250",
            "serial_number": self.serial,
            "state_id": self.state,
            "state_text": TEXTS.get(self.state, "Docking"),
            "mission_queue_id": next((e["id"] for e in self.queue if e["state"] == "Executing"), None),
            "mission_text": "",
            "errors": self.errors,
            "battery_percentage": 80.0,
            "position": dict(zip("xy", self._compute_position(), strict=True)) | {"orientation": 0.0},
            "map_id": MAP,
            "user_prompt": None,
        }


def _search(request: Request, items: Any) -> list[dict[str, Any]]:
    """The items that a search finds. Each filter is taken as a test for equality."""
    filters = request.json()["filters"]
    return [item for item in items if all(item.get(one["fieldname"]) == one["value"] for one in filters)]


def _refuse(status: int, why: str) -> Reply:
    return Reply(status, {"error_code": str(status), "error_human": why})

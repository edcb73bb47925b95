"""The driver of a MiR, by its REST interface."""

from __future__ import annotations

import json
import secrets
import time
from math import hypot, isfinite
from typing import Any

from labos.errors import DeviceError, Garbled, LinkError, NotConnected, OutcomeUnknown
from labos.link import HttpLink, HttpReply
from labos.node import Setup
from labos.node.node import note_handle
from labos.node.secrets import read_secret
from labos_drivers._wired import DeviceOnWire, Wired, during_motion, off_loop
from labos_drivers.mir import protocol

ANSWER_S, DRIVE_S, LOST_S, POLL_S = 10.0, 900.0, 60.0, 1.0
NEAR_M = 0.5
"""As far from a position as this it is still said to be there."""
WHO = "a MiR"
ENDED = {
    protocol.EMERGENCY_STOP: "its emergency stop is pressed",
    protocol.ERROR: "it is in error",
}


class MiRDriver(Wired):
    """The driver of a MiR. Each journey is an entry in the robot's queue, with a name by which the driver
    finds it again. The driver watches only this entry, because others may also use the queue."""

    deadlines = ("answer", "drive", "lost")
    where = ("url", "http://192.168.12.20")
    link: HttpLink

    def __init__(self, setup: Setup, address: str, simulator: DeviceOnWire | None = None) -> None:
        super().__init__(setup, address, simulator)
        user = str(setup.config.get("user", ""))
        password = read_secret(setup.config, "password")
        self._entry = 0
        self.link = HttpLink(
            address.rstrip("/") + protocol.BASE,
            name=setup.name,
            headers={
                "Authorization": protocol.make_authorization(user, password),
                "Accept-Language": "en_US",
            },
            identify=lambda _: self._recognise(),
            expected=WHO,
        )

    @property
    def _answer_s(self) -> float:
        return self.limit_s("answer", ANSWER_S)

    async def move(self, target: str) -> None:
        await self._go("move", target)

    async def dock(self, target: str) -> None:
        await self._go("docking", target)

    @off_loop
    def follow(self, name: str) -> None:
        """Wait for the end of the journey that was queued with this name. Raises DeviceError, and
        OutcomeUnknown if the robot does not know the journey."""
        with self.motion():
            entry = self._find_entry(name)
            if entry is None:
                raise OutcomeUnknown(f"{self.name}: the robot has no mission {name}.")
            self._await_end(entry)

    @off_loop
    def reset(self) -> None:
        """Clear an error and a pause. Before this, an interrupted journey of the driver is removed from the
        queue: otherwise the robot would continue it by itself. Raises DeviceError."""
        self.resume()
        self._give_up()
        self._ask("PUT", "/status", {"clear_error": True})
        self._set_state(protocol.READY)
        status = self._read_status()
        if status["state_id"] not in (protocol.READY, protocol.EXECUTING):
            raise self.make_refusal(
                f"it is not ready, but {status.get('state_text')}",
                "Release its emergency stop and turn its key to automatic, then reset the module.",
            )

    @during_motion
    def stop(self) -> None:
        """Stop the robot, and remove the driver's journey from its queue."""
        self._halted.set()
        self._set_state(protocol.PAUSE)
        self._give_up()

    @during_motion
    def is_idle(self) -> bool:
        return bool(self._read_status()["state_id"] in protocol.AT_REST)

    @during_motion
    def observe(self) -> dict[str, Any]:
        """The position on its map at which the robot stands; empty if none is near."""
        status = self._read_status()
        near = {
            self._measure_distance(status, position): str(position.get("name"))
            for position in self._list_positions(status)
            if "pos_x" in position
        }
        closest = min(near, default=NEAR_M)
        return {"position": near[closest] if closest < NEAR_M else ""}

    # -- one journey -------------------------------------------------------------------------

    async def _go(self, kind: str, target: str) -> None:
        name = f"labos-{secrets.token_hex(8)}"
        await note_handle(name)
        await self._drive(kind, target, name)

    @off_loop
    def _drive(self, kind: str, target: str, name: str) -> None:
        with self.motion():
            with self.report_no_effects():
                status = self._read_status()
                self._refuse_unless_ready(status)
                position = next((p for p in self._list_positions(status) if p.get("name") == target), None)
                if position is None:
                    raise DeviceError(
                        f"{self.name}: there is no position {target!r} on its map.",
                        remedy="Use the name of a position on the robot's own map.",
                    )
                mission = self._find_mission(kind, str(position["guid"]))
                self.check_not_stopped()
            self._await_end(self._queue(mission, name))
            if kind == "move":
                with self.assume_motion():
                    self._refuse_elsewhere(position)

    def _refuse_elsewhere(self, position: dict[str, Any]) -> None:
        """Raises DeviceError if the robot is not at the position. A robot that drives again is not checked:
        it has completed this journey, and now carries out a mission of another user."""
        status = self._retry(self._read_status)
        if (
            status["state_id"] != protocol.EXECUTING
            and self._measure_distance(status, self._read_position(position)) > NEAR_M
        ):
            raise DeviceError(
                f"{self.name}: the mission is done, but the robot is not at {position.get('name')}.",
                remedy="Check where it is, and whether its own position is right.",
            )

    def _queue(self, mission: str, name: str) -> int:
        body = {"mission_id": mission, "priority": 0, "message": name}
        try:
            return int(self._ask("POST", "/mission_queue", body)["id"])
        except LinkError as error:
            if error.effects == "none":
                raise
            with self.assume_motion():
                entry = self._retry(lambda: self._find_entry(name))
            if entry is None:
                raise
            return int(entry)

    def _await_end(self, entry: int) -> None:
        self._entry = entry
        limit_s = self.limit_s("drive", DRIVE_S)
        deadline = time.monotonic() + limit_s
        with self.assume_motion():
            while True:
                if self._halted.is_set():
                    self._give_up()  # the entry may have been queued just after the stop
                answer = self._retry(lambda: self._ask("GET", f"/mission_queue/{entry}"))
                state = answer.get("state")
                if state == protocol.DONE:
                    break
                if state == protocol.ABORTED:
                    raise DeviceError(
                        f"{self.name}: the mission was aborted. {answer.get('message') or ''}".strip(),
                        remedy="Check where it is, then reset the module.",
                    )
                status = self._retry(self._read_status)
                if status["state_id"] in ENDED:
                    raise DeviceError(
                        f"{self.name}: {ENDED[status['state_id']]}{_describe_errors(status)}.",
                        remedy="Check the robot, then reset the module.",
                    )
                if time.monotonic() > deadline:
                    raise DeviceError(
                        f"{self.name}: it has not arrived within {limit_s:g} s "
                        f"({status.get('state_text')}: {status.get('mission_text')}).",
                        remedy="Check what it waits for; it may have a question for a person.",
                    )
                time.sleep(POLL_S)
        self._entry = 0

    def _give_up(self) -> None:
        """Remove the driver's entry from the queue, if there is one. Raises DeviceError."""
        if entry := self._entry:
            reply = self.link.exchange("DELETE", f"/mission_queue/{entry}", timeout_s=self._answer_s)
            if reply.status != 404:
                self._parse_data(reply)
            self._entry = 0

    def _find_entry(self, name: str) -> int | None:
        """The id of the queue entry with this name as its message; None if there is none."""
        wanted = {"filters": [{"fieldname": "message", "operator": "=", "value": name}]}
        found = self._ask_list("POST", "/mission_queue/search", wanted)
        return int(found[-1]["id"]) if found else None

    def _find_mission(self, kind: str, position: str) -> str:
        """The guid of the mission for a position. It is made only once, because the robot keeps all missions.
        If making it was interrupted, the mission has no step yet, and gets it now."""
        name = f"labos {kind} {position}"
        wanted = {"filters": [{"fieldname": "name", "operator": "=", "value": name}]}
        found = self._ask_list("POST", "/missions/search", wanted)
        guid = str((found[0] if found else self._make_mission(name))["guid"])
        steps = f"/missions/{guid}/actions"
        if not self._ask_list("GET", steps):
            self._ask("POST", steps, protocol.make_steps(kind, position))
        return guid

    def _make_mission(self, name: str) -> Any:
        groups = self._ask("GET", "/mission_groups")
        body = {"name": name, "description": "", "group_id": groups[0]["guid"]}
        return self._ask("POST", "/missions", body)

    def _retry(self, ask: Any) -> Any:
        """The answer of a robot that may be unreachable for a while, for example between access points. It is
        asked again for ``LOST_S``."""
        return self.ask_again(ask, self.limit_s("lost", LOST_S), POLL_S)

    # -- requests and answers ----------------------------------------------------------------

    def _read_status(self) -> dict[str, Any]:
        status = self._ask("GET", "/status")
        if not isinstance(status, dict) or not isinstance(status.get("state_id"), int):
            raise Garbled(f"{self.name}: the answer does not contain the robot's state.")
        return status

    def _set_state(self, state: int) -> None:
        self._ask("PUT", "/status", {"state_id": state})

    def _list_positions(self, status: dict[str, Any]) -> list[dict[str, Any]]:
        found = self._ask_list("GET", f"/maps/{status.get('map_id')}/positions")
        return [self._read_position(position) for position in found]

    def _read_position(self, position: dict[str, Any]) -> dict[str, Any]:
        if "pos_x" in position:
            return position
        return dict(self._ask("GET", f"/positions/{position['guid']}"))

    def _measure_distance(self, status: dict[str, Any], position: dict[str, Any]) -> float:
        here = status.get("position") or {}
        unclear = Garbled(f"{self.name}: the answer does not contain the robot's position.")
        try:
            away = hypot(here["x"] - position["pos_x"], here["y"] - position["pos_y"])
        except (KeyError, TypeError) as error:
            raise unclear from error
        if not isfinite(away):
            raise unclear
        return away

    def _refuse_unless_ready(self, status: dict[str, Any]) -> None:
        if not isinstance(status.get("errors"), list):
            raise Garbled(f"{self.name}: the answer does not contain the robot's errors.")
        if status["state_id"] != protocol.READY or status["errors"]:
            raise DeviceError(
                f"{self.name}: it is not ready, but {status.get('state_text')}{_describe_errors(status)}.",
                remedy="Check the robot, then reset the module.",
            )

    def _ask(self, method: str, path: str, body: Any = None) -> Any:
        """The data of the answer. Raises DeviceError."""
        return self._parse_data(self.link.exchange(method, path, json=body, timeout_s=self._answer_s))

    def _parse_data(self, reply: HttpReply) -> Any:
        """The data of a reply. Raises DeviceError if the robot refuses. Raises Garbled if a reply with
        success is not JSON, or if the server failed: it may have carried out the request."""
        if reply.ok:
            return reply.json() if reply.body else {}
        if reply.status >= 500:
            raise Garbled(f"{self.name}: the robot's server fails: status {reply.status}.")
        try:
            why = json.loads(reply.body)["error_human"]
        except (ValueError, KeyError, TypeError):
            why = f"status {reply.status}"
        raise self.make_refusal(f"the robot refuses: {why}", "Check the robot.")

    def _ask_list(self, method: str, path: str, body: Any = None) -> list[Any]:
        """The data of an answer that is a list. Only an empty list means that there is nothing. Raises
        DeviceError, and Garbled for anything but a list."""
        reply = self.link.exchange(method, path, json=body, timeout_s=self._answer_s)
        data = self._parse_data(reply)
        if not isinstance(data, list):
            raise Garbled(f"{self.name}: {reply.body[:80]!r} is not a list.")
        return data

    def _recognise(self) -> str:
        reply = self.link.get("/status", timeout_s=self._answer_s)
        if reply.status == 401:
            raise NotConnected(
                f"{self.name}: the robot does not know this user and password.",
                remedy="Check `user:` and `password_env:` (or `password_file:`) of the module.",
            )
        status = reply.json()
        model = str(status.get("robot_model", "")) if isinstance(status, dict) else ""
        if not model.startswith("MiR"):
            return f"what answers {reply.body[:40]!r}"
        self.check_unit(status.get("serial_number"))
        return WHO


def _describe_errors(status: dict[str, Any]) -> str:
    """The errors that the robot reports, in brackets; empty if there are none."""
    reasons = [
        str(error.get("description")) for error in status.get("errors") or () if isinstance(error, dict)
    ]
    return f" ({'; '.join(reasons)})" if reasons else ""

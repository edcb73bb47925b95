"""Drives a real MiR through its REST interface."""

from __future__ import annotations

import json
import secrets
import time
from math import hypot, isfinite
from typing import Any

from labos.errors import DeviceError, Garbled, LinkError, NotConnected, OutcomeUnknown, WrongDevice
from labos.link import HttpLink, HttpReply
from labos.node import Setup
from labos.node.node import handle_keeper
from labos.node.secrets import secret_of
from labos_drivers._wired import Behind, Wired, aside, off_loop
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
    """Each journey is an entry in the robot's queue that bears a name of ours, under which it is found
    again; only that entry is watched, for others may use the queue too."""

    deadlines = ("answer", "drive", "lost")
    where = ("url", "http://192.168.12.20")
    link: HttpLink

    def __init__(self, setup: Setup, address: str, simulator: Behind | None = None) -> None:
        super().__init__(setup, address, simulator)
        user = str(setup.config.get("user", ""))
        password = secret_of(setup.config, "password")
        self._entry = 0
        self.link = HttpLink(
            address.rstrip("/") + protocol.BASE,
            name=setup.name,
            headers={
                "Authorization": protocol.authorization(user, password),
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
        """The end of the journey that was queued under this name. Raises OutcomeUnknown if the robot
        does not know it."""
        with self.motion():
            entry = self._find(name)
            if entry is None:
                raise OutcomeUnknown(f"{self.name}: the robot has no mission {name}.")
            self._see_through(entry)

    @off_loop
    def reset(self) -> None:
        """Clears an error and a pause. A journey of ours that was broken off is given up before, or the robot
        would go on with it by itself."""
        self.resume()
        self._give_up()
        self._data(self.link.exchange("PUT", "/status", json={"clear_error": True}, timeout_s=self._answer_s))
        self._set(protocol.READY)
        status = self._status()
        if status["state_id"] not in (protocol.READY, protocol.EXECUTING):
            raise DeviceError(
                f"{self.name}: it is not ready, but {status.get('state_text')}.",
                effects="none",
                remedy="Release its emergency stop and turn its key to automatic, then reset the module.",
            )

    @aside
    def stop(self) -> None:
        """It stands still, and gives its journey up."""
        self._halted.set()
        self._set(protocol.PAUSE)
        self._give_up()

    @aside
    def is_idle(self) -> bool:
        return bool(self._status()["state_id"] in protocol.AT_REST)

    @aside
    def look(self) -> dict[str, Any]:
        """Which position of its map it stands at; empty if none is near."""
        status = self._status()
        near = {
            self._away(status, position): str(position.get("name"))
            for position in self._positions(status)
            if "pos_x" in position
        }
        closest = min(near, default=NEAR_M)
        return {"position": near[closest] if closest < NEAR_M else ""}

    # -- one journey -------------------------------------------------------------------------

    async def _go(self, kind: str, target: str) -> None:
        name = f"labos-{secrets.token_hex(8)}"
        keep = handle_keeper.get()
        if keep is not None:
            await keep(name)
        await self._drive(kind, target, name)

    @off_loop
    def _drive(self, kind: str, target: str, name: str) -> None:
        with self.motion():
            with self.at_rest():
                status = self._status()
                self._refuse_unless_ready(status)
                position = next((p for p in self._positions(status) if p.get("name") == target), None)
                if position is None:
                    raise DeviceError(
                        f"{self.name}: there is no position {target!r} on its map.",
                        remedy="Name a position as the robot's own map has it.",
                    )
                mission = self._mission(kind, str(position["guid"]))
                self.unless_stopped()
            self._see_through(self._queue(mission, name))
            if kind == "move":
                with self.under_way():
                    self._refuse_elsewhere(position)

    def _refuse_elsewhere(self, position: dict[str, Any]) -> None:
        """Raises DeviceError if it rests elsewhere. One that drives again has been there, and is under way
        for somebody else by now."""
        status = self._again(self._status)
        if status["state_id"] != protocol.EXECUTING and self._away(status, self._detail(position)) > NEAR_M:
            raise DeviceError(
                f"{self.name}: the mission is done, but the robot is not at {position.get('name')}.",
                remedy="Look where it is, and whether it knows.",
            )

    def _queue(self, mission: str, name: str) -> int:
        body = {"mission_id": mission, "priority": 0, "message": name}
        try:
            return int(
                self._data(self.link.post("/mission_queue", json=body, timeout_s=self._answer_s))["id"]
            )
        except LinkError as error:
            if error.effects == "none":
                raise
            with self.under_way():
                entry = self._again(lambda: self._find(name))
            if entry is None:
                raise
            return int(entry)

    def _see_through(self, entry: int) -> None:
        self._entry = entry
        limit_s = self.limit_s("drive", DRIVE_S)
        deadline = time.monotonic() + limit_s
        with self.under_way():
            while True:
                if self._halted.is_set():
                    self._give_up()  # it may have been queued just after the stop
                told = self._again(
                    lambda: self._data(self.link.get(f"/mission_queue/{entry}", timeout_s=self._answer_s))
                )
                state = told.get("state")
                if state == protocol.DONE:
                    break
                if state == protocol.ABORTED:
                    raise DeviceError(
                        f"{self.name}: the mission was aborted. {told.get('message') or ''}".strip(),
                        remedy="Look where it is, then reset the module.",
                    )
                status = self._again(self._status)
                if status["state_id"] in ENDED:
                    raise DeviceError(
                        f"{self.name}: {ENDED[status['state_id']]}{_errors(status)}.",
                        remedy="Look at the robot, then reset the module.",
                    )
                if time.monotonic() > deadline:
                    raise DeviceError(
                        f"{self.name}: it has not arrived within {limit_s:g} s "
                        f"({status.get('state_text')}: {status.get('mission_text')}).",
                        remedy="Look what it waits for; it may ask a person something.",
                    )
                time.sleep(POLL_S)
        self._entry = 0

    def _give_up(self) -> None:
        """Our entry leaves the queue, if there is one."""
        if entry := self._entry:
            reply = self.link.exchange("DELETE", f"/mission_queue/{entry}", timeout_s=self._answer_s)
            if reply.status != 404:
                self._data(reply)
            self._entry = 0

    def _find(self, name: str) -> int | None:
        """The entry of the queue with this message."""
        wanted = {"filters": [{"fieldname": "message", "operator": "=", "value": name}]}
        found = self._list(self.link.post("/mission_queue/search", json=wanted, timeout_s=self._answer_s))
        return int(found[-1]["id"]) if found else None

    def _mission(self, kind: str, position: str) -> str:
        """One mission for each position, made once: the robot keeps all that are ever made. One that was
        broken off while it was made has no step yet."""
        name = f"labos {kind} {position}"
        wanted = {"filters": [{"fieldname": "name", "operator": "=", "value": name}]}
        found = self._list(self.link.post("/missions/search", json=wanted, timeout_s=self._answer_s))
        guid = str((found[0] if found else self._new_mission(name))["guid"])
        steps = f"/missions/{guid}/actions"
        if not self._list(self.link.get(steps, timeout_s=self._answer_s)):
            self._data(self.link.post(steps, json=protocol.steps(kind, position), timeout_s=self._answer_s))
        return guid

    def _new_mission(self, name: str) -> Any:
        groups = self._data(self.link.get("/mission_groups", timeout_s=self._answer_s))
        body = {"name": name, "description": "", "group_id": groups[0]["guid"]}
        return self._data(self.link.post("/missions", json=body, timeout_s=self._answer_s))

    def _again(self, ask: Any) -> Any:
        """A robot that is out of reach for a while, as between two access points, is asked again."""
        deadline = time.monotonic() + self.limit_s("lost", LOST_S)
        while True:
            try:
                return ask()
            except WrongDevice:
                raise
            except LinkError:
                if time.monotonic() > deadline:
                    raise
            time.sleep(POLL_S)

    # -- one answer --------------------------------------------------------------------------

    def _status(self) -> dict[str, Any]:
        status = self._data(self.link.get("/status", timeout_s=self._answer_s))
        if not isinstance(status, dict) or not isinstance(status.get("state_id"), int):
            raise Garbled(f"{self.name}: the answer does not tell the robot's state.")
        return status

    def _set(self, state: int) -> None:
        self._data(self.link.exchange("PUT", "/status", json={"state_id": state}, timeout_s=self._answer_s))

    def _positions(self, status: dict[str, Any]) -> list[dict[str, Any]]:
        found = self._list(self.link.get(f"/maps/{status.get('map_id')}/positions", timeout_s=self._answer_s))
        return [self._detail(position) if "pos_x" not in position else position for position in found]

    def _detail(self, position: dict[str, Any]) -> dict[str, Any]:
        if "pos_x" in position:
            return position
        return dict(self._data(self.link.get(f"/positions/{position['guid']}", timeout_s=self._answer_s)))

    def _away(self, status: dict[str, Any], position: dict[str, Any]) -> float:
        here = status.get("position") or {}
        unclear = Garbled(f"{self.name}: the answer does not tell where the robot is.")
        try:
            away = hypot(here["x"] - position["pos_x"], here["y"] - position["pos_y"])
        except (KeyError, TypeError) as error:
            raise unclear from error
        if not isfinite(away):
            raise unclear
        return away

    def _refuse_unless_ready(self, status: dict[str, Any]) -> None:
        if not isinstance(status.get("errors"), list):
            raise Garbled(f"{self.name}: the answer does not tell whether the robot has errors.")
        if status["state_id"] != protocol.READY or status["errors"]:
            raise DeviceError(
                f"{self.name}: it is not ready, but {status.get('state_text')}{_errors(status)}.",
                remedy="Look at the robot, then reset the module.",
            )

    def _data(self, reply: HttpReply) -> Any:
        """Raises DeviceError for a refusal, Garbled for what is no answer of a MiR, and where its server
        failed, which does not tell what came of the question."""
        if reply.ok:
            return reply.json() if reply.body else {}
        if reply.status >= 500:
            raise Garbled(f"{self.name}: the robot's server fails: status {reply.status}.")
        try:
            why = json.loads(reply.body)["error_human"]
        except (ValueError, KeyError, TypeError):
            why = f"status {reply.status}"
        raise DeviceError(
            f"{self.name}: the robot refuses: {why}.", effects="none", remedy="Look at the robot."
        )

    def _list(self, reply: HttpReply) -> list[Any]:
        """Of an answer that is a list: only an empty list says that there is nothing. Raises DeviceError."""
        data = self._data(reply)
        if not isinstance(data, list):
            raise Garbled(f"{self.name}: {reply.body[:80]!r} is no list.")
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
        self.see_unit(status.get("serial_number"))
        return WHO


def _errors(status: dict[str, Any]) -> str:
    """What the robot says is wrong, in brackets."""
    told = [str(error.get("description")) for error in status.get("errors") or () if isinstance(error, dict)]
    return f" ({'; '.join(told)})" if told else ""

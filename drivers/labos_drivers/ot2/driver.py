"""The driver of a real OT-2, which it controls through the robot server."""

from __future__ import annotations

import json
import math
import time
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from labos.errors import DeviceError, Garbled, LinkError, NotConnected, OutcomeUnknown
from labos.link import HttpLink, HttpReply
from labos.node import Setup
from labos_drivers._refusals import make_refusal
from labos_drivers._wired import DeviceOnWire, Wired, during_motion, off_loop
from labos_drivers.ot2 import protocol
from labos_drivers.ot2.deck import read_definitions, read_offsets
from labos_drivers.ot2.translate import translate

ANSWER_S, UPLOAD_S, CREATE_S, ANALYSIS_S, HOME_S = 10.0, 600.0, 60.0, 900.0, 120.0
POLL_S, BEGIN_S, LOST_S = 1.0, 10.0, 60.0
"""How often a run is asked for, how long it may stay idle after its start, and how long the robot may
be out of reach while it runs: it does not need us for that."""
LARGEST = 4 * 1024 * 1024
WHO = "an OT-2"


class OT2Driver(Wired):
    """Before anything moves, a protocol is uploaded and analysed, and a run of it is made. Only ``play``
    starts the motion. The robot gives each run a name; the driver can find the run again by it."""

    deadlines = ("answer", "upload", "create", "analysis", "home", "begin", "lost")
    where = ("url", f"http://192.168.0.20:{protocol.PORT}")
    link: HttpLink

    def __init__(self, setup: Setup, address: str, simulator: DeviceOnWire | None = None) -> None:
        super().__init__(setup, address, simulator)
        self._run = ""
        self.waits_for = ""
        """What the run waits for a person to do; empty while it goes on."""
        self._offsets = read_offsets(setup.name, setup.config)
        self._definitions = read_definitions(setup.name, setup.config)
        self.link = HttpLink(
            address,
            name=setup.name,
            headers=protocol.HEADERS,
            identify=lambda _: self._recognise(),
            expected=WHO,
        )

    @property
    def _answer_s(self) -> float:
        return self.limit_s("answer", ANSWER_S)

    # -- a run -------------------------------------------------------------------------------

    @off_loop
    def prepare(
        self, path: str, values: Mapping[str, Any], parameters: Mapping[str, Any] | None = None
    ) -> str:
        """Upload the protocol, wait for its analysis and make a run; returns the robot's name for the run.
        Nothing moves. ``parameters`` are values for the protocol's own run-time parameters. Raises
        DeviceError."""
        with self.motion(), self.report_no_effects():
            name, content = self._read_protocol(path, values)
            files = [("files", (name, content))]
            if name.endswith(".py"):  # a JSON protocol contains its definitions
                files += [("files", definition) for definition in self._definitions]
            given = {"runTimeParameterValues": dict(parameters)} if parameters else {}
            form = {key: json.dumps(value) for key, value in given.items()}
            upload_s, create_s = self.limit_s("upload", UPLOAD_S), self.limit_s("create", CREATE_S)
            uploaded = self.link.post("/protocols", files=files, form=form, timeout_s=upload_s)
            held = self._parse_id(self._parse_data(uploaded))
            self._await_analysis(held)
            body: dict[str, dict[str, Any]] = {"data": {"protocolId": held, **given}}
            if self._offsets:
                body["data"]["labwareOffsets"] = self._offsets
            made = self._parse_data(self.link.post("/runs", json=body, timeout_s=create_s))
            run = self._parse_id(made)
            self._check_offsets(run, made)
            return run

    @off_loop
    def carry_out(self, run: str) -> dict[str, Any]:
        """Start a run and wait for its end; returns its name and status. Raises DeviceError."""
        with self.motion():
            self._run = run
            try:
                self._play(run)
            except LinkError as error:
                if error.effects == "none" or not self._has_begun(run, error):
                    raise
            return self._await_end(run)

    @off_loop
    def follow(self, run: str) -> dict[str, Any]:
        """Wait for the end of a run that was started before. Raises DeviceError, also if it was never
        started. Raises OutcomeUnknown if the robot no longer knows the run."""
        with self.motion():
            self._run = run
            with self.assume_motion():
                try:
                    begun = not self._take_back(run)
                except _Forgotten as error:
                    raise OutcomeUnknown(error.message) from error
            if not begun:
                raise self.make_refusal(f"the run {run} was never started")
            return self._await_end(run)

    @during_motion
    def resume_run(self) -> None:
        """Continue a run that waits. Raises DeviceError, also if no run can be resumed."""
        run = self._run or self._find_current_run()
        status = self._read_state(run)["status"] if run else protocol.IDLE
        action = protocol.RESUMED_BY.get(status)
        if action is None:
            why = protocol.WAITS_FOR.get(status) or f"the run is {status}"
            raise DeviceError(
                f"{self.name}: nothing can be resumed: {why}." if run else f"{self.name}: no run waits.",
                effects="none",
            )
        self._parse_data(self._act(run, action))

    # -- the device itself -------------------------------------------------------------------

    @during_motion
    def stop(self) -> None:
        """Cancel the run. The robot stops at once and homes its gantry."""
        self._halted.set()
        if self._run:
            reply = self._act(self._run, "stop")
            if reply.status not in (404, 409):  # these mean that the run has already ended
                self._parse_data(reply)

    @off_loop
    def reset(self) -> None:
        """Cancel the current run, if it has not ended, and home the gantry."""
        self.resume()
        run = self._find_current_run()
        if run and self._read_state(run)["status"] not in (protocol.IDLE, *protocol.TERMINAL):
            self._act(run, "stop")
            with self.assume_motion(), suppress(_Ended):
                self._await_end(run)
        with self.assume_motion():
            reply = self.link.post(
                "/robot/home", json={"target": "robot"}, timeout_s=self.limit_s("home", HOME_S)
            )
            if not reply.ok:
                raise self._make_refusal(reply, "unknown")

    @during_motion
    def is_idle(self) -> bool:
        """Whether the robot has no run in progress. Also sets ``waits_for``: a run that this node does not
        follow can wait for a person too."""
        status = ""
        try:
            run = self._find_current_run()
            status = self._read_state(run)["status"] if run else protocol.IDLE
        finally:
            self.waits_for = protocol.WAITS_FOR.get(status, "")
        return status in (protocol.IDLE, *protocol.TERMINAL)

    @during_motion
    def observe(self) -> dict[str, Any]:
        """Nothing: the robot has no sensor for labware."""
        return {}

    # -- internal ----------------------------------------------------------------------------

    def _read_protocol(self, path: str, values: Mapping[str, Any]) -> tuple[str, bytes]:
        """Name and content of the file, in a form that the robot accepts. Raises DeviceError."""
        file = Path(path)
        if not file.is_file():
            raise self.make_refusal(f"there is no protocol file {path}", "Check its name.")
        content = file.read_bytes()
        if len(content) > LARGEST:
            raise self.make_refusal(f"{file.name} has {len(content)} bytes; {LARGEST} are allowed")
        _check_volumes(self.name, values)
        match file.suffix.lower():
            case ".py":
                return file.name, protocol.with_values(content, values)
            case ".json":
                return file.name, content
            case ".yaml" | ".yml":
                return f"{file.stem}.py", protocol.with_values(translate(file.name, content), values)
        raise self.make_refusal(
            f"{file.name} is not a protocol for an OT-2", "Write it in Python, as a JSON protocol or as YAML."
        )

    def _await_analysis(self, name: str) -> None:
        limit_s = self.limit_s("analysis", ANALYSIS_S)
        deadline = time.monotonic() + limit_s
        while True:
            self.check_not_stopped()
            analyses = self._parse_data(
                self.link.get(f"/protocols/{name}/analyses", timeout_s=self._answer_s)
            )
            last = analyses[-1] if analyses else {}
            if last.get("status") == "completed":
                # An older robot gives no result. It gives a list of errors, which is empty if there are none.
                if last.get("result", "ok" if last.get("errors") == [] else "not-ok") != "ok":
                    why = (
                        protocol.find_innermost(last.get("errors"))
                        if last.get("errors")
                        else f"its analysis ended as {last.get('result')!r}"
                    )
                    raise DeviceError(
                        f"{self.name}: the robot refuses the protocol: {why}",
                        effects="none",
                        remedy="Correct the protocol.",
                    )
                return
            if time.monotonic() > deadline:
                raise self.make_refusal(f"the protocol was not analysed within {limit_s:g} s")
            time.sleep(POLL_S)

    def _play(self, run: str) -> None:
        self.check_not_stopped()
        reply = self._act(run, "play")
        if reply.status >= 500:
            raise Garbled(f"{self.name}: {self._make_refusal(reply, '').message} It may have started.")
        if not reply.ok:
            self._release(run)
            raise self._make_refusal(reply, "none")

    def _has_begun(self, run: str, error: LinkError) -> bool:
        """Whether a ``play`` has reached the robot although its answer was lost. If it has not, the run is
        withdrawn, so that it cannot begin later, and the ``error`` reports no effects."""
        with self.assume_motion():
            if not self._take_back(run):
                return True
        error.effects = "none"
        return False

    def _take_back(self, run: str) -> bool:
        """Withdraw a run that waits for its first ``play``. False if it has begun. Raises DeviceError."""
        state = self._poll_state(run)
        is_fresh = state["status"] == protocol.IDLE and state.get("actions") == []
        return is_fresh and self._retire(run).ok

    def _await_end(self, run: str) -> dict[str, Any]:
        try:
            return self._poll_until_end(run)
        finally:
            self.waits_for = ""

    def _poll_until_end(self, run: str) -> dict[str, Any]:
        began = time.monotonic()
        with self.assume_motion():
            while True:
                state = self._poll_state(run)
                status = state["status"]
                self.waits_for = protocol.WAITS_FOR.get(status, "")
                if status in protocol.TERMINAL:
                    break
                if status == protocol.IDLE and time.monotonic() - began > self.limit_s("begin", BEGIN_S):
                    raise DeviceError(
                        f"{self.name}: the robot accepted the start of run {run}, but does not start.",
                        remedy="Check the robot, then reset the module.",
                    )
                time.sleep(POLL_S)
            self._run = ""
            self._release(run)
            if status != protocol.SUCCEEDED or state.get("ok") is False:
                why = (
                    protocol.find_innermost(state.get("errors")) if status == protocol.FAILED else "cancelled"
                )
                why = "the robot has lost its record of it" if state.get("ok") is False else why
                raise _Ended(
                    f"{self.name}: run {run} {status}: {why}.".replace("..", "."),
                    remedy="Check the deck: it is not known what was pipetted.",
                )
        return {"run": run, "status": status}

    def _check_offsets(self, run: str, made: Any) -> None:
        """Raise DeviceError if the robot has not accepted the offsets: it would pipette beside the wells."""
        kept = made.get("labwareOffsets") if isinstance(made, dict) else None
        if self._offsets and (not isinstance(kept, list) or len(kept) < len(self._offsets)):
            self._release(run)
            raise DeviceError(
                f"{self.name}: the robot has not accepted the labware offsets of the configuration.",
                remedy="Check `labware_offsets:` of the module, and the version of the robot's software.",
            )

    def _poll_state(self, run: str) -> dict[str, Any]:
        """The state of a run. A robot that cannot be reached is asked again until the deadline ``lost``,
        because the run continues without this node."""
        return self.ask_again(lambda: self._read_state(run), self.limit_s("lost", LOST_S), POLL_S)

    def _read_state(self, run: str) -> dict[str, Any]:
        reply = self.link.get(f"/runs/{run}", timeout_s=self._answer_s)
        if reply.status == 404:
            raise _Forgotten(
                f"{self.name}: the robot no longer knows the run {run}.",
                remedy="Check the deck: it is not known what was pipetted.",
            )
        state = self._parse_data(reply)
        if not isinstance(state, dict) or not isinstance(state.get("status"), str):
            raise Garbled(f"{self.name}: the answer does not contain the state of run {run}.")
        return state

    def _find_current_run(self) -> str:
        """The name of the robot's current run; empty if there is none."""
        reply = self.link.get("/runs", params={"pageLength": 1}, timeout_s=self._answer_s)
        self._parse_data(reply)
        links = reply.json().get("links")
        current = links.get("current") if isinstance(links, dict) else ""
        if current is None:
            return ""
        name = str(current.get("href", "")).rpartition("/")[2] if isinstance(current, dict) else ""
        if not name:
            raise Garbled(f"{self.name}: {reply.body[:80]!r} does not contain the present run of the robot.")
        return name

    def _release(self, run: str) -> None:
        """Make the robot free for other users. A failure does no harm and is ignored."""
        with suppress(DeviceError):
            self._retire(run)

    def _act(self, run: str, action: str) -> HttpReply:
        body = {"data": {"actionType": action}}
        return self.link.post(f"/runs/{run}/actions", json=body, timeout_s=self._answer_s)

    def _retire(self, run: str) -> HttpReply:
        return self.link.exchange(
            "PATCH", f"/runs/{run}", json={"data": {"current": False}}, timeout_s=self._answer_s
        )

    # -- one answer --------------------------------------------------------------------------

    def _parse_data(self, reply: HttpReply) -> Any:
        """The data of an answer. Raises DeviceError for a refusal, NotConnected if the robot is still
        starting, Garbled if it is no answer of a robot server."""
        if reply.status == 503:
            raise NotConnected(f"{self.name}: the robot is still starting.", remedy="Wait some minutes.")
        if not reply.ok:
            raise self._make_refusal(reply, "none")
        body = reply.json()
        if not isinstance(body, dict) or "data" not in body:
            raise Garbled(f"{self.name}: {reply.body[:80]!r} is not an answer of a robot server.")
        return body["data"]

    def _parse_id(self, data: Any) -> str:
        if not isinstance(data, dict) or not isinstance(data.get("id"), str):
            raise Garbled(f"{self.name}: {str(data)[:80]!r} has no name.")
        return str(data["id"])

    def _make_refusal(self, reply: HttpReply, effects: str) -> DeviceError:
        try:
            body = json.loads(reply.body)
        except ValueError:
            body = None
        return DeviceError(
            f"{self.name}: the robot refuses: {protocol.find_reason(body, reply.status)}",
            effects=effects,
            remedy="Check the robot, and its other users: its App, its button.",
        )

    def _recognise(self) -> str:
        reply = self.link.get("/health", timeout_s=self._answer_s)
        if reply.status == 503:
            raise NotConnected(f"{self.name}: the robot is still starting.", remedy="Wait some minutes.")
        health = reply.json()
        model = health.get("robot_model", "") if isinstance(health, dict) else ""
        if str(model).startswith("OT-2"):
            self.check_unit(health.get("robot_serial"))
            self.note_firmware(health.get("api_version"))
            return WHO
        return f"a robot of the model {model!r}" if model else f"what answers {reply.body[:40]!r}"


class _Forgotten(DeviceError):
    """The robot no longer knows a run: it keeps only its last runs, and only those on its disk."""


class _Ended(DeviceError):
    """The run has ended, but not with success."""


def _check_volumes(name: str, values: Mapping[str, Any]) -> None:
    """Raise DeviceError if volumes do not match the wells in number, or if one is negative or not finite."""
    for key, volumes in values.items():
        if not key.endswith("_volumes") or not volumes:
            continue
        which = "source" if key == "source_volumes" else "destination"
        wells = values.get(f"{which}_wells") or []
        if len(volumes) != len(wells):
            raise make_refusal(name, f"{key} has {len(volumes)} volumes for {len(wells)} {which} wells")
        if not all(math.isfinite(volume) and volume >= 0 for volume in volumes):
            raise make_refusal(name, f"{key} has volumes below 0")

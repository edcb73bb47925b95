"""Any HTTP device, by a mapping in the workcell file (``labos.spec.rest``).

A start is sent once. If its answer is lost and the device knows jobs by an id from LabOS, the adapter asks
for the job; otherwise the outcome is unknown.
"""

from __future__ import annotations

import asyncio
import json
from typing import Any, Literal, NamedTuple
from urllib.parse import quote

import httpx
import structlog

from labos.adapter._foreign import SENT, Silence, make_not_started_error
from labos.adapter._http import NoResponse, read_json, refuse, refuse_at_end
from labos.adapter._http_node import HttpNode
from labos.adapter._placeholders import fill
from labos.adapter.wei import find_levels
from labos.core.model import ActionSpec
from labos.errors import DeviceError, OutcomeUnknown
from labos.node.node import current_action
from labos.spec.rest import Reading, Request, RestMapping, find_flaw, request_of

JOB_START_S = 30.0
"""How long a device may take to confirm that it has accepted a job."""

_log = structlog.get_logger(__name__)


class RestNode(HttpNode):
    """Config: ``rest_node_address``, ``rest`` (the mapping); ``rest_node_auth`` is a file with the value of
    the Authorization header, ``rest_node_auth_env`` an environment variable with it."""

    async def connect(self) -> None:
        config = self.setup.config
        if flaw := find_flaw(config.get("rest") or {}):
            raise DeviceError(f"In `rest:`, {flaw}.", effects="none")
        self.mapping = RestMapping.model_validate(config["rest"])
        self.check_started("rest", self.mapping.request)
        await super().connect()

    # -- how it is ---------------------------------------------------------------------------

    @property
    def reports_busy(self) -> bool:
        return self.mapping.state is not None and bool(self.mapping.state.busy)

    async def is_idle(self) -> bool:
        """By its status; a device without a status is only asked whether it answers."""
        status, _ = await self._ask_state()
        return status not in ("busy", "not known") if self.reports_busy else await super().is_idle()

    async def trouble(self) -> str:
        try:
            status, why = await self._ask_state()
        except DeviceError as missing:
            return str(missing)
        if status == "not known":
            return f"The device reports {why}; `rest: state` does not define its meaning."
        return f"The device is in error: {why}. Reset the module." if status == "error" else ""

    async def resources(self) -> dict[str, float]:
        if self.mapping.resources is None:
            return {}
        found = find_field(await self.http.ask(self.mapping.resources.path), self.mapping.resources.at)
        return find_levels(found if isinstance(found, dict) else {})

    async def _ask_state(self) -> tuple[str, str]:
        """The status (busy, error, not known or nothing) and its reason. Raises DeviceError (``none``) if
        there is no status."""
        state = self.mapping.state
        if state is None:
            return "", ""
        answer = await self.http.ask(state.path)
        status = find_field(answer, state.status)
        if status in state.error:
            return "error", str(find_field(answer, state.why) if state.why else status)
        if status in state.busy:
            return "busy", ""
        if status is None:
            raise DeviceError(f"{state.path} tells no {state.status or 'status'!r}.", effects="none")
        return ("not known", repr(status)) if state.idle and status not in state.idle else ("", "")

    # -- recovery ----------------------------------------------------------------------------

    async def reset(self) -> None:
        if self.mapping.reset is not None:
            await self._command(self.mapping.reset)
        self.believe_at_rest()

    async def stop(self) -> None:
        if self.mapping.stop is None:
            raise DeviceError("`rest:` does not define how the device is stopped.", effects="none")
        await self._command(self.mapping.stop)

    async def _command(self, command: dict[str, Any]) -> None:
        try:
            refuse(await self._send(request_of(command), {}))
        except NoResponse as lost:
            raise DeviceError(f"No answer came ({lost}).") from lost

    async def _send(
        self, request: Request, values: dict[str, Any], read_s: float | None = 0.0
    ) -> httpx.Response:
        options: dict[str, Any] = {}
        if request.params:
            texts = fill(request.params, values, "rest", leave_out=True)
            options["params"] = {key: _as_text(value) for key, value in texts.items()}
        if request.json_ is not None:
            options["json"] = fill(request.json_, values, "rest", leave_out=True)
        path = fill_path(request.path, values)
        return await self.http.send(request.method, path, read_s=read_s, **options)

    # -- actions -----------------------------------------------------------------------------

    async def begin(self, spec: ActionSpec, name: str, args: dict[str, Any]) -> Any:
        request = self.mapping.request(spec.name)
        if request is None:
            raise make_not_started_error("rest", spec)
        args = self.name_places(spec, args)
        job, action = self.mapping.job, current_action.get()
        named_by_us = job is not None and not job.id
        await self.note_handle(action if named_by_us else SENT)
        values = {**args, "args": args, "action": name, "id": action}
        try:
            if job is None:
                return await self._carry_out_at_once(spec, request, values)
            answer = await self._send(request, values, JOB_START_S)
        except NoResponse as lost:
            if named_by_us:
                return await self._end(spec, action)
            raise OutcomeUnknown(f"the answer to its start was lost ({lost})") from lost
        refuse(answer)
        if job is not None and job.id:
            await self.note_handle(handle := read_given_id(self.mapping.outcome, job.id, answer))
            return await self._end(spec, handle)
        return await self._end(spec, action)

    async def _carry_out_at_once(self, spec: ActionSpec, request: Request, values: dict[str, Any]) -> Any:
        """The result of an action whose answer comes at its end. Raises DeviceError, OutcomeUnknown, Lost."""

        async def at_work() -> bool:
            return self.reports_busy and (await self._ask_state())[0] == "busy"

        limit_s = self.limit_s(spec)
        # A device that does only one thing at a time perhaps reports no state while it works.
        answer = await self.answer_to(
            asyncio.ensure_future(self._send(request, values, None)),
            at_work,
            silent_s=limit_s,
            mute_s=limit_s,
            ended="there is no other way to ask about it",
        )
        reading = self.mapping.outcome
        refuse_at_end(answer, reading.refused)
        end = read_end(reading, read_json(answer) if answer.content else {})
        if end.status == "running":
            raise OutcomeUnknown("the device still works, and there is no `job:` for asking about it")
        if end.status == "not known":
            raise OutcomeUnknown(
                f"the device says {end.reported!r}; `rest: outcome` does not define its meaning"
            )
        return end.result

    async def find_out(self, spec: ActionSpec, name: str, handle: str) -> Any:
        if handle == SENT:
            raise OutcomeUnknown("the adapter was restarted before it received an id from the device")
        return await self._end(spec, handle)

    async def _end(self, spec: ActionSpec, handle: str) -> Any:
        """Ask about a job until it has ended. A status that the mapping does not name does not count as the
        end, because the device may still be working. Raises DeviceError, OutcomeUnknown."""
        job = self.mapping.job
        if job is None:
            raise OutcomeUnknown("`rest:` has no `job:` for asking about it")
        silence = Silence(self.patience_s, self.where)
        strange, strange_since = None, 0.0
        while True:
            try:
                answer = await self.http.send("GET", fill_path(job.path, {"id": handle}))
                if answer.status_code == 404:
                    raise OutcomeUnknown(f"the device does not know the job {handle}")
                data = read_json(answer)
            except (NoResponse, DeviceError) as error:
                silence.go_on(error)
            else:
                silence.end()
                end = read_end(self.mapping.outcome, data)
                if end.status == "done":
                    return end.result
                now = asyncio.get_running_loop().time()
                if end.status == "running":
                    strange = None
                elif end.reported != strange:
                    strange, strange_since = end.reported, now
                    _log.warning("job_status_not_known", module=self.setup.name, job=handle, status=strange)
                elif now - strange_since > self.limit_s(spec):
                    raise OutcomeUnknown(
                        f"the device says {strange!r} of the job {handle}; `rest: outcome` does not "
                        "define its meaning"
                    )
            await asyncio.sleep(self.poll_s)


class JobEnd(NamedTuple):
    """Whether an action has ended, by an answer: it is done, or not yet, or the answer (``reported``) is in
    no list of the mapping."""

    status: Literal["done", "running", "not known"]
    result: Any = None
    reported: Any = None


def read_end(reading: Reading, data: Any) -> JobEnd:
    """Whether an action has ended, and its result. Raises DeviceError if it failed."""
    result = find_field(data, reading.result) if reading.result else data
    if not reading.status:
        return JobEnd("done", result)
    status = find_field(data, reading.status)
    if status in reading.done:
        return JobEnd("done", result)
    if status in reading.running:
        return JobEnd("running")
    if status not in reading.failed and status not in reading.not_started:
        return JobEnd("not known", reported=status)
    error = find_field(data, reading.error) if reading.error else None
    effects = "none" if status in reading.not_started else "unknown"
    raise DeviceError(f"The device says {status!r}{f': {error}' if error else ''}.", effects=effects)


def read_given_id(reading: Reading, path: str, answer: httpx.Response) -> str:
    """The id that a device gave to a job. Because the device may have started a job without an id in its
    answer, this is a failure only if the answer says that nothing was started. Raises DeviceError,
    OutcomeUnknown."""
    try:
        data = read_json(answer)
    except DeviceError as error:
        raise OutcomeUnknown(f"the device accepted it, but sent no id: {error}") from error
    found = find_field(data, path)
    if isinstance(found, str | int) and not isinstance(found, bool) and found != "":
        return str(found)
    if reading.status and find_field(data, reading.status) in reading.not_started:
        read_end(reading, data)
    raise OutcomeUnknown(f"the device accepted it, but sent no id: its answer has no {path!r}")


def find_field(data: Any, path: str) -> Any:
    """A field by its path, ``job.status``; None where there is none."""
    for part in path.split(".") if path else ():
        data = data.get(part) if isinstance(data, dict) else None
    return data


def fill_path(path: str, values: dict[str, Any]) -> str:
    """A path with its placeholders filled in."""
    return str(fill(path, {key: quote(str(value), safe="") for key, value in values.items()}, "rest"))


def _as_text(value: Any) -> Any:
    return value if isinstance(value, str | int | float) else json.dumps(value)

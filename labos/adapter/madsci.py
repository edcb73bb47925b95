"""MADSci's REST nodes (``madsci-node-module`` 0.8).

An action is created (``POST /action/NAME``: the node gives it an id, nothing moves), gets its files, and is
started by its id. The node removes the id from its list before it starts the action, so that a second start
with the same id has no effect. Therefore, as long as the node's process lives, a start can be repeated after
a lost answer. The node's history is in memory: after a restart it does not know the id any more, and the
outcome of the action is unknown.
"""

from __future__ import annotations

import asyncio
import functools
import io
import zipfile
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any, TypeVar

from labos.adapter._foreign import Silence, read_file
from labos.adapter._http import NoResponse, read_json, refuse
from labos.adapter._http_node import DescribedHttpNode
from labos.adapter._types import make_action, make_arg, type_of
from labos.core.model import ActionSpec, Description
from labos.errors import DeviceError, OutcomeUnknown
from labos.node.files import Attachment

T = TypeVar("T")

TRIES = 5
"""How often a request that cannot cause a second motion is sent when no answer comes."""

STARTS_WITHIN_S = 30.0
"""A start without an answer is not repeated after this time, because the lab assumes that it began."""

UNDER_WAY = ("not_started", "running", "paused")
FORGOTTEN = "the foreign node no longer knows the action: it was restarted, and its history is in memory"


class MadsciRestNode(DescribedHttpNode):
    """Config: ``node_url``; ``node_auth`` is a file with the value of the Authorization header."""

    addresses = ("node_url", "rest_node_address")
    authorization = "node_auth"

    # -- how it is ---------------------------------------------------------------------------

    async def is_idle(self) -> bool:
        status = await self.read_status()
        return not (status["busy"] or status.get("running_actions") or status.get("initializing"))

    async def read_offer(self) -> tuple[Any, dict[str, Any]]:
        info = await self._info()
        return info.get("module_version"), info.get("actions") or {}

    def describe_trouble(self, status: dict[str, Any]) -> str:
        if status.get("errored") or status.get("disconnected"):
            why = "; ".join(str(error.get("message")) for error in (status.get("errors") or ())[-1:])
            what = "in error" if status.get("errored") else "not connected to its device"
            return f"The foreign node is {what}: {why or status.get('description') or '?'} Reset the module."
        for halted in ("locked", "paused", "stopped"):
            if status.get(halted):
                return f"The foreign node is {halted} on its own side. Unlock, resume or reset it there."
        return ""

    async def observe(self) -> dict[str, Any]:
        """The content of the node's own state."""
        state = await self.http.ask("/state")
        return state if isinstance(state, dict) else {"state": state}

    async def read_status(self) -> dict[str, Any]:
        """The node's status. Raises DeviceError (``none``), also for an answer that does not show whether the
        node is busy."""
        status = await self._table("/status")
        if not isinstance(status.get("busy"), bool):
            raise DeviceError(f"/status answered {status!r}, which does not say `busy`.", effects="none")
        return status

    async def _info(self) -> dict[str, Any]:
        return await self._table("/info")

    async def _table(self, path: str) -> dict[str, Any]:
        answer = await self.http.ask(path)
        if not isinstance(answer, dict):
            raise DeviceError(f"{path} answered {answer!r}.", effects="none")
        return answer

    # -- recovery ----------------------------------------------------------------------------

    async def reset(self) -> None:
        """The foreign node's own reset; it ends when the node is ready again."""
        await self._command("reset")
        for _ in range(int(self.patience_s / 0.5)):
            status = await self.read_status()
            if not status.get("initializing"):
                break
            await asyncio.sleep(0.5)
        else:
            raise DeviceError(f"{self.where} has said for {self.patience_s:g} s that it starts.")
        if status.get("errored"):
            raise DeviceError("The foreign node is in error after its reset.", effects="none")

    async def stop(self) -> None:
        """``safety_stop``."""
        await self._command("safety_stop")

    async def _command(self, name: str) -> None:
        try:
            answer = read_json(await self.http.send("POST", f"/admin/{name}"))
        except NoResponse as lost:
            raise DeviceError(f"{name}: no answer came ({lost}).") from lost
        if not isinstance(answer, dict) or answer.get("success") is not True:
            why = _describe_errors(answer) if isinstance(answer, dict) else ""
            raise DeviceError(f"{name}: {why or f'the foreign node answered {answer!r}'}")

    # -- actions -----------------------------------------------------------------------------

    async def begin(self, spec: ActionSpec, name: str, args: dict[str, Any]) -> Any:
        files = {}
        sent: dict[str, Any] = {}
        for key, value in args.items():
            if self.is_file(spec, key):
                files[key] = (Path(str(value)).name, await read_file(value))
            elif self.is_station(spec, key):
                sent[key] = self._make_location(spec, str(value))
            else:
                sent[key] = value
        handle = await self._send_again(lambda: self._create(name, sent))
        for key, file in files.items():
            await self._send_again(functools.partial(self._upload, name, handle, key, file))
        await self.note_handle(handle)
        await self._start(name, handle)
        return await self._end(name, handle)

    def _make_location(self, spec: ActionSpec, station: str) -> dict[str, Any]:
        """A station in the form for the foreign node; ``resource_ids`` has the resource of its lab for the
        station, if there is one."""
        location = {"representation": self.place(spec, station), "location_name": station}
        resources = self.setup.config.get("resource_ids") or {}
        return {**location, "resource_id": resources[station]} if station in resources else location

    async def find_out(self, spec: ActionSpec, name: str, handle: str) -> Any:
        return await self._end(name, handle)

    async def _create(self, name: str, args: dict[str, Any]) -> str:
        try:
            answer = read_json(await self.http.send("POST", f"/action/{name}", json={"args": args}))
        except DeviceError as error:
            raise DeviceError(error.message, effects="none", remedy=error.remedy) from error
        if not isinstance(answer, dict) or not answer.get("action_id"):
            raise DeviceError(f"{name}: the foreign node sent no id, but {answer!r}.", effects="none")
        return str(answer["action_id"])

    async def _upload(self, name: str, handle: str, key: str, file: tuple[str, bytes]) -> None:
        path = f"/action/{name}/{handle}/upload/{key}"
        answer = await self.http.send("POST", path, read_s=60.0, files={"file": file})
        if answer.status_code >= 500:
            raise DeviceError(f"The file {key!r} was not taken: {answer.text[:200]}", effects="none")
        refuse(answer)

    async def _send_again(self, send: Callable[[], Awaitable[T]]) -> T:
        """Send a request that moves nothing, again if its answer was lost."""
        for number in range(TRIES):
            try:
                return await send()
            except NoResponse as lost:
                if number == TRIES - 1:
                    raise DeviceError(f"The foreign node does not answer ({lost}).", effects="none") from lost
                await asyncio.sleep(min(0.2 * 2**number, self.poll_s))
        raise AssertionError

    async def _start(self, name: str, handle: str) -> None:
        """Start an action by its id; again, if no answer came and the node does not know the start. Returns
        when the node has it in its history, or when nothing more can be done."""
        loop = asyncio.get_running_loop()
        until = loop.time() + STARTS_WITHIN_S
        lost_once = False
        while True:
            try:
                refuse(await self.http.send("POST", f"/action/{name}/{handle}/start"))
                return
            except NoResponse:
                lost_once = True
            except DeviceError as error:
                # After a lost start, the refusal of a second one does not show what became of the first.
                if error.effects == "none" and not lost_once:
                    raise
                lost_once = True
            await asyncio.sleep(min(self.poll_s, 0.5))
            try:
                known = (await self._read_result(name, handle)).get("status") != "unknown"
            except DeviceError:
                known = False
            if known or loop.time() > until:
                return

    async def _end(self, name: str, handle: str) -> Any:
        """Ask for the result until there is one. Raises DeviceError, OutcomeUnknown."""
        silence, pause_s = Silence(self.patience_s, self.where), min(self.poll_s, 0.2)
        while True:
            try:
                answer = await self._read_result(name, handle)
                silence.end()
            except DeviceError as error:
                silence.go_on(error)
                answer = {"status": "running"}
            status = str(answer.get("status"))
            if status == "succeeded":
                return await self._fetch_result_with_files(handle, answer)
            if status == "not_ready":
                raise DeviceError(f"{name}: {_describe_errors(answer)}", effects="none")
            if status == "unknown":
                raise OutcomeUnknown(
                    _describe_errors(answer) if answer.get("action_id") == handle else FORGOTTEN
                )
            if status not in UNDER_WAY:
                effects = "unknown" if await self._has_begun(handle) else "none"
                raise DeviceError(f"{name}: {_describe_errors(answer) or status}", effects=effects)
            await asyncio.sleep(pause_s)
            # MADSci's nodes answer 100 requests a minute.
            pause_s = min(pause_s * 1.5, max(self.poll_s, 0.2))

    async def _read_result(self, name: str, handle: str) -> dict[str, Any]:
        answer = await self._table(f"/action/{handle}/result")
        if answer.get("action_id") != handle and answer.get("status") != "unknown":
            raise DeviceError(
                f"{name}: the request was about {handle}, but the answer is about {answer.get('action_id')}."
            )
        return answer

    async def _has_begun(self, handle: str) -> bool:
        """Whether the history of a failed action shows that it ran."""
        try:
            history = (await self._table(f"/action?action_id={handle}")).get(handle)
        except DeviceError:
            return True
        entries = history if isinstance(history, list) else [{"status": "running"}]
        return any(entry.get("status") == "running" for entry in entries)

    async def _fetch_result_with_files(self, handle: str, answer: dict[str, Any]) -> Any:
        """The result with references to its files and data points."""
        result, points = answer.get("json_result"), answer.get("datapoints")
        if not answer.get("files") and not points:
            return result
        full: dict[str, Any] = {**result} if isinstance(result, dict) else {}
        if result is not None and not isinstance(result, dict):
            full["value"] = result
        if points:
            full["datapoints"] = points
        if answer.get("files"):
            full["files"] = await self._fetch_files(handle, list(answer["files"]))
        return full

    async def _fetch_files(self, handle: str, labels: list[str]) -> dict[str, Any]:
        try:
            answer = await self.http.send("GET", f"/action/{handle}/download", read_s=120.0)
            refuse(answer)
            with zipfile.ZipFile(io.BytesIO(answer.content)) as archive:
                content = {name: archive.read(name) for name in archive.namelist()}
        except (NoResponse, DeviceError, zipfile.BadZipFile) as error:
            raise DeviceError(
                f"It was done, but its files could not be fetched: {error}", effects="all"
            ) from error
        kept = {}
        for name, data in content.items():
            label = name.rpartition(".")[0] if name.rpartition(".")[0] in labels else name
            kept[labels[0] if len(content) == len(labels) == 1 else label] = Attachment(name, data)
        return kept

    async def foreign_description(self) -> Description:
        return describe(await self._info())


def describe(info: dict[str, Any]) -> Description:
    """A MADSci node's ``/info`` as a LabOS description, without effects."""
    actions = info.get("actions") or {}
    return Description(
        driver="madsci_rest_node",
        version=str(info.get("module_version") or ""),
        description=str(info.get("node_description") or info.get("node_name") or ""),
        models=(str(info["module_name"]),) if info.get("module_name") else (),
        actions=tuple(_action(name, action) for name, action in actions.items()),
    )


def _action(name: str, action: dict[str, Any]) -> ActionSpec:
    args = [
        make_arg(key, arg, kind or type_of(arg.get("argument_type")))
        for table, kind in (("args", ""), ("locations", "station"), ("files", "file"))
        for key, arg in (action.get(table) or {}).items()
    ]
    return make_action(name, action, args)


def _describe_errors(answer: dict[str, Any]) -> str:
    """The messages of a result's errors."""
    errors = answer.get("errors") or ()
    return "; ".join(str(error.get("message") if isinstance(error, dict) else error) for error in errors)

"""WEI's REST nodes (``ad_sdl.wei`` 0.7, and the older forms of its answers).

``POST /action?action_handle=…&action_vars=…`` blocks until the action is done. There is no id and no history:
if the answer is lost, the node can report whether it is still busy, but not the outcome. Therefore a start is
sent once, and after a lost answer the outcome is unknown.
"""

from __future__ import annotations

import asyncio
import contextlib
import io
import json
import math
import zipfile
from typing import Any

import httpx

from labos.adapter._decode import read_json_text
from labos.adapter._foreign import SENT, read_file
from labos.adapter._http import LARGEST_ANSWER, NoResponse, read_json, refuse_at_end
from labos.adapter._http_node import DescribedHttpNode
from labos.adapter._types import make_action, make_arg, type_of
from labos.core.model import ActionSpec, Description
from labos.errors import DeviceError, OutcomeUnknown
from labos.node.files import Attachment
from labos.node.node import Setup

BUSY = {"BUSY", "RUNNING"}
STARTING = {"INIT", "STARTING"}
READY = {"READY", "IDLE", "OK"}
HALTED = {"LOCKED", "PAUSED", "CANCELLED"}
"""States of a foreign node in which it accepts no actions until a person permits it."""

NO_RECORD = "the foreign node has ended or lost it, and WEI keeps no record of the outcome"


class WeiRestNode(DescribedHttpNode):
    """Config: ``rest_node_address``; ``rest_node_auth`` names a file that holds the value of the
    Authorization header, ``rest_node_auth_env`` a variable that does."""

    def __init__(self, setup: Setup) -> None:
        super().__init__(setup)
        self._admin: tuple[str, ...] = ()

    # -- how it is ---------------------------------------------------------------------------

    async def is_idle(self) -> bool:
        flags, _ = await self.read_status()
        return is_at_rest(flags)

    async def read_status(self) -> tuple[set[str], str]:
        """The flags that are set, and the error."""
        return read_state(await self.http.ask("/state"))

    async def read_offer(self) -> tuple[Any, set[str]]:
        about = await self._ask_about()
        return about.get("version"), {str(action.get("name")) for action in about.get("actions", [])}

    def describe_trouble(self, status: tuple[set[str], str]) -> str:
        flags, error = status
        if "ERROR" in flags:
            return f"The foreign node is in error: {error or 'it does not say why'}. Reset the module."
        if halted := flags & HALTED:
            return f"The foreign node is {min(halted).lower()} on its own side. Unlock or reset it there."
        if not is_working(flags) and not is_at_rest(flags):
            words = ", ".join(sorted(flags)) or "nothing of its status"
            return f"The foreign node says {words}, which is not known to mean that it is idle."
        return ""

    async def observe(self) -> dict[str, Any]:
        """The content of the node's state besides its status."""
        state = await self.http.ask("/state")
        plain = state if isinstance(state, dict) else {}
        return {name: value for name, value in plain.items() if name not in ("status", "error", "State")}

    async def resources(self) -> dict[str, float]:
        answer = await self.http.ask("/resources")
        levels = answer.get("resources") if isinstance(answer, dict) else None
        return find_levels(levels if isinstance(levels, dict) else {})

    async def _ask_about(self) -> dict[str, Any]:
        about = await self.http.ask("/about")
        if not isinstance(about, dict):
            raise DeviceError("/about sent an answer that is not a description.", effects="none")
        self._admin = tuple(str(command).lower() for command in about.get("admin_commands") or ())
        return about

    # -- recovery ----------------------------------------------------------------------------

    async def reset(self) -> None:
        """The foreign node's own reset; it ends when the node has started again without an error."""
        await self._command("reset")
        flags, error = await self.read_status()
        until = asyncio.get_running_loop().time() + self.patience_s
        while flags & STARTING:
            if asyncio.get_running_loop().time() > until:
                raise DeviceError(f"{self.where} has said for {self.patience_s:g} s that it starts.")
            await asyncio.sleep(min(self.poll_s, 0.5))
            flags, error = await self.read_status()
        if "ERROR" in flags:
            raise DeviceError(f"The foreign node is in error after its reset: {error}", effects="none")

    async def stop(self) -> None:
        """``safety_stop``, if the node has it."""
        await self._command("safety_stop")

    async def _command(self, name: str) -> None:
        if not self._admin:
            await self._ask_about()
        if name not in self._admin:
            raise DeviceError(f"The foreign node has no command {name!r}.", effects="none")
        try:
            answer = read_json(await self.http.send("POST", f"/admin/{name}"))
        except NoResponse as lost:
            raise DeviceError(f"{name}: no answer came ({lost}).") from lost
        if isinstance(answer, dict) and answer.get("error"):
            raise DeviceError(f"{name}: {answer['error']}")
        if answer == 404:  # it answers a refused command with this number and a status of success
            raise DeviceError(f"The foreign node refuses {name!r}.", effects="none")

    # -- actions -----------------------------------------------------------------------------

    async def begin(self, spec: ActionSpec, name: str, args: dict[str, Any]) -> Any:
        files = []
        sent: dict[str, Any] = {}
        for key, value in args.items():
            if self.is_file(spec, key):
                files.append(("files", (key, await read_file(value))))
            else:
                sent[key] = self.place(spec, str(value)) if self.is_station(spec, key) else value
        await self.note_handle(SENT)
        params = {"action_handle": name, "action_vars": json.dumps(sent)}
        sending = self.http.send("POST", "/action", read_s=None, params=params, files=files or None)
        answer = await self._answer(spec, asyncio.ensure_future(sending))
        return await self._make_result(name, answer)

    async def find_out(self, spec: ActionSpec, name: str, handle: str) -> Any:
        await self.wait_until(self._is_not_working)
        raise OutcomeUnknown(f"the adapter was restarted meanwhile; {NO_RECORD}")

    async def _answer(self, spec: ActionSpec, sending: asyncio.Future[httpx.Response]) -> httpx.Response:
        """The answer to a start. Raises OutcomeUnknown."""

        async def at_work() -> bool:
            return not await self._is_not_working()

        try:
            return await self.answer_to(
                sending, at_work, silent_s=self.patience_s, mute_s=self.limit_s(spec), ended=NO_RECORD
            )
        except NoResponse as lost:
            await self.wait_until(self._is_not_working)
            raise OutcomeUnknown(f"its answer was lost ({lost}); {NO_RECORD}") from lost

    async def _is_not_working(self) -> bool:
        flags, _ = await self.read_status()
        return not is_working(flags)

    async def _make_result(self, name: str, answer: httpx.Response) -> Any:
        refuse_at_end(answer, refused=(422,))  # FastAPI's own status for wrong arguments
        if "x-wei-status" in answer.headers:
            fields = {key: _read_header(answer, f"x-wei-{key}") for key in ("data", "error", "files")}
            status: Any = answer.headers["x-wei-status"]
        else:
            fields = read_json(answer)
            if not isinstance(fields, dict):
                raise DeviceError(f"{name}: the node answered {fields!r}, which contains no outcome.")
            status = fields.get("status", fields.get("action_response"))
        # Some versions write the status as `StepStatus.SUCCEEDED`.
        word = str(status).rpartition(".")[2].lower()
        error = fields.get("error") or fields.get("action_log") or ""
        match word:
            case "succeeded":
                return self._make_result_with_files(fields, answer)
            case "not_ready":
                raise DeviceError(f"{name}: {error or 'the foreign node is not ready'}", effects="none")
            case "failed" | "cancelled":
                raise DeviceError(f"{name}: {error or word}")
        raise OutcomeUnknown(f"the foreign node answered {status!r}, which is not an outcome of an action")

    def _make_result_with_files(self, fields: dict[str, Any], answer: httpx.Response) -> Any:
        """The data with references to the files that came with them."""
        data = fields.get("data", fields.get("action_msg"))
        files = fields.get("files") if "x-wei-status" in answer.headers else None
        if not files:
            return data
        kept = {}
        for label, name in files.items():
            bare = str(name).replace("\\", "/").rpartition("/")[2]
            content = answer.content if len(files) == 1 else _unzip(answer.content, bare)
            kept[label] = Attachment(bare, content)
        return {**(data if isinstance(data, dict) else {} if data is None else {"data": data}), "files": kept}

    # -- what it says of itself --------------------------------------------------------------

    async def foreign_description(self) -> Description:
        return describe(await self._ask_about())


def _read_header(answer: httpx.Response, name: str) -> Any:
    """The JSON in a header. Raises DeviceError; if the node reports success, with all effects."""
    try:
        return read_json_text(answer.headers.get(name) or "null")
    except ValueError as error:
        done = str(answer.headers.get("x-wei-status")).lower().endswith("succeeded")
        raise DeviceError(
            f"The header {name} of the node's answer cannot be read as JSON ({error}).",
            effects="all" if done else "unknown",
        ) from error


def describe(about: dict[str, Any], driver: str = "wei_rest_node") -> Description:
    """A WEI node's ``/about`` as a LabOS description, without effects."""
    return Description(
        driver=driver,
        version=str(about.get("version") or ""),
        description=str(about.get("description") or about.get("name") or ""),
        models=(str(about["model"]),) if about.get("model") else (),
        actions=tuple(_action(action) for action in about.get("actions") or ()),
    )


def _action(action: dict[str, Any]) -> ActionSpec:
    args = [make_arg(arg["name"], arg, type_of(arg.get("type", "any"))) for arg in action.get("args") or ()]
    args += [make_arg(file["name"], {**file, "default": None}, "file") for file in action.get("files") or ()]
    return make_action(action["name"], action, args)


def read_state(state: Any) -> tuple[set[str], str]:
    """The flags of a node's ``/state``, in all forms that WEI has had; and its error."""
    if isinstance(state, str):
        return {state.upper()}, ""
    if not isinstance(state, dict):
        raise DeviceError(f"/state answered {state!r}.", effects="none")
    status = state.get("status", state.get("State"))
    error = state.get("error") or ""
    words = "; ".join(map(str, error)) if isinstance(error, list) else str(error)
    if isinstance(status, dict):
        return {str(name).upper() for name, on in status.items() if on}, words
    if isinstance(status, str):
        return {status.upper()}, words
    raise DeviceError(f"/state answered {state!r}, which contains no status.", effects="none")


def is_working(flags: set[str]) -> bool:
    """Whether a node is carrying out something. A node whose action raised an error reports BUSY without end;
    it counts as in error and idle."""
    return bool(flags & (BUSY | STARTING)) and "ERROR" not in flags


def is_at_rest(flags: set[str]) -> bool:
    """Whether a node reports that it carries out nothing. An unknown state does not count."""
    return not is_working(flags) and bool(flags & (READY | HALTED | {"ERROR"}))


def find_levels(resources: dict[str, Any]) -> dict[str, float]:
    """The numbers of a table of resources, at the first level or as ``quantity`` below it."""
    levels = {}
    for name, value in resources.items():
        number = value.get("quantity", value.get("level")) if isinstance(value, dict) else value
        with contextlib.suppress(TypeError, ValueError):
            if not isinstance(number, bool) and math.isfinite(level := float(number)):  # type: ignore[arg-type]
                levels[str(name)] = level
    return levels


def _unzip(content: bytes, name: str) -> bytes:
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            found = next(n for n in archive.namelist() if n.rpartition("/")[2] == name)
            with archive.open(found) as file:
                data = file.read(LARGEST_ANSWER + 1)
    except (zipfile.BadZipFile, StopIteration, NotImplementedError, RuntimeError, OSError, EOFError) as error:
        raise DeviceError(f"The file {name!r} did not come with the result.", effects="all") from error
    if len(data) > LARGEST_ANSWER:
        raise DeviceError(f"The file {name!r} has more than {LARGEST_ANSWER} bytes.", effects="all")
    return data

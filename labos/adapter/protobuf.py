"""Nodes with protobuf over TCP, by the included schema (``tcp_node.proto``). An action has LabOS' own id. A
node that stores the outcome of each id can be asked after a lost answer or a restart. A node that stores
nothing answers that it does not know the id, and the outcome is unknown.
"""

from __future__ import annotations

import asyncio
import json
from pathlib import Path
from typing import Any

from labos.adapter._decode import read_json_text
from labos.adapter._foreign import ForeignNode, Silence, read_file
from labos.adapter._http import NoResponse
from labos.adapter._protobuf import frame_message, make_schema, read_message
from labos.adapter._tcp import Address
from labos.adapter.wei import describe
from labos.core.model import ActionSpec, Description
from labos.errors import DeviceError, OutcomeUnknown
from labos.node.files import Attachment
from labos.node.node import Setup, current_action

READ_S = 10.0

NOT_KNOWN, RUNNING, SUCCEEDED, FAILED, NOT_STARTED = 1, 2, 3, 4, 5
"""``Status`` in the schema."""

FORGOTTEN = "the node does not know the action: it never received it, or keeps no record"


class TcpNode(ForeignNode):
    """Config: ``tcp_node_address``, ``tcp_node_port``."""

    def __init__(self, setup: Setup) -> None:
        super().__init__(setup)
        self._address = Address(setup.config, ("tcp_node_address",), ("tcp_node_port",))
        self._starting = 0

    async def connect(self) -> None:
        make_schema()
        self._address.check()

    @property
    def where(self) -> str:
        return str(self._address)

    # -- how it is ---------------------------------------------------------------------------

    async def is_idle(self) -> bool:
        return not await self._is_busy()

    async def _is_busy(self) -> bool:
        return bool((await self._ask_question("state")).busy)

    async def trouble(self) -> str:
        """The trouble with the node. A node that answers an action only at its end may answer no other
        request before."""
        try:
            state = await self._ask_question("state")
        except DeviceError as error:
            return "" if self._starting else str(error)
        return f"The node is in error: {state.error} Reset the module." if state.error else ""

    async def observe(self) -> dict[str, Any]:
        variables = (await self._ask_question("state")).variables
        return dict(_parse_json(variables) or {})

    async def resources(self) -> dict[str, float]:
        return dict((await self._ask_question("resources")).levels)

    async def reset(self) -> None:
        await self._ask_question("reset", limit_s=self.patience_s)

    async def stop(self) -> None:
        await self._ask_question("stop")

    async def foreign_description(self) -> Description:
        about = await self._ask_question("about")
        actions = [
            {
                "name": action.name,
                "description": action.description,
                "results": [action.has_result] if action.has_result else [],
                "args": [
                    {
                        "name": arg.name,
                        "type": arg.type or "any",
                        "required": not arg.optional,
                        "default": _parse_json(arg.default),
                        "description": arg.description,
                    }
                    for arg in action.args
                ],
            }
            for action in about.actions
        ]
        named = {key: getattr(about, key) for key in ("name", "model", "version", "description")}
        return describe({**named, "actions": actions}, "tcp_node")

    # -- actions -----------------------------------------------------------------------------

    async def begin(self, spec: ActionSpec, name: str, args: dict[str, Any]) -> Any:
        known = current_action.get()
        action = make_schema()["Action"](id=known, action_handle=name)
        sent: dict[str, Any] = {}
        for key, value in args.items():
            if self.is_file(spec, key):
                action.files[key].name = Path(str(value)).name
                action.files[key].content = await read_file(value)
            else:
                sent[key] = self.place(spec, str(value)) if self.is_station(spec, key) else value
        action.action_vars = json.dumps(sent)
        await self.note_handle(known)
        limit_s = self.limit_s(spec)
        sending = asyncio.ensure_future(self._exchange(make_schema()["Request"](action=action), None))
        self._starting += 1
        try:
            response = await self.answer_to(
                sending,
                self._is_busy,
                silent_s=limit_s,
                mute_s=limit_s,
                ended="its outcome is being requested",
            )
        except (NoResponse, OutcomeUnknown):
            return await self._end(name, known)
        finally:
            self._starting -= 1
        progress = _pick_answer(response, "progress")
        if progress.status == RUNNING:
            return await self._end(name, known)
        return self._read_end(name, progress)

    async def find_out(self, spec: ActionSpec, name: str, handle: str) -> Any:
        return await self._end(name, handle)

    async def _end(self, name: str, known: str) -> Any:
        """Ask about an action until it has ended. Raises DeviceError, OutcomeUnknown."""
        silence = Silence(self.patience_s, self.where)
        while True:
            try:
                asking = make_schema()["Request"](ask=make_schema()["Ask"](id=known))
                progress = _pick_answer(await self._exchange(asking, READ_S), "progress")
            except (NoResponse, DeviceError) as error:
                silence.go_on(error)
            else:
                silence.end()
                if progress.id != known:
                    raise OutcomeUnknown(
                        f"the request was about {known}, but the answer is about {progress.id!r}"
                    )
                if progress.status != RUNNING:
                    return self._read_end(name, progress)
            await asyncio.sleep(self.poll_s)

    def _read_end(self, name: str, progress: Any) -> Any:
        if progress.status == SUCCEEDED:
            return _make_result_with_files(progress)
        if progress.status == FAILED:
            raise DeviceError(f"{name}: {progress.error or 'the node says that it failed'}")
        if progress.status == NOT_STARTED:
            raise DeviceError(f"{name}: {progress.error or 'the node refuses it'}", effects="none")
        if progress.status == NOT_KNOWN:
            raise OutcomeUnknown(FORGOTTEN)
        raise OutcomeUnknown(
            f"the node answered the status {progress.status}, which is not an outcome of an action"
        )

    # -- the wire ----------------------------------------------------------------------------

    async def _ask_question(self, what: str, limit_s: float = 0.0) -> Any:
        """Send a request without fields; returns its answer. Raises DeviceError."""
        request = make_schema()["Request"]()
        getattr(request, what).SetInParent()
        try:
            response = await self._exchange(request, limit_s or READ_S)
        except NoResponse as lost:
            effects = "unknown" if what in ("reset", "stop") else "none"
            raise DeviceError(f"{what}: no answer came ({lost}).", effects=effects) from lost
        return _pick_answer(response, "done" if what in ("reset", "stop") else what)

    async def _exchange(self, request: Any, limit_s: float | None) -> Any:
        """Send a request on its own connection; returns the response. Raises DeviceError (``none``) if it was
        not sent, Lost if it may have been carried out."""
        reader, writer = await self._address.open(self.patience_s)
        try:
            writer.write(frame_message(request))
            await writer.drain()
            return await asyncio.wait_for(read_message(reader, make_schema()["Response"]), limit_s)
        except TimeoutError as error:
            raise NoResponse(f"{self.where}: no answer within {limit_s:g} s") from error
        except (OSError, EOFError, ValueError) as error:
            raise NoResponse(f"{self.where}: {str(error) or 'the line was cut'}") from error
        finally:
            writer.close()


def _pick_answer(response: Any, what: str) -> Any:
    """The part of a response that answers the request. Raises DeviceError."""
    found = response.WhichOneof("what")
    if found == "refused":
        raise DeviceError(f"The node refuses: {response.refused.why}", effects="none")
    if found != what:
        raise DeviceError(f"The node answers a request with {found or 'nothing'!r}; {what!r} was expected.")
    return getattr(response, what)


def _make_result_with_files(progress: Any) -> Any:
    """The result with references to the files that came with it."""
    result = _parse_json(progress.result)
    if not progress.files:
        return result
    files = {label: Attachment(file.name or label, file.content) for label, file in progress.files.items()}
    full = result if isinstance(result, dict) else {} if result is None else {"value": result}
    return {**full, "files": files}


def _parse_json(text: str) -> Any:
    """The value of a JSON text; the text itself if it is not JSON."""
    try:
        return read_json_text(text) if text else None
    except ValueError:
        return text

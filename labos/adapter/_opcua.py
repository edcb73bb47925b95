"""The nodes of one OPC UA server, with asyncua. After each lost connection a new client is made, so that no
earlier request is repeated. Methods are called on a connection that waits for their end without a limit.
"""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Callable
from typing import Any

from labos.adapter._channels import ChannelReading, Channels, report_missing_package
from labos.adapter._http import NoResponse
from labos.adapter._opcua_security import OpcuaAccess
from labos.adapter._opcua_types import OpcuaKind, Types, make_plain
from labos.errors import DeviceError

READ_S = 5.0
RETRY_S = 0.5
LONGEST_S = 7 * 24 * 3600.0
"""The longest duration of a method."""

PERIOD_MS = 100.0
"""The sampling interval of a server for a watched value."""

UNTOUCHED = (
    "BadUserAccessDenied",
    "BadNotWritable",
    "BadTypeMismatch",
    "BadInvalidArgument",
    "BadArgumentsMissing",
    "BadTooManyArguments",
    "BadMethodInvalid",
    "BadNodeIdUnknown",
    "BadOutOfRange",
)
"""Statuses of requests that a server has not carried out."""


class UaChannels(Channels):
    """``url`` is the URL of the server. ``namespace`` is the URI for names without one: ``Shaker.State`` is a
    string identifier there, while ``ns=2;s=…`` and ``i=…`` are complete node ids."""

    def __init__(self, url: str, namespace: str, access: OpcuaAccess) -> None:
        try:
            import asyncua
            from asyncua import ua
        except ImportError as error:
            raise report_missing_package(error, "opcua") from error
        # The package has no types that mypy could check.
        self._asyncua: Any = asyncua
        self._ua: Any = ua
        self._url, self._namespace, self._access = url, namespace, access
        self._watched: dict[str, Callable[[ChannelReading | None], None]] = {}
        self._names: dict[Any, str] = {}
        self._kinds: dict[str, OpcuaKind] = {}
        self._client: Any = None
        self._known: dict[Any, OpcuaKind] = {}
        self._why = ""
        self._leaving: set[asyncio.Task[None]] = set()
        self._keeping: asyncio.Task[None] | None = None

    def watch(self, name: str, changed: Callable[[ChannelReading | None], None]) -> None:
        self._watched[name] = changed
        if self._keeping is None:
            self._keeping = asyncio.create_task(self._keep())

    async def close(self) -> None:
        keeping, self._keeping = self._keeping, None
        while keeping is not None and not keeping.done():
            keeping.cancel()  # again: `wait_for` may end at the same moment, and lose the cancellation
            await asyncio.wait({keeping}, timeout=READ_S)
        await asyncio.gather(*self._leaving)

    def why_silent(self) -> str:
        return self._why

    # -- the line ----------------------------------------------------------------------------

    async def _open(self, client: Any) -> None:
        """Raises OSError, ValueError, TimeoutError, UaError."""
        await self._access.prepare(client)
        await client.connect()

    async def _keep(self) -> None:
        """Keep a connection, and make a new one when it is lost."""
        while True:
            client = self._asyncua.Client(self._url, timeout=READ_S)
            try:
                await self._open(client)
                self._client, self._why = client, ""
                await self._subscribe(client)
                while True:
                    await asyncio.sleep(RETRY_S)
                    await client.check_connection()
                    await asyncio.wait_for(client.nodes.server_state.read_value(), READ_S)
            except (OSError, ValueError, TimeoutError, self._ua.UaError) as error:
                self._why = f"The connection reports: {_error_text(error, READ_S)}."
            finally:
                self._client = None
                for changed in self._watched.values():
                    changed(None)
                await _disconnect(client)
            await asyncio.sleep(RETRY_S)

    async def _subscribe(self, client: Any) -> None:
        self._known.clear()  # on another server they may mean something else
        types = Types(client, self._ua, self._known)
        subscription = await client.create_subscription(PERIOD_MS, self)
        for name, changed in self._watched.items():
            node = await self._find_node(client, name)
            try:
                if await node.read_node_class() == self._ua.NodeClass.Method:
                    changed(ChannelReading("a method"))
                    continue
                self._kinds[name] = await types.find(node)
                changed(self._read_value(name, await node.read_data_value(raise_on_bad_status=False)))
                self._names[node.nodeid] = name
                await subscription.subscribe_data_change(node)
            except self._ua.UaStatusCodeError:
                continue  # it does not exist, so it has no value

    def datachange_notification(self, node: Any, value: Any, data: Any) -> None:
        """Called by asyncua when a watched value has changed."""
        name = self._names.get(node.nodeid, "")
        if changed := self._watched.get(name):
            changed(self._read_value(name, data.monitored_item.Value))

    async def _find_node(self, client: Any, name: str) -> Any:
        if "=" in name:
            return client.get_node(name)
        index = await client.get_namespace_index(self._namespace) if self._namespace else 0
        return client.get_node(self._ua.NodeId(name, index))

    # -- values ------------------------------------------------------------------------------

    async def get(self, name: str, timeout_s: float) -> ChannelReading:
        client = self._client
        if client is None:
            raise DeviceError(f"{self._url} does not answer.", effects="none")
        try:
            node = await asyncio.wait_for(self._find_node(client, name), timeout_s)
            data_value = await asyncio.wait_for(node.read_data_value(raise_on_bad_status=False), timeout_s)
        except (OSError, ValueError, TimeoutError, RecursionError, self._ua.UaError) as error:
            why = _error_text(error, timeout_s)
            raise DeviceError(f"{self._url}: {name} does not answer ({why}).", effects="none") from error
        return self._read_value(name, data_value)

    async def put(self, name: str, value: Any, *, callback: bool, on: str = "") -> None:
        client = self._asyncua.Client(self._url, timeout=LONGEST_S)
        try:
            await asyncio.wait_for(self._open(client), READ_S)
            send = await asyncio.wait_for(self._prepare(client, name, value, on), READ_S)
        except (OSError, TimeoutError) as error:
            await _disconnect(client)
            why = f"{self._url} does not answer ({_error_text(error, READ_S)}); nothing was sent to {name}."
            raise DeviceError(why, effects="none") from error
        except (TypeError, ValueError, self._ua.UaError) as error:
            await _disconnect(client)
            why = f"{self._url}: {name} does not accept {value!r} ({_error_text(error, READ_S)})."
            raise DeviceError(why, effects="none") from error
        try:
            await send()
        except self._ua.UaStatusCodeError as error:
            reason = _error_text(error, LONGEST_S)
            effects = "none" if any(word in reason for word in UNTOUCHED) else "unknown"
            raise DeviceError(f"{name} does not accept {value!r} ({reason}).", effects=effects) from error
        except (OSError, TimeoutError, self._ua.UaError) as error:
            raise NoResponse(f"{self._url}: {name}: {_error_text(error, LONGEST_S)}") from error
        finally:
            # A caller that gives up does not wait for the end of the put; closing the adapter does.
            leaving = asyncio.create_task(_disconnect(client))
            self._leaving.add(leaving)
            leaving.add_done_callback(self._leaving.discard)
            await asyncio.shield(leaving)

    async def _prepare(self, client: Any, name: str, value: Any, on: str) -> Callable[[], Any]:
        """The request to call a method or write a variable, with values of the required types."""
        node, types = await self._find_node(client, name), Types(client, self._ua, self._known)
        if await node.read_node_class() != self._ua.NodeClass.Method:
            written = self._ua.DataValue(types.make_variant(await types.find(node), value))
            return lambda: node.write_value(written)
        given = value if isinstance(value, list) else []
        inputs = []
        with contextlib.suppress(self._ua.UaStatusCodeError):  # a method without arguments has none
            inputs = await (await node.get_child("0:InputArguments")).read_value()
        if len(inputs) != len(given):
            raise ValueError(f"the method takes {len(inputs)} arguments")
        sent = []
        for argument, each in zip(inputs, given, strict=True):
            try:
                sent.append(types.make_variant(await types.kind(argument.DataType), each))
            except ValueError as error:
                raise ValueError(f"{argument.Name}: {error}") from error
        owner = await self._find_node(client, on) if on else await self._find_owner(node)
        return lambda: owner.call_method(node, *sent)

    async def _find_owner(self, method: Any) -> Any:
        """The object of a method. Raises ValueError if several objects share it."""
        ids, inverse = self._ua.ObjectIds, self._ua.BrowseDirection.Inverse
        having = await method.get_referenced_nodes(ids.HasComponent, inverse)
        objects = [each for each in having if await each.read_node_class() == self._ua.NodeClass.Object]
        if len(objects) > 1:
            names = ", ".join(each.nodeid.to_string() for each in objects)
            raise ValueError(f"several objects share the method: {names}; write one of them as `object:`")
        return objects[0] if objects else await method.get_parent()

    def _read_value(self, name: str, data_value: Any) -> ChannelReading:
        value = make_plain(data_value.Value.Value) if data_value.Value is not None else None
        kind = self._kinds.get(name)
        label = kind.labels.get(value, "") if kind is not None and isinstance(value, int) else ""
        if kind is not None and kind.labels and isinstance(value, list):
            value = [kind.labels.get(each, each) for each in value]
        status = data_value.StatusCode
        severity = 0 if status is None or status.is_good() else 1 if status.is_uncertain() else 3
        return ChannelReading(value, label, severity)


async def _disconnect(client: Any) -> None:
    """Close a connection that may be broken."""
    with contextlib.suppress(Exception):
        await asyncio.wait_for(client.disconnect(), READ_S)


def _error_text(error: BaseException, limit_s: float) -> str:
    if isinstance(error, TimeoutError):
        return f"no answer within {limit_s:g} s"
    return str(error) or type(error).__name__

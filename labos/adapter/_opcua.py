"""One OPC UA server's nodes, by asyncua.

The client is made anew after each loss of the line: nothing that was asked before is asked again. Methods are
called on a connection that waits for them as long as they take.
"""

from __future__ import annotations

import asyncio
import contextlib
import datetime
from collections.abc import Callable
from typing import Any

from labos.adapter._channels import Lost, Reading, missing_package
from labos.errors import DeviceError

READ_S = 5.0
RETRY_S = 0.5
LONGEST_S = 7 * 24 * 3600.0
"""How long a method may take."""

PERIOD_MS = 100.0
"""How often a server looks whether a watched value has changed."""

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
"""Answers to what a server does not carry out."""


class UaChannels:
    """``url`` is that of the server, ``namespace`` the URI of the names that say none: ``Shaker.State`` is
    the string identifier there, while ``ns=2;s=…`` and ``i=…`` are node ids as they are written."""

    def __init__(self, url: str, namespace: str) -> None:
        try:
            import asyncua
            from asyncua import ua
        except ImportError as error:
            raise missing_package(error, "opcua") from error
        # The package says nothing of its types that mypy could follow.
        self._asyncua: Any = asyncua
        self._ua: Any = ua
        self._url, self._namespace = url, namespace
        self._watched: dict[str, Callable[[Reading | None], None]] = {}
        self._names: dict[Any, str] = {}
        self._client: Any = None
        self._keeping: asyncio.Task[None] | None = None

    def watch(self, name: str, changed: Callable[[Reading | None], None]) -> None:
        self._watched[name] = changed
        if self._keeping is None:
            self._keeping = asyncio.create_task(self._keep())

    async def close(self) -> None:
        if self._keeping is not None:
            self._keeping.cancel()
            with contextlib.suppress(asyncio.CancelledError):
                await self._keeping

    # -- the line ----------------------------------------------------------------------------

    async def _keep(self) -> None:
        """Hold a connection, and make another one when it is lost."""
        while True:
            client = self._asyncua.Client(self._url, timeout=READ_S)
            try:
                await client.connect()
                self._client = client
                await self._subscribe(client)
                while True:
                    await asyncio.sleep(RETRY_S)
                    await client.check_connection()
                    await asyncio.wait_for(client.nodes.server_state.read_value(), READ_S)
            except (OSError, TimeoutError, self._ua.UaError):
                pass  # it is told below, and tried again
            finally:
                self._client = None
                for changed in self._watched.values():
                    changed(None)
                await _let_go(client)
            await asyncio.sleep(RETRY_S)

    async def _subscribe(self, client: Any) -> None:
        subscription = await client.create_subscription(PERIOD_MS, self)
        for name, changed in self._watched.items():
            node = await self._node(client, name)
            try:
                if await node.read_node_class() == self._ua.NodeClass.Method:
                    changed(Reading("a method"))
                    continue
                changed(self._reading(await node.read_data_value(raise_on_bad_status=False)))
                self._names[node.nodeid] = name
                await subscription.subscribe_data_change(node)
            except self._ua.UaStatusCodeError:
                continue  # it is not there: nobody answers for it

    def datachange_notification(self, node: Any, value: Any, data: Any) -> None:
        """What asyncua calls when a watched value has changed."""
        if changed := self._watched.get(self._names.get(node.nodeid, "")):
            changed(self._reading(data.monitored_item.Value))

    async def _node(self, client: Any, name: str) -> Any:
        if "=" in name:
            return client.get_node(name)
        index = await client.get_namespace_index(self._namespace) if self._namespace else 0
        return client.get_node(self._ua.NodeId(name, index))

    # -- values ------------------------------------------------------------------------------

    async def get(self, name: str, timeout_s: float) -> Reading:
        client = self._client
        if client is None:
            raise DeviceError(f"{self._url} does not answer.", effects="none")
        try:
            node = await asyncio.wait_for(self._node(client, name), timeout_s)
            told = await asyncio.wait_for(node.read_data_value(raise_on_bad_status=False), timeout_s)
        except (OSError, ValueError, TimeoutError, RecursionError, self._ua.UaError) as error:
            raise DeviceError(f"{name} does not answer ({_said(error)}).", effects="none") from error
        return self._reading(told)

    async def put(self, name: str, value: Any, *, callback: bool) -> None:
        client = self._asyncua.Client(self._url, timeout=LONGEST_S)
        try:
            await asyncio.wait_for(client.connect(), READ_S)
            send = await asyncio.wait_for(self._prepared(client, name, value), READ_S)
        except (OSError, TypeError, ValueError, TimeoutError, self._ua.UaError) as error:
            await _let_go(client)
            raise DeviceError(f"{name} does not take {value!r} ({_said(error)}).", effects="none") from error
        try:
            await send()
        except self._ua.UaStatusCodeError as error:
            said = _said(error)
            effects = "none" if any(word in said for word in UNTOUCHED) else "unknown"
            raise DeviceError(f"{name} does not take {value!r} ({said}).", effects=effects) from error
        except (OSError, TimeoutError, self._ua.UaError) as error:
            raise Lost(f"{name}: {_said(error)}") from error
        finally:
            await _let_go(client)

    async def _prepared(self, client: Any, name: str, value: Any) -> Callable[[], Any]:
        """The call of a method or the writing of a variable, its values in the types that are wanted."""
        node = await self._node(client, name)
        if await node.read_node_class() != self._ua.NodeClass.Method:
            wanted = await node.read_data_type_as_variant_type()
            written = self._ua.DataValue(self._ua.Variant(value, wanted))
            return lambda: node.write_value(written)
        given = value if isinstance(value, list) else []
        inputs = []
        with contextlib.suppress(self._ua.UaStatusCodeError):  # a method without arguments has none
            inputs = await (await node.get_child("0:InputArguments")).read_value()
        if len(inputs) != len(given):
            raise ValueError(f"the method takes {len(inputs)} arguments")
        kinds = [self._ua.VariantType(told.DataType.Identifier) for told in inputs]
        sent = [self._ua.Variant(each, kind) for each, kind in zip(given, kinds, strict=True)]
        parent = await node.get_parent()
        return lambda: parent.call_method(node, *sent)

    def _reading(self, told: Any) -> Reading:
        value = told.Value.Value if told.Value is not None else None
        if isinstance(value, datetime.datetime):
            value = value.isoformat()
        status = told.StatusCode
        severity = 0 if status is None or status.is_good() else 1 if status.is_uncertain() else 3
        return Reading(value, severity=severity)


async def _let_go(client: Any) -> None:
    """Close a connection that may be gone."""
    with contextlib.suppress(Exception):
        await asyncio.wait_for(client.disconnect(), READ_S)


def _said(error: BaseException) -> str:
    return str(error) or type(error).__name__

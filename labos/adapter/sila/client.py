"""One SiLA 2 server, over gRPC.

A call is sent once: gRPC's own repetitions are switched off. A failure that SiLA reports is distinguished
from a failed connection, after which it is unknown whether the call was carried out.
"""

from __future__ import annotations

import base64
import binascii
import contextlib
from collections.abc import AsyncGenerator
from pathlib import Path
from typing import Any, Literal

from labos.adapter._channels import report_missing_package
from labos.adapter._http import NoResponse
from labos.adapter.sila.features import Basic, Element, Feature, ListOf, Property, SilaCommand, read_feature
from labos.adapter.sila.messages import Messages
from labos.errors import DeviceError

READ_S = 5.0
"""The longest time for a call that moves nothing."""

_SERVICE = ("sila2.org.silastandard.core.silaservice.v1", "SiLAService")
SERVICE = Feature(
    name="SiLAService",
    originator="org.silastandard",
    category="core",
    version=1,
    commands=(
        SilaCommand(
            *_SERVICE,
            "GetFeatureDefinition",
            parameters=(Element("FeatureIdentifier", Basic("String")),),
            responses=(Element("FeatureDefinition", Basic("String")),),
        ),
    ),
    properties=(
        Property(*_SERVICE, "ImplementedFeatures", ListOf(Basic("String"))),
        Property(*_SERVICE, "ServerUUID", Basic("String")),
        Property(*_SERVICE, "ServerName", Basic("String")),
        Property(*_SERVICE, "ServerType", Basic("String")),
        Property(*_SERVICE, "ServerDescription", Basic("String")),
        Property(*_SERVICE, "ServerVersion", Basic("String")),
    ),
)
"""The feature that every server has, and by which its other features are found."""

NOT_CARRIED_OUT = ("UNIMPLEMENTED", "UNAUTHENTICATED", "PERMISSION_DENIED")
"""Statuses of gRPC for calls that did not reach their handler."""

OPTIONS = [
    ("grpc.enable_retries", 0),
    ("grpc.service_config_disable_resolution", 1),
    ("grpc.enable_http_proxy", 0),
    ("grpc.initial_reconnect_backoff_ms", 200),
    ("grpc.min_reconnect_backoff_ms", 200),
    ("grpc.max_reconnect_backoff_ms", 1000),
    ("grpc.max_receive_message_length", 64 * 1024 * 1024),
]

Kind = Literal["validation", "defined", "undefined", "not accepted", "not known", "not finished", "metadata"]
_FRAMEWORK_KINDS: tuple[Kind, ...] = ("not accepted", "not known", "not finished", "metadata", "metadata")


class SilaError(Exception):
    """An error that a server reports; ``identifier`` is that of the parameter or the defined error."""

    def __init__(self, kind: Kind, message: str, identifier: str = "") -> None:
        super().__init__(message)
        self.kind, self.message, self.identifier = kind, message, identifier


class Client:
    """``address`` is ``host:port``. ``certificate`` is the server's own certificate or its signer's (PEM);
    None: the certificates that the computer trusts. ``name`` is the name in it, if this is not the host.
    ``insecure``: without encryption."""

    def __init__(
        self, address: str, *, certificate: bytes | None = None, name: str = "", insecure: bool = False
    ) -> None:
        try:
            import grpc
            import grpc.aio
        except ImportError as error:
            raise report_missing_package(error, "sila") from error
        self._grpc: Any = grpc
        self.address = address
        self.features: list[Feature] = []
        """The server's features besides SiLA's own; empty until they were read."""
        self._messages = Messages([SERVICE])
        options = [*OPTIONS, *([("grpc.ssl_target_name_override", name)] if name else [])]
        if insecure:
            self._channel = grpc.aio.insecure_channel(address, options=options)
        else:
            credentials = grpc.ssl_channel_credentials(root_certificates=certificate)
            self._channel = grpc.aio.secure_channel(address, credentials, options=options)

    async def close(self) -> None:
        await self._channel.close()

    # -- what it is --------------------------------------------------------------------------

    async def check_alive(self) -> None:
        """Check whether the server answers. Raises DeviceError (``none``)."""
        await self.read(SERVICE.properties[1])

    async def learn(self) -> None:
        """Read the server's features; if there are several versions of one, the highest is used. Raises
        DeviceError (``none``)."""
        found: dict[tuple[str, str, str], Feature] = {}
        for name in await self.read(SERVICE.properties[0]):
            if name.split("/")[-2:-1] == [SERVICE.name]:
                continue
            asking = SERVICE.commands[0]
            data = self.encode(asking, {"FeatureIdentifier": name})
            try:
                answer = await self.call(asking, data, limit_s=READ_S)
            except (NoResponse, SilaError) as error:
                raise DeviceError(f"{name} is not described ({error}).", effects="none") from error
            feature = read_feature(answer["FeatureDefinition"])
            known = feature.originator, feature.category, feature.name
            if known not in found or found[known].version < feature.version:
                found[known] = feature
        try:
            messages = Messages([SERVICE, *found.values()])
        except (TypeError, ValueError, KeyError) as error:
            raise DeviceError(
                f"The server's features contradict themselves ({error}).", effects="none"
            ) from error
        self._messages, self.features = messages, list(found.values())

    async def about(self, name: str) -> str:
        """One of the texts in which the server describes itself. Raises DeviceError (``none``)."""
        return str(
            await self.read(next(property_ for property_ in SERVICE.properties if property_.name == name))
        )

    async def read(self, property_: Property) -> Any:
        """The present value of a property. Raises DeviceError (``none``)."""
        path = f"/{property_.package}.{property_.feature}/{property_.method}"
        try:
            if property_.observable:
                async with contextlib.aclosing(self._stream(path, b"", READ_S)) as values:
                    data = await anext(values)
            else:
                data = await self._call(path, b"", READ_S)
            elements = (Element(property_.name, property_.type),)
            return self._messages.decode(property_.package, f"{property_.method}_Responses", elements, data)[
                property_.name
            ]
        except (NoResponse, SilaError, StopAsyncIteration, ValueError) as error:
            raise DeviceError(
                f"{self.address} does not send {property_.feature}.{property_.name} ({error or 'it ended'}).",
                effects="none",
                remedy="Is it running?",
            ) from error

    # -- commands ----------------------------------------------------------------------------

    def encode(self, command: SilaCommand, values: dict[str, Any]) -> bytes:
        """The parameters of a command. Raises DeviceError (``none``)."""
        name = f"{command.name}_Parameters"
        return self._messages.encode(command.package, name, command.parameters, values)

    async def call(self, command: SilaCommand, data: bytes, *, limit_s: float | None) -> dict[str, Any]:
        """Carry out an unobservable command; its responses. Raises SilaError, Lost."""
        return self._decode_responses(command, await self._call(self._make_path(command), data, limit_s))

    async def initiate(self, command: SilaCommand, data: bytes, *, limit_s: float) -> str:
        """Start an observable command; the UUID of its execution. Raises SilaError, Lost."""
        confirmation = await self._call(self._make_path(command), data, limit_s)
        try:
            execution = str(
                self._messages.make_framework_message(
                    "CommandConfirmation", confirmation
                ).commandExecutionUUID.value
            )
        except ValueError as error:
            raise NoResponse(str(error)) from error
        if not execution:
            raise NoResponse("the server gave no UUID")
        return execution

    async def watch_execution(
        self, command: SilaCommand, execution: str, *, limit_s: float
    ) -> AsyncGenerator[int, None]:
        """The status of an execution, now and after each change: 0 waiting, 1 running, 2 finished, 3 failed.
        Raises SilaError, and Lost, also when the time is up."""
        path, asked = f"{self._make_path(command)}_Info", self._encode_execution(execution)
        async with contextlib.aclosing(self._stream(path, asked, limit_s)) as values:
            async for data in values:
                yield (
                    self._messages.make_framework_message("ExecutionInfo", data).commandStatus if data else 0
                )

    async def watch_intermediate(
        self, command: SilaCommand, execution: str
    ) -> AsyncGenerator[dict[str, Any], None]:
        """The intermediate responses of an execution. Raises SilaError, Lost."""
        path, asked = f"{self._make_path(command)}_Intermediate", self._encode_execution(execution)
        name = f"{command.name}_IntermediateResponses"
        async with contextlib.aclosing(self._stream(path, asked, None)) as values:
            async for data in values:
                yield self._messages.decode(command.package, name, command.intermediate, data)

    async def result(self, command: SilaCommand, execution: str) -> dict[str, Any]:
        """The responses of an execution that has ended. Raises SilaError, Lost."""
        data = await self._call(
            f"{self._make_path(command)}_Result", self._encode_execution(execution), READ_S
        )
        return self._decode_responses(command, data)

    def _decode_responses(self, command: SilaCommand, data: bytes) -> dict[str, Any]:
        """Read responses. Raises DeviceError (``all``), because the command was carried out."""
        name = f"{command.name}_Responses"
        try:
            return self._messages.decode(command.package, name, command.responses, data)
        except ValueError as error:
            words = f"{command.full_name} was done, but its responses cannot be read ({error})."
            raise DeviceError(words, effects="all") from error

    def _make_path(self, command: SilaCommand) -> str:
        return f"/{command.package}.{command.feature}/{command.name}"

    def _encode_execution(self, uuid: str) -> bytes:
        data: bytes = self._messages.make_framework_message(
            "CommandExecutionUUID", value=uuid
        ).SerializeToString()
        return data

    # -- the wire ----------------------------------------------------------------------------

    async def _call(self, path: str, data: bytes, limit_s: float | None) -> bytes:
        """Raises SilaError, DeviceError (``none``), Lost."""
        try:
            answer: bytes = await self._channel.unary_unary(path)(data, timeout=limit_s)
        except self._grpc.aio.AioRpcError as error:
            raise self._read(error, path, limit_s) from error
        return answer

    async def _stream(self, path: str, data: bytes, limit_s: float | None) -> AsyncGenerator[bytes, None]:
        call = self._channel.unary_stream(path)(data, timeout=limit_s)
        try:
            async for message in call:
                yield message
        except self._grpc.aio.AioRpcError as error:
            raise self._read(error, path, limit_s) from error
        finally:
            call.cancel()

    def _read(self, error: Any, path: str, limit_s: float | None) -> Exception:
        """The error of a failed call: SilaError, DeviceError (``none``), Lost."""
        called = f"{self.address}: {path.rpartition('.')[2]}"
        code, words = error.code().name, error.details() or ""
        if code == "ABORTED" and (sila_error := self._decode_sila_error(words)):
            return sila_error
        if code in NOT_CARRIED_OUT:
            return DeviceError(f"{self.address} refuses the call: {words or code}.", effects="none")
        if code == "DEADLINE_EXCEEDED" and limit_s is not None:
            return NoResponse(f"{called}: no answer within {limit_s:g} s")
        return NoResponse(f"{called}: {code}: {words}" if words else f"{called}: {code}")

    def _decode_sila_error(self, words: str) -> SilaError | None:
        """SiLA's own error, which is in the message of gRPC."""
        try:
            error = self._messages.make_framework_message("SiLAError", base64.b64decode(words, validate=True))
        except (ValueError, binascii.Error):
            return None
        for field, found in error.ListFields():
            match field.name:
                case "validationError":
                    return SilaError("validation", found.message, found.parameter)
                case "definedExecutionError":
                    return SilaError("defined", found.message, found.errorIdentifier)
                case "undefinedExecutionError":
                    return SilaError("undefined", found.message)
                case "frameworkError" if found.errorType < len(_FRAMEWORK_KINDS):
                    return SilaError(_FRAMEWORK_KINDS[found.errorType], found.message)
        return None


def read_certificate(path: str) -> bytes | None:
    """A certificate from a file; None if none is named. Raises DeviceError (``none``)."""
    if not path:
        return None
    try:
        return Path(path).read_bytes()
    except OSError as error:
        raise DeviceError(
            f"The certificate {path} cannot be read ({error.strerror}).", effects="none"
        ) from error

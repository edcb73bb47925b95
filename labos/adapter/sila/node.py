"""SiLA 2 servers: commands and properties over gRPC, by the feature definitions of the server. The answer to
an observable command comes at once, with the UUID of its execution. The UUID is journalled immediately. With
it, the end can be found out after broken connections and restarts of the adapter, as long as the server keeps
the execution. If the UUID of an observable command or the answer of an unobservable command was lost, its
outcome is unknown. It is never sent again.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
from typing import Any, ClassVar

from labos.adapter._channels import SETTLED, ChannelReading
from labos.adapter._condition_node import ConditionNode
from labos.adapter._foreign import SENT, Silence, read_file
from labos.adapter._http import NoResponse
from labos.adapter.sila.client import Client, SilaError, read_certificate
from labos.adapter.sila.describe import actions_of, find_command, find_property, simplify_name
from labos.adapter.sila.features import SilaCommand
from labos.core.model import ActionSpec, Description
from labos.errors import DeviceError, OutcomeUnknown
from labos.node.files import Attachment
from labos.node.node import Setup
from labos.spec.signals import SilaMapping

START_S = 30.0
"""How long a server may take to say that it has started an observable command."""

WATCH_S = 15.0
"""How long an execution is watched before it is requested again, because a dead connection gives no sign."""

FINISHED, FAILED = 2, 3
"""``ExecutionInfo.CommandStatus``; lower numbers are waiting and running."""

CANCEL = "CancelController.CancelAll"
"""SiLA's own command for a stop, if a server offers it."""

MADSCI_PORT = 50052
"""The port at which MADSci's client expects a server."""

NO_UUID = "the UUID of its execution was never received, and there is no other way to ask"
NO_RECORD = "an unobservable command leaves no record"
FORGOTTEN = "the server does not know the execution: it was restarted, or its lifetime is over"
REFUSED = ("validation", "not accepted", "metadata")
"""Errors that a server reports before it carries out a command."""


class SilaNode(ConditionNode):
    """Config: ``sila_address`` (``host:port``), or ``node_url`` (``sila://host:port``); ``sila_certificate``,
    a file with the server's certificate or its signer's; ``sila_server_name``, the name in it, if that is
    not the host; ``sila_insecure`` for servers without encryption; ``sila`` (the mapping)."""

    mapping: SilaMapping
    trusts_the_line: ClassVar[bool] = False
    """The default for connecting without encryption."""

    def __init__(self, setup: Setup) -> None:
        super().__init__(setup)
        self.mapping = SilaMapping()
        self._client: Client | None = None
        self._learned = False

    @property
    def client(self) -> Client:
        if self._client is None:
            raise DeviceError("The adapter is not connected.", effects="none")
        return self._client

    @property
    def where(self) -> str:
        return self.client.address

    async def connect(self) -> None:
        config = self.setup.config
        self.mapping = self.read_table("sila", SilaMapping, config.get("sila") or {})
        address = str(config.get("sila_address") or config.get("node_url") or "")
        address = self.complete(address.removeprefix("sila://").rstrip("/"))
        if not address:
            raise DeviceError("`config:` has no `sila_address`.", effects="none")
        certificate = read_certificate(str(config.get("sila_certificate") or ""))
        await self.close()
        self._client = Client(
            address,
            certificate=certificate,
            name=str(config.get("sila_server_name") or ""),
            insecure=bool(config.get("sila_insecure", self.trusts_the_line and certificate is None)),
        )

    def complete(self, address: str) -> str:
        """The address with its port."""
        return address

    async def close(self) -> None:
        client, self._client, self._learned = self._client, None, False
        if client is not None:
            await client.close()

    # -- how it is ---------------------------------------------------------------------------

    async def is_idle(self) -> bool:
        """By the properties of the mapping. Without them, the server is idle if it answers and no action can
        still be under way."""
        await self._learn()
        if not self.reports_busy:
            await self.client.check_alive()
        return await super().is_idle()

    async def trouble(self) -> str:
        try:
            await self._learn()
            await self.client.check_alive()
            return self._describe_absent() or await self._describe_error()
        except DeviceError as silent:
            self._learned = False
            return str(silent)

    async def learn(self) -> None:
        """Also checks that the server answers; otherwise no command is sent."""
        await self._learn()
        await self.client.check_alive()

    async def _is_known(self) -> bool:
        await self._learn()
        return True

    async def _learn(self) -> None:
        if not self._learned:
            await self.client.learn()
            with contextlib.suppress(DeviceError):
                self.note_version(await self.client.about("ServerVersion"))
            self._learned = True

    def _describe_absent(self) -> str:
        """The features in the mapping that the server does not have, as a sentence."""
        features = self.client.features
        if absent := self.describe_missing(lambda name: find_command(features, name) is not None):
            return absent
        lacking = [name for name in sorted(self.mapping.properties) if find_property(features, name) is None]
        lacking += [
            name
            for name in (self.mapping.reset, self.mapping.stop)
            if name and find_command(features, name) is None
        ]
        return f"The server does not offer {', '.join(lacking)}. Correct `sila:`." if lacking else ""

    async def _describe_error(self) -> str:
        state = self.mapping.state
        for condition in state.error:
            if await self.is_fulfilled(condition):
                seen = await self._read_property(state.why or condition.pv)
                words = seen if state.why else f"{condition.pv} is {seen}"
                return f"The device is in error: {words}. Reset the module."
        return ""

    async def observe(self) -> dict[str, Any]:
        self.look()
        await self._learn()
        return await super().observe()

    async def resources(self) -> dict[str, float]:
        await self._learn()
        return await super().resources()

    async def read(self, name: str) -> ChannelReading:
        return ChannelReading(await self._read_property(name))

    async def _read_property(self, name: str) -> Any:
        """The present value of a property, or an element of it. Raises DeviceError (``none``)."""
        found = find_property(self.client.features, name)
        if found is None:
            raise DeviceError(f"The server has no property {name!r}.", effects="none")
        property_, elements = found
        value = await self.client.read(property_)
        for element in elements:
            if not isinstance(value, dict) or element not in value:
                raise DeviceError(f"The property {name!r} has no {element!r}.", effects="none")
            value = value[element]
        return value

    # -- recovery ----------------------------------------------------------------------------

    async def reset(self) -> None:
        if self.mapping.reset:
            await self._carry_out_command(self.mapping.reset)
        self.believe_at_rest()

    async def stop(self) -> None:
        """The command in the mapping, else SiLA's own command to cancel all commands."""
        await self._learn()
        if not self.mapping.stop and find_command(self.client.features, CANCEL) is None:
            raise DeviceError("`sila:` does not define how the device is stopped.", effects="none")
        await self._carry_out_command(self.mapping.stop or CANCEL)

    async def _carry_out_command(self, name: str) -> None:
        """Carry out a command without parameters, and wait for its end. Raises DeviceError."""
        await self.learn()
        command = self._command(name)
        try:
            data = self.client.encode(command, self._make_values(command, {}))
            if not command.observable:
                await self.client.call(command, data, limit_s=self.patience_s)
                return
            execution = await self.client.initiate(command, data, limit_s=START_S)
            await self._end(command, execution)
        except (NoResponse, OutcomeUnknown) as lost:
            raise DeviceError(f"{name}: no answer came ({lost}).") from lost
        except SilaError as error:
            raise self._make_failure(name, error) from error

    # -- actions -----------------------------------------------------------------------------

    async def begin(self, spec: ActionSpec, name: str, args: dict[str, Any]) -> Any:
        command = self._command(name)
        given = {
            key: await read_file(value) if self.is_file(spec, key) else value
            for key, value in self.name_places(spec, args).items()
        }
        data = self.client.encode(command, self._make_values(command, given))
        await self.note_handle(SENT)
        try:
            if not command.observable:
                return _make_result_with_files(await self._answer(spec, command, data))
            execution = await self.client.initiate(command, data, limit_s=START_S)
        except SilaError as error:
            raise self._make_failure(command.full_name, error) from error
        except NoResponse as lost:
            await self._wait_until_at_rest()
            why = NO_UUID if command.observable else NO_RECORD
            raise OutcomeUnknown(f"its answer was lost ({lost}); {why}") from lost
        await self.note_handle(execution)
        return await self._read_outcome(spec, command, execution)

    async def find_out(self, spec: ActionSpec, name: str, handle: str) -> Any:
        if handle == SENT:
            await self._wait_until_at_rest()
            raise OutcomeUnknown(f"the adapter was restarted before an answer came; {NO_UUID}")
        await self.wait_until(self._is_known, 1)
        return await self._read_outcome(spec, self._command(name), handle)

    def _command(self, name: str) -> SilaCommand:
        """Raises DeviceError (``none``)."""
        command = find_command(self.client.features, name)
        if command is None:
            raise DeviceError(
                f"The server has no command {name!r}, or several with this name.",
                effects="none",
                remedy="Write `Feature.Command` below `actions:` in `config:`.",
            )
        return command

    def _make_values(self, command: SilaCommand, given: dict[str, Any]) -> dict[str, Any]:
        """The arguments by names of parameters. SiLA's parameters have no defaults, so all must be given.
        Raises DeviceError (``none``)."""
        meant = {simplify_name(element.name): element.name for element in command.parameters}
        unknown = [name for name in given if simplify_name(name) not in meant]
        values = {
            meant[simplify_name(name)]: value for name, value in given.items() if simplify_name(name) in meant
        }
        lacking = [name for name in meant.values() if name not in values]
        if unknown or lacking:
            wrong = [f"has no {name!r}" for name in unknown] + [f"needs {name!r}" for name in lacking]
            raise DeviceError(f"{command.full_name} {', '.join(wrong)}.", effects="none")
        return values

    async def _answer(self, spec: ActionSpec, command: SilaCommand, data: bytes) -> dict[str, Any]:
        """The responses of an unobservable command. During the wait, the server is asked whether it answers
        and is busy. Raises SilaError, Lost, OutcomeUnknown."""

        async def at_work() -> bool:
            if not self.reports_busy:
                await self.client.check_alive()
            return self.reports_busy and not await self.is_idle()

        return await self.answer_to(
            asyncio.ensure_future(self.client.call(command, data, limit_s=None)),
            at_work,
            silent_s=self.patience_s,
            mute_s=self.limit_s(spec),
            ended=NO_RECORD,
        )

    async def _read_outcome(self, spec: ActionSpec, command: SilaCommand, execution: str) -> Any:
        """The result of an execution, with its intermediate responses if these should be stored."""
        if spec.name not in self.mapping.intermediate or not command.intermediate:
            return _make_result_with_files(await self._end(command, execution))
        responses: list[dict[str, Any]] = []
        listening = asyncio.ensure_future(self._listen(command, execution, responses))
        try:
            result = _make_result_with_files(await self._end(command, execution))
            # The last reported responses may still be on their way.
            await asyncio.wait({listening}, timeout=self.poll_s)
        finally:
            listening.cancel()
        return _add_files(result, {"intermediate": _write_lines(responses)})

    async def _listen(self, command: SilaCommand, execution: str, responses: list[dict[str, Any]]) -> None:
        """Store the intermediate responses of an execution; those during a broken connection are lost."""
        while True:
            try:
                first = True  # the first value after subscribing repeats the last one
                async for values in self.client.watch_intermediate(command, execution):
                    if not (first and responses and responses[-1] == values):
                        responses.append(values)
                    first = False
                return
            except SilaError:
                return
            except (NoResponse, ValueError):
                await asyncio.sleep(self.poll_s)

    async def _end(self, command: SilaCommand, execution: str) -> dict[str, Any]:
        """Watch an execution until it has ended; its responses. Raises DeviceError, OutcomeUnknown."""
        silence = Silence(self.patience_s, self.where)
        while True:
            over = False
            try:
                watching = self.client.watch_execution(command, execution, limit_s=WATCH_S)
                async with contextlib.aclosing(watching) as infos:
                    async for status in infos:
                        if over := status in (FINISHED, FAILED):
                            break
                        silence.end()
                return await self.client.result(command, execution)
            except SilaError as error:
                if error.kind == "not known":
                    raise OutcomeUnknown(FORGOTTEN) from error
                if error.kind != "not finished":
                    raise self._make_failure(command.full_name, error, began=True) from error
                if over:  # the server contradicts itself
                    silence.go_on(error)
                else:
                    silence.end()
            except (NoResponse, ValueError) as lost:
                silence.go_on(lost)
            except DeviceError as refused:
                if refused.effects != "none":
                    raise
                silence.go_on(refused)  # the query was refused, which shows nothing about the execution
            await asyncio.sleep(self.poll_s)

    async def _wait_until_at_rest(self) -> None:
        """Wait while the device is busy; it may not have started the last command yet. Raises OutcomeUnknown
        if the server does not answer."""
        await self.wait_until(self.is_idle, SETTLED if self.mapping.state.busy else 1)

    def _make_failure(self, what: str, error: SilaError, *, began: bool = False) -> DeviceError:
        """The failure that a server reports for a command. Its effects are unknown, unless the server refused
        the command or the mapping has the error."""
        bare = error.identifier.rpartition("/")[2]
        untouched = (error.kind in REFUSED and not began) or (
            error.kind == "defined" and bare in self.mapping.harmless
        )
        words = f"{bare}: {error.message}" if bare else error.message or error.kind
        return DeviceError(f"{what}: {words}", effects="none" if untouched else "unknown")

    # -- what it says of itself --------------------------------------------------------------

    async def foreign_description(self) -> Description:
        await self.learn()
        client = self.client
        return Description(
            driver="sila_node",
            version=await client.about("ServerVersion"),
            description=await client.about("ServerDescription"),
            models=(await client.about("ServerType"),),
            actions=actions_of(client.features),
        )


class MadsciSilaNode(SilaNode):
    """A SiLA node in the way of MADSci, whose files contain only a URL: without encryption unless a
    certificate is named, and at port 50052 unless another port is named."""

    trusts_the_line = True

    def complete(self, address: str) -> str:
        _, colon, port = address.rpartition(":")
        return address if not address or (colon and port.isdecimal()) else f"{address}:{MADSCI_PORT}"


def _make_result_with_files(responses: dict[str, Any]) -> Any:
    """A result: values by the names of the responses, with references for files."""
    files = {name: Attachment(name, value) for name, value in responses.items() if isinstance(value, bytes)}
    plain = {name: value for name, value in responses.items() if name not in files}
    return _add_files(plain or None, files) if files else plain or None


def _add_files(result: Any, files: dict[str, Attachment]) -> dict[str, Any]:
    """A result with more files."""
    full = dict(result) if isinstance(result, dict) else {}
    return {**full, "files": {**full.get("files", {}), **files}}


def _write_lines(responses: list[dict[str, Any]]) -> Attachment:
    """Values as lines of JSON."""
    lines = [json.dumps(values, default=lambda value: value.hex()) + "\n" for values in responses]
    return Attachment("intermediate.jsonl", "".join(lines).encode())

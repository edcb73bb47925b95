"""Devices whose state is a set of values by name: process variables of EPICS, nodes of OPC UA.

A mapping (``labos.spec.signals``) defines their meaning. A put has no id, and the server keeps no history.
Therefore a start is sent once, and after a lost answer the outcome is unknown. There are two exceptions. If
the condition ``done`` of an action contains the action's id, the device's report counts in any case. If
``boot`` shows that the server was not restarted, the adapter continues to wait for an accepted start after a
broken connection.
"""

from __future__ import annotations

import asyncio
import io
from functools import partial
from typing import Any, ClassVar

import msgspec

from labos.adapter._channels import (
    SETTLED,
    SEVERITIES,
    ChannelReading,
    Channels,
    is_fulfilled,
    report_missing_package,
)
from labos.adapter._condition_node import ConditionNode
from labos.adapter._http import NoResponse
from labos.adapter._placeholders import fill
from labos.core.model import ActionSpec
from labos.errors import DeviceError, OutcomeUnknown
from labos.node.files import Attachment
from labos.node.node import Setup, current_action
from labos.spec.signals import Actuation, Condition, Protocol, Put, SignalMapping

CONNECT_S = 5.0
"""How long to search for a process variable before it counts as missing."""

RESTARTED = "its server was restarted meanwhile, and keeps no record of actions"
NOT_KEPT = "its callback was lost ({why}), and nothing keeps a record of what was done"


class Started(msgspec.Struct, omit_defaults=True):
    """The data of a start in the journal. ``taken``: a server that was started at ``boot`` has accepted it.
    The conditions for its end have the arguments filled in."""

    taken: bool = False
    boot: Any = None
    done: list[dict[str, Any]] = []


class SignalNode(ConditionNode):
    """Base of the adapters; ``table`` is the key of ``config`` with the mapping."""

    table: ClassVar[str]
    mapping: SignalMapping

    def __init__(self, setup: Setup) -> None:
        super().__init__(setup)
        self._channels: dict[Protocol, Channels] = {}
        self._now: dict[str, ChannelReading | None] = {}
        self._changed = asyncio.Event()
        self._losses = 0

    async def connect(self) -> None:
        self.mapping = self.read_table(self.table, SignalMapping, self.read_mapping())
        self.check_started(self.table, self.mapping.actions.get)
        await self.close()
        for name in sorted(_list_names(self.mapping)):
            protocol, whole = self.mapping.find(name)
            if whole not in self._now:
                self._now[whole] = None
                self._find_client(protocol).watch(whole, partial(self._note_reading, whole))
        await self._wait_until_connected(CONNECT_S)

    async def close(self) -> None:
        channels, self._channels, self._now = self._channels, {}, {}
        for each in channels.values():
            await each.close()

    def read_mapping(self) -> dict[str, Any]:
        """The mapping from the workcell file."""
        return dict(self.setup.config.get(self.table) or {})

    def client(self, protocol: Protocol) -> Channels:
        """A client for a protocol. Raises DeviceError."""
        raise NotImplementedError

    def _find_client(self, protocol: Protocol) -> Channels:
        """The client for a protocol; loaded when it is first needed."""
        if protocol not in self._channels:
            self._channels[protocol] = self.client(protocol)
        return self._channels[protocol]

    def _note_reading(self, name: str, reading: ChannelReading | None) -> None:
        if reading is None and self._now.get(name) is not None:
            self._losses += 1
        self._now[name] = reading
        self._changed.set()

    def _list_silent(self) -> str:
        return ", ".join(sorted(name for name, reading in self._now.items() if reading is None))

    async def _wait_until_connected(self, limit_s: float) -> bool:
        """Wait until all process variables answer; returns whether they do."""
        loop = asyncio.get_running_loop()
        until = loop.time() + limit_s
        while self._list_silent() and loop.time() < until:
            await self._change(until - loop.time())
        return not self._list_silent()

    async def _change(self, limit_s: float) -> None:
        """Wait for any change, at most this long."""
        self._changed.clear()
        try:
            await asyncio.wait_for(self._changed.wait(), max(limit_s, 0.001))
        except TimeoutError:
            return

    # -- how it is ---------------------------------------------------------------------------

    async def is_idle(self) -> bool:
        return not self._list_silent() and await super().is_idle()

    async def trouble(self) -> str:
        if absent := self._list_silent():
            whys = [why for each in self._channels.values() if (why := each.why_silent())]
            return " ".join([f"There is no answer for {absent}. Is {self.where} running?", *whys])
        return self._describe_error()

    def _describe_error(self) -> str:
        """The last reported error of the device; empty if none."""
        state = self.mapping.state
        limit = SEVERITIES.index(state.severity)
        for name in state.alarms:
            reading = self._find_last(name)
            if reading is not None and reading.severity >= limit:
                value = reading.plain
                return f"{name} has an alarm ({SEVERITIES[min(reading.severity, 3)]}, value {value})."
        for condition in state.error:
            reading = self._find_last(condition.pv)
            if reading is not None and is_fulfilled(condition, reading):
                why = self._find_last(state.why) if state.why else None
                words = (why.label or why.value) if why is not None else f"{condition.pv} is {reading.value}"
                return f"The device is in error: {words}. Reset the module."
        return ""

    def _is_working(self) -> bool:
        """Whether the device has last reported that it is busy."""
        readings = [(condition, self._find_last(condition.pv)) for condition in self.mapping.state.busy]
        return any(now is not None and is_fulfilled(condition, now) for condition, now in readings)

    def _find_last(self, name: str) -> ChannelReading | None:
        return self._now.get(self.mapping.find(name)[1])

    async def read(self, name: str) -> ChannelReading:
        protocol, whole = self.mapping.find(name)
        return await self._find_client(protocol).get(whole, CONNECT_S)

    # -- recovery ----------------------------------------------------------------------------

    async def reset(self) -> None:
        await self._put_all(self.mapping.reset)
        self.believe_at_rest()

    async def stop(self) -> None:
        if not self.mapping.stop:
            raise DeviceError(f"`{self.table}:` does not define how the device is stopped.", effects="none")
        await self._put_all([put.model_copy(update={"callback": False}) for put in self.mapping.stop])

    async def _put_all(self, puts: list[Put]) -> None:
        for put in puts:
            try:
                await self._put(put, {}, self.patience_s)
            except NoResponse as lost:
                raise DeviceError(f"{put.pv}: no answer came ({lost}).") from lost

    # -- actions -----------------------------------------------------------------------------

    async def begin(self, spec: ActionSpec, name: str, args: dict[str, Any]) -> Any:
        actuation = self.mapping.actions[spec.name]
        values = {**self.name_places(spec, args), "id": current_action.get()}
        if absent := self._list_silent():
            raise DeviceError(f"There is no answer for {absent} ({self.where}).", effects="none")
        ends_by = [_fill_in(condition, values, self.table) for condition in actuation.done]
        start = actuation.start.model_copy(update={"value": fill(actuation.start.value, values, self.table)})
        try:
            for put in actuation.set:
                await self._put(put, values, self.patience_s)
        except (NoResponse, DeviceError) as error:
            raise DeviceError(f"{spec.name} was not started: {error}", effects="none") from error
        ends = [condition.model_dump(by_alias=True, exclude_defaults=True) for condition in ends_by]
        started = Started(boot=await self._read_boot(), done=ends)
        losses = self._losses
        await self.note_handle(msgspec.json.encode(started).decode())
        try:
            await self._put(start, values, self._find_limit_s(spec, actuation))
        except NoResponse as lost:
            await self._see_proof(spec, actuation, ends_by, NOT_KEPT.format(why=lost))
            return await self._read_result(actuation)
        if ends_by or actuation.failed:
            started.taken = True
            await self.note_handle(msgspec.json.encode(started).decode())
            await self._see_done(spec, actuation, ends_by, started.boot, losses)
        return await self._read_result(actuation)

    async def find_out(self, spec: ActionSpec, name: str, handle: str) -> Any:
        actuation = self.mapping.actions[spec.name]
        started = msgspec.json.decode(handle, type=Started)
        ends_by = [Condition.model_validate(written) for written in started.done]
        if actuation.is_proven:
            await self._see_proof(spec, actuation, ends_by, "the adapter was restarted meanwhile")
        elif started.taken:
            await self._see_done(spec, actuation, ends_by, started.boot, self._losses - 1)
        else:
            await self._wait_until_connected(self.patience_s)
            raise OutcomeUnknown("the adapter was restarted meanwhile, and nothing keeps a record of it")
        return await self._read_result(actuation)

    async def _put(self, put: Put, values: dict[str, Any], limit_s: float) -> None:
        """Send a put once, and wait for its callback, the loss of the connection, or ``limit_s`` without a
        report of work. Raises DeviceError, Lost."""
        protocol, whole = self.mapping.find(put.pv)
        losses, loop = self._losses, asyncio.get_running_loop()
        working = loop.time()
        value = fill(put.value, values, self.table)
        owner = self.mapping.find(put.object)[1] if put.object else ""
        putting = self._find_client(protocol).put(whole, value, callback=put.callback, on=owner)
        sending = asyncio.ensure_future(putting)
        try:
            while not sending.done():
                changed = asyncio.ensure_future(self._change(self.poll_s))
                await asyncio.wait({sending, changed}, return_when=asyncio.FIRST_COMPLETED)
                changed.cancel()
                if self._losses != losses and not sending.done():
                    raise NoResponse(f"{put.pv}: {self.where} was lost")
                working = loop.time() if self._is_working() else working
                if loop.time() - working > limit_s and not sending.done():
                    raise NoResponse(f"{put.pv}: {self.where} has not answered the put for {limit_s:.0f} s")
            sending.result()
        finally:
            sending.cancel()

    async def _see_done(
        self, spec: ActionSpec, actuation: Actuation, ends_by: list[Condition], boot: Any, losses: int
    ) -> None:
        """Wait for the end of a started action. ``losses`` is the number of broken connections up to the
        start. After another one, the end counts only if the server was not restarted. Raises DeviceError,
        OutcomeUnknown."""
        limit_s = self._find_limit_s(spec, actuation)
        until = asyncio.get_running_loop().time() + limit_s
        while True:
            if self._list_silent() and not await self._wait_until_connected(self.patience_s):
                raise OutcomeUnknown(f"there is no answer for {self._list_silent()}")
            if self._losses != losses and not actuation.is_proven:
                losses = self._losses
                await self._see_same_server(boot)
            if await self._has_ended(spec, actuation, ends_by):
                return
            if asyncio.get_running_loop().time() > until:
                waited = ", ".join(condition.pv for condition in ends_by)
                raise OutcomeUnknown(
                    f"{spec.name} was started, but did not end within {limit_s:.0f} s (by {waited})"
                )
            await self._change(self.poll_s)

    async def _see_same_server(self, boot: Any) -> None:
        """Check after a broken connection. Raises OutcomeUnknown unless it is the same server that got the
        start."""
        try:
            now = await self._read_boot()
        except DeviceError as error:
            raise OutcomeUnknown(NOT_KEPT.format(why=error)) from error
        if boot is None or now != boot:
            raise OutcomeUnknown(
                RESTARTED if boot is not None else NOT_KEPT.format(why="the line was broken")
            )

    async def _has_ended(self, spec: ActionSpec, actuation: Actuation, ends_by: list[Condition]) -> bool:
        """Raises DeviceError if it failed."""
        try:
            failed = [condition.pv for condition in actuation.failed if await self.is_fulfilled(condition)]
            done = all([await self.is_fulfilled(condition) for condition in ends_by])
        except DeviceError:
            return False  # the connection is lost; it is checked before the next time
        if failed:
            raise DeviceError(f"{spec.name} failed: {self._describe_error() or ', '.join(failed)}")
        return done

    async def _see_proof(
        self, spec: ActionSpec, actuation: Actuation, ends_by: list[Condition], why: str
    ) -> None:
        """Wait until the device reports this action by its id as done, after its callback was lost or the
        adapter was restarted. Raises OutcomeUnknown."""
        if not actuation.is_proven:
            raise OutcomeUnknown(why)
        if not await self._wait_until_connected(self.patience_s):
            raise OutcomeUnknown(f"{why}; there is no answer for {self._list_silent()}")
        loop = asyncio.get_running_loop()
        idle, until = 0, loop.time() + self._find_limit_s(spec, actuation)
        while True:
            try:
                if all([await self.is_fulfilled(condition) for condition in ends_by]):
                    return
                idle = idle + 1 if await self.is_idle() else 0
            except DeviceError:
                idle = 0
            if (self.mapping.state.busy and idle >= SETTLED) or loop.time() > until:
                raise OutcomeUnknown(f"{why}; the device does not report it as done")
            await asyncio.sleep(self.poll_s)

    def _find_limit_s(self, spec: ActionSpec, actuation: Actuation) -> float:
        return actuation.timeout or self.limit_s(spec)

    async def _read_boot(self) -> Any:
        return (await self.read(self.mapping.boot)).value if self.mapping.boot else None

    async def _read_result(self, actuation: Actuation) -> Any:
        """Read the result at the end. An alarm then is a failure, because it is not known how far the action
        got."""
        try:
            if isinstance(actuation.result, dict):
                result: Any = {key: (await self.read(name)).plain for key, name in actuation.result.items()}
            else:
                result = (await self.read(actuation.result)).plain if actuation.result else None
            if actuation.files:
                files = {
                    key: encode_array(key, await self.read(name)) for key, name in actuation.files.items()
                }
                result = {**(result or {}), **files}
            # The last report of its state may be older than the end.
            state = self.mapping.state
            for name in {*state.alarms, *(error.pv for error in state.error), state.why} - {""}:
                self._note_reading(self.mapping.find(name)[1], await self.read(name))
        except DeviceError as unread:
            words = f"It was done, but its result cannot be read: {unread}"
            raise DeviceError(words, effects="all") from unread
        if error := self._describe_error():
            raise DeviceError(f"It ended, and then: {error}")
        return result


def encode_array(name: str, reading: ChannelReading) -> Attachment:
    """An array in the file format of numpy. Raises DeviceError if it is not an array of numbers."""
    try:
        import numpy
    except ImportError as error:
        raise report_missing_package(error) from error
    values = numpy.asarray(reading.value)
    if values.dtype.kind not in "buif":
        raise DeviceError(f"{name} is not an array of numbers.", effects="all")
    if values.dtype.kind in "ui" and values.size and values.min() >= 0 and values.max() < 256:
        values = values.astype("uint8")
    content = io.BytesIO()
    numpy.save(content, values.reshape(-1), allow_pickle=False)
    return Attachment(f"{name}.npy", content.getvalue())


def _list_names(mapping: SignalMapping) -> set[str]:
    """All names of process variables in a mapping."""
    state = mapping.state
    names = {*state.alarms, *mapping.resources.values(), *mapping.observe.values()}
    names |= {put.pv for put in (*mapping.reset, *mapping.stop)}
    names |= {condition.pv for condition in (*state.busy, *state.error, *mapping.labware.values())}
    for action in mapping.actions.values():
        names |= {action.start.pv, *(put.pv for put in action.set)}
        names |= {condition.pv for condition in (*action.done, *action.failed)}
        names |= set(action.result.values()) if isinstance(action.result, dict) else {action.result}
    return {name for name in (*names, mapping.boot, state.why) if name}


def _fill_in(condition: Condition, values: dict[str, Any], table: str) -> Condition:
    filled = {"is_": fill(condition.is_, values, table), "near": fill(condition.near, values, table)}
    return condition.model_copy(update=filled)

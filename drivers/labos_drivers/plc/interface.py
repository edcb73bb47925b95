"""The node of a PLC. Its actions come from its mapping."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any, ClassVar

import msgspec

from labos.core.model import ActionSpec, Description
from labos.errors import DeviceError, OutcomeUnknown
from labos.node import Node, action, current_action
from labos.node.mapping import read_table
from labos.node.node import INTERRUPTED, ActionMethod
from labos_drivers._wired import ReportsTrouble
from labos_drivers.plc.about import KEY, TABLE, describe
from labos_drivers.plc.driver import PlcDriver, StartedAction
from labos_drivers.plc.mapping import PlcMapping
from labos_drivers.plc.simulator import MappedSimulator
from labos_drivers.plc.wire import HatchOnTcp

HATCH = Path(__file__).with_name("hatch.yaml")
"""The mapping of the simulated PLC that comes with the driver."""

NEVER_SENT = "The node was restarted before it passed the action on."


@cache
def hatch() -> PlcMapping:
    mapping: PlcMapping = read_table(TABLE, str(HATCH))
    return mapping


class Plc(ReportsTrouble):
    """PLC with a Modbus interface; without a mapping of its own it is the hatch that comes with it."""

    driver = KEY
    config_table = TABLE
    own: ClassVar[PlcMapping | None] = None
    device: MappedSimulator | PlcDriver

    @classmethod
    def mapping(cls) -> PlcMapping:
        """The mapping of this module's PLC; that of the hatch if the module has none of its own."""
        return cls.own or hatch()

    @classmethod
    def describe(cls) -> Description:
        return describe(cls.mapping())

    @classmethod
    def for_config(cls, config: dict[str, Any]) -> type[Node]:
        if KEY not in config:
            return cls
        return type(cls.__name__, (cls,), {"own": read_table(TABLE, config[KEY])})

    async def connect(self) -> None:
        mapping = self.mapping()
        if self.setup.wire and self.own is not None:
            # Only the hatch can be simulated behind a wire; a module with its own mapping is not.
            self.setup = msgspec.structs.replace(self.setup, wire=False)
        on_bench = type("OnBench", (MappedSimulator,), {"mapping": mapping})
        self.devices = (on_bench, HatchOnTcp, type("Driver", (PlcDriver,), {"mapping": mapping}))  # type: ignore[misc]
        await super().connect()

    # -- actions -----------------------------------------------------------------------------

    def methods(self) -> dict[str, ActionMethod]:
        found = {spec.name: self._method(spec) for spec in self.describe().actions if spec.name != "reset"}
        return found | {"reset": self.reset}

    def _method(self, spec: ActionSpec) -> ActionMethod:
        async def carry_out(**kwargs: Any) -> Any:
            return await self.carry_out(spec, kwargs)

        return carry_out

    async def carry_out(self, spec: ActionSpec, kwargs: dict[str, Any]) -> Any:
        """Carry out an action of the mapping; returns its result. Raises DeviceError, OutcomeUnknown."""
        args = {arg.name: arg.default for arg in spec.args if not arg.required} | kwargs
        device, action = self.device, self.mapping().actions[spec.name]
        if isinstance(device, MappedSimulator):
            return await device.do(spec.name, args)
        if action.only_reads:
            return await device.read(action)
        begun = await device.prepare(spec.name, args, current_action.get())
        with device.motion():
            await self.note_handle(msgspec.json.encode(begun).decode())
            sure = await device.start(spec.name, begun)
            if begun.boot is not None:
                await self.note_handle(msgspec.json.encode(begun).decode())
            return await device.await_end(spec.name, begun, sure=sure)

    async def take_up(self, name: str, handle: str) -> Any:
        """Wait for the end of an attempt that was in progress when the node died; returns its result. Nothing
        is started, but a number that the PLC does not accept is withdrawn. Raises DeviceError,
        OutcomeUnknown."""
        action = self.mapping().actions.get(name)
        if action is None or action.only_reads or isinstance(self.device, MappedSimulator):
            raise OutcomeUnknown(INTERRUPTED)
        if not handle:
            raise DeviceError(NEVER_SENT, effects="none")
        with self.device.motion():
            begun = msgspec.json.decode(handle, type=StartedAction)
            return await self.device.await_end(name, begun, sure=False)

    # -- the module --------------------------------------------------------------------------

    async def resources(self) -> dict[str, float]:
        if isinstance(self.device, MappedSimulator):
            return {}
        return await self.device.read_levels()

    @action(recovers=True)
    async def reset(self) -> None:
        """Bring the PLC out of an error."""
        await super().reset()

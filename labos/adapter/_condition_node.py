"""The common part of the adapters whose mapping has conditions on values by name."""

from __future__ import annotations

from typing import Any

from labos.adapter._channels import ChannelReading, is_fulfilled, leaves_open
from labos.adapter._foreign import ForeignNode
from labos.spec.signals import Condition, DeviceMapping


class ConditionNode(ForeignNode):
    """Observes a device, and finds out whether it is idle, by the conditions of ``mapping``."""

    mapping: DeviceMapping

    async def read(self, name: str) -> ChannelReading:
        """The present value, not the last reported one. Raises DeviceError."""
        raise NotImplementedError

    async def is_fulfilled(self, condition: Condition) -> bool:
        return is_fulfilled(condition, await self.read(condition.pv))

    @property
    def reports_busy(self) -> bool:
        return bool(self.mapping.state.busy)

    async def is_idle(self) -> bool:
        if not self.reports_busy:
            return await super().is_idle()
        seen = [(condition, await self.read(condition.pv)) for condition in self.mapping.state.busy]
        return not any(is_fulfilled(condition, now) or leaves_open(condition, now) for condition, now in seen)

    async def observe(self) -> dict[str, Any]:
        self.look()
        seen = {variable: (await self.read(name)).plain for variable, name in self.mapping.observe.items()}
        if self.mapping.labware:
            places = self.mapping.labware.items()
            readings = [(at, condition, await self.read(condition.pv)) for at, condition in places]
            seen["labware"] = {
                at: is_fulfilled(condition, now)
                for at, condition, now in readings
                if not leaves_open(condition, now)
            }
        return seen

    async def resources(self) -> dict[str, float]:
        return {what: float((await self.read(name)).value) for what, name in self.mapping.resources.items()}

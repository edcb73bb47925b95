"""A simulated PLC for any mapping. Each action takes its nominal duration and sets its variables.

It tests a workflow, not the mapping: a mapping can only be tested with a PLC.
"""

from __future__ import annotations

from typing import Any, ClassVar

from labos.node import Setup
from labos_drivers._simulation import Simulated
from labos_drivers.plc.mapping import MappedAction, PlcMapping, fill_argument


class MappedSimulator(Simulated):
    """A simulated PLC with this ``mapping``. A station is shut while a variable does not have the value that
    gives access to it."""

    mapping: ClassVar[PlcMapping]

    def __init__(self, setup: Setup) -> None:
        super().__init__(setup)
        self.variables: dict[str, Any] = {name: v.start for name, v in self.mapping.variables.items()}
        self._reach()

    async def do(self, name: str, args: dict[str, Any]) -> Any:
        """Carry out an action as the mapping describes it; returns its result. Raises DeviceError."""
        action = self.mapping.actions[name]
        if action.only_reads:
            return self._make_result(action)
        with self.motion():
            for variable in action.sets:
                if self.variables.get(variable) != action.sets[variable]:
                    self.variables[variable] = self.mapping.variables[variable].otherwise
            self._reach()
            await self.take_time(action.duration)
            for variable, value in action.sets.items():
                self.variables[variable] = fill_argument(value, args)
            self._reach()
        return self._make_result(action)

    def _make_result(self, action: MappedAction) -> Any:
        """An invented result, with values that the points can have."""
        points = {name: self.mapping.points[name] for name in action.result_points}
        values = {n: False if p.value_type == "bool" else p.minimum or 0.0 for n, p in points.items()}
        if isinstance(action.result, dict):
            return {key: values[name] for key, name in action.result.items()}
        return values.get(action.result)

    def observe(self) -> dict[str, Any]:
        labware = {name: bool(self.top(self.place(name))) for name in self.mapping.labware}
        return self.variables | ({"labware": labware} if labware else {})

    def _reach(self) -> None:
        for name, station in self.mapping.stations.items():
            shut = any(self.variables.get(key) != value for key, value in station.access.items())
            place = self.place(name)
            if shut != self.world.is_shut(place):
                self.world.gate(self.name, place, shut=shut)

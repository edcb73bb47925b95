"""A PLC that is not there: what its mapping says is done in its nominal time.

It tries a workflow, not a mapping: for that, the mapping has to meet a PLC.
"""

from __future__ import annotations

from typing import Any, ClassVar

from labos.node import Setup
from labos_drivers._simulation import Simulated
from labos_drivers.plc.mapping import MappedAction, PlcMapping, fill_argument


class MappedSimulator(Simulated):
    """Any PLC. A station that is accessible only while a variable has a value is shut while it has
    another."""

    mapping: ClassVar[PlcMapping]

    def __init__(self, setup: Setup) -> None:
        super().__init__(setup)
        self.variables: dict[str, Any] = {name: v.start for name, v in self.mapping.variables.items()}
        self._reach()

    async def do(self, name: str, args: dict[str, Any]) -> Any:
        """Do what the table says of the action."""
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
        """A result that the points could have."""
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

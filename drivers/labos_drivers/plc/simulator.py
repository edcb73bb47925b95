"""A PLC that is not there: what its mapping says is done in its nominal time.

It tries a workflow, not a mapping: for that, the mapping has to meet a PLC.
"""

from __future__ import annotations

from typing import Any, ClassVar

from labos.node import Setup
from labos_drivers._simulation import Simulated
from labos_drivers.plc.mapping import MappedAction, PlcMapping


class MappedSimulator(Simulated):
    """Any PLC. A station that is out of reach while a variable has another value is shut then."""

    mapping: ClassVar[PlcMapping]

    def __init__(self, setup: Setup) -> None:
        super().__init__(setup)
        self.variables: dict[str, Any] = {name: v.start for name, v in self.mapping.variables.items()}
        self._reach()

    async def do(self, name: str, args: dict[str, Any]) -> Any:
        """What the action says that it does."""
        told = self.mapping.actions[name]
        if told.only_reads:
            return self._made_up(told)
        with self.motion():
            for variable in told.sets:
                if self.variables.get(variable) != told.sets[variable]:
                    self.variables[variable] = self.mapping.variables[variable].otherwise
            self._reach()
            await self.take_time(told.duration)
            for variable, value in told.sets.items():
                self.variables[variable] = args[value[1:-1]] if _is_argument(value) else value
            self._reach()
        return self._made_up(told)

    def _made_up(self, told: MappedAction) -> Any:
        """A result that the points could tell."""
        points = {name: self.mapping.points[name] for name in told.points_read}
        values = {n: False if p.tells == "bool" else p.minimum or 0.0 for n, p in points.items()}
        if isinstance(told.result, dict):
            return {key: values[name] for key, name in told.result.items()}
        return values.get(told.result)

    def look(self) -> dict[str, Any]:
        labware = {name: bool(self.top(self.place(name))) for name in self.mapping.labware}
        return self.variables | ({"labware": labware} if labware else {})

    def _reach(self) -> None:
        for name, station in self.mapping.stations.items():
            shut = any(self.variables.get(key) != value for key, value in station.access.items())
            place = self.place(name)
            if shut != self.world.is_shut(place):
                self.world.gate(self.name, place, shut=shut)


def _is_argument(value: Any) -> bool:
    return isinstance(value, str) and value.startswith("{")

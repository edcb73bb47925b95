"""The node of a person: the actions that a workflow can request of a person."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Annotated, Any

from labos.core.ids import StationName
from labos.node import (
    DeviceError,
    Move,
    Node,
    Param,
    Place,
    Replaces,
    Setup,
    Station,
    Take,
    action,
    current_action,
)
from labos_drivers._arm import SOURCE, TARGET
from labos_drivers.operator.simulator import OperatorSimulator

MONTH_S = 30 * 86_400
"""What is due later than this is no step of a run."""

Instruction = Annotated[str, Param(description="what to do, in words for a person")]
Resource = Annotated[str, Param(description="what is to be replaced")]

Within = Annotated[
    float,
    Param(unit="s", minimum=0, maximum=MONTH_S, description="when it is due; 0: after its nominal duration"),
]


class Operator(Node):
    """A person who does planned steps and confirms them in the lab's inbox."""

    driver = "operator"
    models = ("operator", "person")
    manipulator = True
    stations = (Station("gripper", kind="gripper"),)

    def __init__(self, setup: Setup) -> None:
        super().__init__(setup)
        self._pending: dict[str, asyncio.Future[bool]] = {}
        self.device = OperatorSimulator(setup) if setup.world is not None else None

    async def observe(self) -> dict[str, Any]:
        return self.device.observe() if self.device is not None else {}

    async def settle(self, action: str, done: bool) -> None:
        """A person has confirmed the work of an action, or reported that it cannot be done."""
        settled = self._pending.get(action)
        if settled is not None and not settled.done():
            settled.set_result(done)

    @action(Move(SOURCE, TARGET), duration_s=300, by_person=True, aliases=("transfer",))
    async def carry_plate(self, source: Place, target: Place, within: Within = 0.0) -> None:
        """Carry labware from one station to another."""
        await self._await_done(300, lambda person: person.carry(source, target))

    @action(Take(SOURCE, StationName("{station}")), duration_s=300, by_person=True)
    async def load(self, source: Place, station: Place, within: Within = 0.0) -> None:
        """Take fresh labware from the store ``source`` and put it on ``station``."""
        await self._await_done(300, lambda person: person.carry(source, station))

    @action(Replaces("{module}", "{resource}", "{lot}", "{expires}"), duration_s=600, by_person=True)
    async def replace(
        self,
        resource: Resource,
        module: Annotated[str, Param(description="whose; its level is full afterwards")] = "",
        lot: Annotated[str, Param(description="of the new pack")] = "",
        expires: Annotated[str, Param(description="until when it is good, as 2027-05-31")] = "",
        instruction: Instruction = "",
        within: Within = 0.0,
    ) -> None:
        """Replace what a module uses up, tips, foil or ink, by a full pack.

        Without ``module`` the log knows nothing of it.
        """
        await self._await_done(600, lambda person: person.refill(module, resource))

    @action(duration_s=600, by_person=True)
    async def do(self, instruction: Instruction, within: Within = 0.0) -> Any:
        """Do what the instruction says; the result is what the person answers."""
        await self._await_done(600, lambda person: person.work("do", instruction))

    async def _await_done(self, nominal_s: float, work: Callable[[OperatorSimulator], None]) -> None:
        """Wait until the lab reports the outcome, or until the simulated person has done the ``work``. Raises
        DeviceError if the person reports that it cannot be done."""
        name = current_action.get()
        settled = self._pending[name] = asyncio.get_running_loop().create_future()
        try:
            if self.device is not None and self.device.alone:
                await self.device.wait_until_settled(settled, nominal_s)
            if (settled.done() or self.device is None or not self.device.alone) and not await settled:
                raise DeviceError("The person says that it cannot be done.", effects="none")
            if self.device is not None and self.device.alone:
                work(self.device)
        finally:
            del self._pending[name]

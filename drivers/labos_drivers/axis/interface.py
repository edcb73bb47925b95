"""The node of an axis: its actions and its description."""

from __future__ import annotations

from typing import Annotated, Any, ClassVar

import msgspec

from labos.core.effects import Sets
from labos.core.model import ActionSpec, Arg, Description
from labos.errors import DeviceError, OutcomeUnknown
from labos.node import Node, Param, Requires, action
from labos.node.mapping import DriverTable, read_table
from labos.node.node import INTERRUPTED
from labos_drivers._simulation import await_answer
from labos_drivers._wired import ReportsTrouble
from labos_drivers.axis.driver import AxisDriver, Goal
from labos_drivers.axis.simulator import AxisSimulator
from labos_drivers.axis.table import KEY, STAGE, AxisTable, find_flaws
from labos_drivers.axis.wire import DriveOnSlcan

NEVER_SENT = "The node was restarted before the drive was told to start."


class Axis(ReportsTrouble):
    """Axis behind a CANopen drive (CiA 402)."""

    driver = KEY
    models = ("axis", "cia402")
    variables = {"homed": False, "position": 0.0}
    own: ClassVar[AxisTable] = STAGE
    device: AxisSimulator | AxisDriver

    @classmethod
    def describe(cls) -> Description:
        return adapt_description(super().describe(), cls.own)

    @classmethod
    def for_table(cls, table: AxisTable) -> type[Axis]:
        """The node class for an axis with this table."""
        return type(cls.__name__, (cls,), {"own": table, "__doc__": cls.__doc__})

    @classmethod
    def for_config(cls, config: dict[str, Any]) -> type[Node]:
        if KEY not in config:
            return cls
        return cls.for_table(read_table(TABLE, config[KEY]))

    async def connect(self) -> None:
        of = {"table": self.own}
        self.devices = (  # type: ignore[misc]
            type("OnBench", (AxisSimulator,), of),
            type("OnWire", (DriveOnSlcan,), of),
            type("Driver", (AxisDriver,), of),
        )
        await super().connect()

    # -- actions -----------------------------------------------------------------------------

    @action(
        Sets("module", "homed", True), Sets("module", "position", 0.0), duration_s=20, safe_to_repeat=True
    )
    async def home(self) -> None:
        """Find the place from which positions count."""
        device = self.device
        if isinstance(device, AxisSimulator):
            await device.home()
            return
        await self._move(device, await device.prepare_home())

    @action(
        Requires("module", "homed", True),
        Sets("module", "position", "{position}"),
        duration_s=8,
        safe_to_repeat=True,
    )
    async def move_to(
        self,
        position: Annotated[float, Param(unit="mm", minimum=0, maximum=500)],
        speed: Annotated[float, Param(unit="mm/s", minimum=0.1, maximum=200)] = 25.0,
    ) -> None:
        """Go to a position, and stay there."""
        device = self.device
        if isinstance(device, AxisSimulator):
            await device.move_to(position, speed)
            return
        await self._move(device, await device.prepare_move(position, speed))

    @action(duration_s=1, safe_to_repeat=True, exclusive=False)
    async def read_position(self) -> float:
        """Where it stands, in the axis' unit."""
        return await await_answer(self.device.read_position())

    async def _move(self, device: AxisDriver, goal: Goal) -> None:
        with device.motion():
            await self.note_handle(msgspec.json.encode(goal).decode())
            sure = await device.start(goal)
            await device.await_end(goal, sure=sure)

    async def take_up(self, name: str, handle: str) -> Any:
        """Wait for the end of an attempt that was in progress when the node died. Nothing is started. Raises
        DeviceError, OutcomeUnknown."""
        device = self.device
        if name not in ("home", "move_to") or isinstance(device, AxisSimulator):
            raise OutcomeUnknown(INTERRUPTED)
        if not handle:
            raise DeviceError(NEVER_SENT, effects="none")
        with device.motion():
            await device.await_end(msgspec.json.decode(handle, type=Goal), sure=False)


def adapt_description(about: Description, table: AxisTable) -> Description:
    """The description of an axis with the unit, the limits, the speeds and the home of a table."""
    limits: dict[str, dict[str, Any]] = {
        "position": {"unit": table.unit, "minimum": table.minimum, "maximum": table.maximum},
        "speed": {"unit": f"{table.unit}/s", "maximum": table.top_speed, "default": table.speed},
    }

    def with_limits(arg: Arg) -> Arg:
        return msgspec.structs.replace(arg, **limits.get(arg.name, {}))

    def with_home(spec: ActionSpec) -> ActionSpec:
        effects = tuple(
            msgspec.structs.replace(effect, value=table.home.position)
            if isinstance(effect, Sets) and (effect.variable, effect.value) == ("position", 0.0)
            else effect
            for effect in spec.effects
        )
        return msgspec.structs.replace(spec, effects=effects, args=tuple(map(with_limits, spec.args)))

    actions = tuple(map(with_home, about.actions))
    variables = about.variables | {"homed": table.absolute, "position": table.home.position}
    return msgspec.structs.replace(about, description=table.description, actions=actions, variables=variables)


def describe(table: AxisTable) -> Description:
    """The description of the node for an axis with this table."""
    return Axis.for_table(table).describe()


TABLE = DriverTable(KEY, AxisTable, find_flaws, describe)
Axis.config_table = TABLE

"""The base class of nodes, for authors of drivers: a class with typed ``@action`` methods.

::

    class Sealer(Node):
        driver = "a4s_sealer"
        stations = (Station("nest", aliases=("default",)),)

        @action(Needs(), Sets("labware", "sealed", True), duration_s=20)
        async def seal(self, time: Annotated[float, Param(unit="s", minimum=0.5, maximum=9.9)] = 3.0) -> None:
            await self.device.seal(time)

Methods may be ``async def``, or plain ``def`` for blocking drivers: those run in a thread of their own. Raise
DeviceError to report a failure, with what is known of the motion.

Every node has the action ``reset``, from the method of that name. A driver whose reset moves says so:
``@action(Move(…), recovers=True)`` above its own ``reset``.
"""

from __future__ import annotations

import inspect
import types
import typing
from collections.abc import Awaitable, Callable
from contextvars import ContextVar
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, TypeVar

import msgspec

from labos.core.counts import Counter
from labos.core.effects import AnyEffect
from labos.core.model import ActionSpec, Arg, Description, Station
from labos.core.structs import make_from
from labos.errors import DeviceError, OutcomeUnknown
from labos.node.world import World

if TYPE_CHECKING:
    from labos.spec.tables import DriverTable

F = TypeVar("F", bound=Callable[..., Any])
ActionMethod = Callable[..., Awaitable[Any] | Any]

INTERRUPTED = "its node was restarted in mid-motion"


class Param(msgspec.Struct, frozen=True):
    """Properties of an argument that a type hint cannot express. ``place`` marks a station, ``file`` a file
    whose content is pinned at submission. Limits are in ``unit``."""

    unit: str = ""
    minimum: float | None = None
    maximum: float | None = None
    choices: tuple[Any, ...] = ()
    aliases: tuple[str, ...] = ()
    place: bool = False
    file: bool = False
    description: str = ""


Place = Annotated[str, Param(place=True)]
"""An argument that names a station."""

File = Annotated[str, Param(file=True)]
"""An argument that names a file; its content is pinned when the run is submitted."""


class Setup(msgspec.Struct):
    """The configuration that a node gets when it starts. ``poses`` are a manipulator's taught locations, and
    ``poses_of`` those that differ for a labware type, by type. ``pace`` is the speed-up factor of simulated
    devices, and ``world`` the simulated bench (None with a real device). ``wire``: simulated devices are
    reached over simulated wires, if the driver has them. ``unit_file`` stores the serial number of the device
    (``labos.node.unit``); empty if it is not stored. ``firmware`` is the version that the device reports when
    it is identified; empty if it reports none."""

    name: str
    workcell: str
    config: dict[str, Any] = {}
    poses: dict[str, list[float]] = {}
    regrip: str = ""
    world: World | None = None
    pace: float = 1.0
    seed: int = 0
    wire: bool = False
    poses_of: dict[str, dict[str, list[float]]] = {}
    unit_file: str = ""
    firmware: str = ""

    def poses_for(self, labware_type: str) -> dict[str, list[float]]:
        """The poses of stations for labware of a type: those for the type, otherwise those for any
        labware."""
        return {**self.poses, **self.poses_of.get(labware_type, {})}

    def place(self, station: str) -> str:
        """A station of this module, by its full local name: ``module.station``."""
        return f"{self.name}.{station}"

    def setting(self, key: str, example: str = "…") -> Any:
        """The setting of this module in the workcell file under a key that the driver needs. Raises
        DeviceError: no request was sent to the device."""
        if (value := self.config.get(key)) in (None, ""):
            raise DeviceError(
                f"{self.name}: its configuration has no {key!r}.",
                effects="none",
                remedy=f"Write `config: {{{key}: {example}}}` for {self.name} in the workcell file.",
            )
        return value


def action(
    *effects: AnyEffect,
    duration_s: float = 1.0,
    safe_to_repeat: bool = False,
    cancellable: bool = False,
    exclusive: bool = True,
    aliases: tuple[str, ...] = (),
    recovers: bool = False,
    by_person: bool = False,
    dangerous: str = "",
    duration_from: str = "",
) -> Callable[[F], F]:
    """Offer a method as an action; ``effects`` may hold ``{argument}`` place-holders. One that ``recovers``
    may start while the module is in error, and its success ends the error. An action ``by_person`` is in the
    inbox, and ends when a person reports its end. ``dangerous`` names a danger, or an effect that cannot be
    undone (``laser``, ``hot``, ``irreversible`` …); then a workcell may require a second person.
    ``duration_from`` is the source of its duration if that depends on the arguments: ``{seconds}``, ``20 +
    {minutes}`` in the unit of the parameter, ``{file:protocol:resources.seconds}``. If it has no value there,
    ``duration_s`` is used."""
    declared = dict(locals())  # the arguments are fields of ActionSpec

    def mark(method: F) -> F:
        method.__labos_action__ = declared  # type: ignore[attr-defined]
        return method

    return mark


handle_keeper: ContextVar[Callable[[str], Awaitable[None]] | None] = ContextVar("handle_keeper", default=None)
"""The function that ``note_handle`` calls; the server sets it for each action."""


async def note_handle(handle: str) -> None:
    """As ``Node.note_handle``, for the driver below a node."""
    keep = handle_keeper.get()
    if keep is not None:
        await keep(handle)


current_action: ContextVar[str] = ContextVar("current_action", default="")
"""The id of the action that a method carries out; the server sets it for each action."""


current_together: ContextVar[tuple[str, ...]] = ContextVar("current_together", default=())
"""The ids of all actions that a method carries out at once; empty for a single action. The server sets it for
each of them."""


class Node:
    """Base of every instrument. Subclasses set the class attributes and write actions. The actions of a
    driver may depend on a table in the module's configuration (``labos.node.mapping``). ``counters`` are
    functions that read from a file how much an action uses up, by resource (``labos.core.counts``)."""

    driver: ClassVar[str] = ""
    version: ClassVar[str] = "1"
    models: ClassVar[tuple[str, ...]] = ()
    manipulator: ClassVar[bool] = False
    stations: ClassVar[tuple[Station, ...]] = ()
    variables: ClassVar[dict[str, Any]] = {}
    rest: ClassVar[dict[str, Any]] = {}
    levels: ClassVar[dict[str, float]] = {}
    units: ClassVar[dict[str, str]] = {}
    config_table: ClassVar[DriverTable | None] = None
    counters: ClassVar[dict[str, Counter]] = {}

    def __init_subclass__(cls, **more: Any) -> None:
        super().__init_subclass__(**more)
        for name, method in vars(cls).items():
            is_taken = name in vars(Node) and not hasattr(vars(Node)[name], "__labos_action__")
            if is_taken and hasattr(method, "__labos_action__"):
                raise TypeError(
                    f"{cls.__qualname__}: an action cannot be called {name!r}: every node already has "
                    f"an attribute of that name. Use another name, for example {name}_device with "
                    f'aliases=("{name}",).'
                )

    def __init__(self, setup: Setup) -> None:
        self.setup = setup

    async def connect(self) -> None:
        """Open the device. Raise DeviceError with a remedy if it is not there."""

    async def close(self) -> None:
        """Disconnect from the device."""

    async def is_idle(self) -> bool:
        """Whether the device stands still. The server calls it after a restart, before the node accepts new
        work."""
        return True

    @action(recovers=True)
    async def reset(self) -> None:
        """Bring the device out of an error."""

    async def stop(self) -> None:
        """Stop all motion at once. A convenience, not a safety function."""

    async def settle(self, action: str, done: bool) -> None:
        """A person has reported the outcome of an action that may still run here. It may be called more than
        once."""

    async def resources(self) -> dict[str, float]:
        """Levels as the device itself reports them, by resource name."""
        return {}

    async def note_handle(self, handle: str) -> None:
        """Journal the device's own id of the work that an action is about to start (an OT-2 run id), so that
        it can be found again after a crash. Call it within an action, before the start."""
        await note_handle(handle)

    async def take_up(self, name: str, handle: str) -> Any:
        """Continue an action that was under way when the node died: wait for its end, and return or raise
        what its method would have. ``handle`` is the id from ``note_handle``; empty if there is none. Raise
        OutcomeUnknown if the device cannot report the outcome. Nothing may be started here."""
        raise OutcomeUnknown(INTERRUPTED)

    async def trouble(self) -> str:
        """The device's present error; empty if there is none. It is queried every few seconds. The error ends
        by itself, without a reset."""
        return ""

    async def observe(self) -> dict[str, Any]:
        """The observations of the device: variables by name, ``labware`` by station."""
        return {}

    @classmethod
    def for_config(cls, config: dict[str, Any]) -> type[Node]:
        """The class for a module with this configuration: this class, unless its actions depend on a table
        there. Raises BadInput."""
        return cls

    def methods(self) -> dict[str, ActionMethod]:
        """The method that carries out each action."""
        return {name: getattr(self, name) for name, _ in list_actions(type(self))}

    @classmethod
    def describe(cls) -> Description:
        """The description that follows from the class."""
        return make_from(
            Description,
            cls,
            description=inspect.cleandoc(cls.__doc__ or "").partition("\n")[0],
            actions=tuple(describe_action(name, method) for name, method in list_actions(cls)),
        )


def list_actions(cls: type[Node]) -> list[tuple[str, Callable[..., Any]]]:
    """(name, function) of every action, in order of definition, bases first, recoveries last. A method that
    overrides an action without a decorator keeps the declaration of its base."""
    found: dict[str, Callable[..., Any]] = {}
    for base in reversed(cls.__mro__):
        found.update((name, m) for name, m in vars(base).items() if hasattr(m, "__labos_action__"))
    return sorted(found.items(), key=lambda item: item[1].__labos_action__["recovers"])  # type: ignore[attr-defined]


def describe_action(name: str, method: Callable[..., Any]) -> ActionSpec:
    """Derive an action's description from its signature. Raises TypeError for a missing type hint."""
    hints = typing.get_type_hints(method, include_extras=True)
    args = []
    for parameter in list(inspect.signature(method).parameters.values())[1:]:
        if parameter.name not in hints:
            raise TypeError(f"{method.__qualname__}: argument {parameter.name!r} needs a type hint.")
        args.append(_describe_arg(parameter, hints[parameter.name]))
    returns = hints.get("return", type(None))
    return ActionSpec(
        name=name,
        description=inspect.cleandoc(method.__doc__ or "").partition("\n")[0],
        args=tuple(args),
        result="" if returns is type(None) else _name_type(returns),
        **method.__labos_action__,  # type: ignore[attr-defined]
    )


_SCALARS = {str: "str", int: "int", float: "float", bool: "bool", list: "list", dict: "dict", Any: "any"}


def _describe_arg(parameter: inspect.Parameter, hint: Any) -> Arg:
    param = Param()
    if typing.get_origin(hint) is Annotated:
        hint, *extras = typing.get_args(hint)
        param = next((extra for extra in extras if isinstance(extra, Param)), param)
    required = parameter.default is inspect.Parameter.empty
    return make_from(
        Arg,
        param,
        name=parameter.name,
        type="station" if param.place else "file" if param.file else _name_type(hint),
        required=required,
        default=None if required else parameter.default,
    )


def _name_type(hint: Any) -> str:
    origin = typing.get_origin(hint)
    if origin in (types.UnionType, typing.Union):
        inner = [arg for arg in typing.get_args(hint) if arg is not type(None)]
        return _name_type(inner[0]) if len(inner) == 1 else "any"
    return _SCALARS.get(origin or hint, "any")

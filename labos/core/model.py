"""The parts of the bench and of a plan that do not change while the lab runs."""

from __future__ import annotations

from enum import StrEnum
from typing import Any, Literal

import msgspec

from labos.core.effects import AnyEffect
from labos.core.ids import ModuleName, StationName
from labos.core.setups import Setup

StationKind = Literal["nest", "stack", "hotel", "deck", "exchange", "waste", "gripper"]

Verify = Literal["always", "on_doubt", "never"]
"""When the observer of a station checks whether a motion had the effect that its module reports."""


class WellGrid(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A grid of wells. ``a1_x_mm`` and ``a1_y_mm`` are the distances of the centre of A1 from the left and
    the back edge; ``volume_ul`` is the capacity of a well."""

    rows: int
    columns: int
    pitch_mm: float
    a1_x_mm: float
    a1_y_mm: float
    volume_ul: float


class LabwareSpec(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A labware type that a lab has defined for a workcell: its outer size, its wells if it has any, and the
    grips by which it can be held (none named: any). A piece that is not ``stackable`` cannot stand on another
    piece."""

    name: str
    length_mm: float
    width_mm: float
    height_mm: float
    wells: WellGrid | None = None
    stackable: bool = True
    grips: tuple[str, ...] = ()


class StationSpec(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A place that holds labware.

    ``capacity`` is a number of pieces of labware. ``accepts`` lists labware types (empty: any). ``access``
    are the values that variables of the station's module must have before a manipulator can reach in
    (``{"lid": "open"}``). ``claim`` is a group of stations whose labware must belong to one owner at a time,
    such as the deck of a liquid handler (empty: no such group). ``reach`` names the manipulators that have a
    pose for this station and their possible grips (no grip: any); ``reach_of`` has exceptions for some
    labware types. ``rotation`` is the angle of the nest in the room's frame, and ``a1`` lists the allowed
    rotations of labware in it (degrees; None: any). ``zone`` is a part of the bench in which only one arm may
    be at a time. ``observer`` is the module that can see the station, and ``verify`` says when LabOS uses it.
    ``refuses`` lists types that may not stand there although ``accepts`` allows them, because they cannot be
    stacked. A shelf names its ``hotel``: plans name the hotel, and moves name the shelf. If ``transfers`` is
    false, only steps that name a module move labware to or from the station.
    """

    name: StationName
    kind: StationKind
    module: ModuleName = ModuleName("")
    capacity: int = 1
    accepts: tuple[str, ...] = ()
    access: dict[str, Any] = {}
    claim: str = ""
    reach: dict[ModuleName, tuple[str, ...]] = {}
    aliases: tuple[str, ...] = ()
    zone: str = ""
    reach_of: dict[str, dict[ModuleName, tuple[str, ...]]] = {}
    rotation: int = 0
    a1: int | None = None
    observer: ModuleName = ModuleName("")
    verify: Verify = "always"
    refuses: tuple[str, ...] = ()
    hotel: StationName = StationName("")
    transfers: bool = True

    def admits(self, labware_type: str) -> bool:
        """Whether labware of a type may stand here."""
        return labware_type not in self.refuses and (not self.accepts or labware_type in self.accepts)

    def explain_refusal(self, labware_type: str) -> str:
        """Why labware of a type may not stand here, as the end of a sentence that begins with the station's
        name."""
        if labware_type in self.refuses:
            return f"does not accept {labware_type}: one may not stand upon another"
        return f"does not accept {labware_type}; it accepts {', '.join(self.accepts)}"

    @property
    def watched(self) -> bool:
        """Whether the station has an observer that LabOS may ask."""
        return bool(self.observer) and self.verify != "never"

    def list_grips(self, arm: ModuleName, labware_type: str) -> tuple[str, ...]:
        """The grips that a manipulator can use here on labware of a type. Empty: any."""
        return self.reach_of.get(labware_type, {}).get(arm, self.reach.get(arm, ()))

    @property
    def is_storage(self) -> bool:
        """Whether labware may wait here without keeping the module from other runs."""
        return self.kind in ("stack", "hotel", "waste")

    @property
    def stands_apart(self) -> bool:
        """Whether an arm may reach in at any time, independently of the module: storage without a door."""
        return self.is_storage and not self.access


class RetryDefault(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Retries of a step that failed without any effect: ``delay_s`` lab seconds after the failure. With
    ``reset``, the module is reset before."""

    times: int
    delay_s: float = 0.0
    reset: bool = False


class Together(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A device carries these ``actions`` out for the labware of several runs at once. A run waits for the
    labware of others for at most ``wait_s`` lab seconds after its own could begin."""

    actions: tuple[str, ...]
    wait_s: float = 0.0


class ModuleSpec(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """An instrument or manipulator. ``rest`` are the values of its variables at which others may use it
    (``{"lid": "open"}``). ``regrip`` is the station where a manipulator changes its grip. ``levels`` are the
    capacities of its resources, in the units of ``units`` (default: pieces). ``zone`` is the zone in which it
    acts. ``expired`` is ``warn`` if it may use resources after their expiry date, else ``refuse``.
    ``on_error``, ``retry`` and ``timeout_s`` are the defaults for its steps: the reaction to a failure, the
    retries before that, and the lab seconds after which the outcome of a step counts as unknown. With
    ``second_person``, runs with dangerous steps there wait for an approval. ``setup`` is the time for
    changing it from one kind of work to another, ``together`` the actions that it carries out for several
    runs at once."""

    name: ModuleName
    driver: str
    model: str = ""
    config: dict[str, Any] = {}
    variables: dict[str, Any] = {}
    rest: dict[str, Any] = {}
    regrip: StationName = StationName("")
    levels: dict[str, float] = {}
    zone: str = ""
    units: dict[str, str] = {}
    expired: str = "refuse"
    on_error: Literal["", "fail", "skip", "ask"] = ""
    retry: RetryDefault | None = None
    timeout_s: float | None = None
    second_person: bool = False
    setup: Setup | None = None
    together: Together | None = None


class TransferWay(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """How labware is moved if a step names no module: by an ``action`` of a module with the arguments
    ``source`` and ``target`` and further ``args``. Among several, the one with the lowest ``cost`` is used.
    If ``from_stations`` or ``to_stations`` are named, it is valid only for them, and takes precedence there
    over those that are valid everywhere."""

    module: ModuleName
    action: str
    source: str
    target: str
    cost: float = 1.0
    args: dict[str, Any] = {}
    from_stations: tuple[StationName, ...] = ()
    to_stations: tuple[StationName, ...] = ()


class Workcell(msgspec.Struct, frozen=True):
    """Modules and stations in fixed positions, as they were applied. ``digest`` covers the file and the files
    that it names. ``labware`` are the lab's own types for it. ``transfers`` are the possible ways of a
    transfer without a module (empty: all transfers of its modules)."""

    name: str
    digest: str
    modules: tuple[ModuleSpec, ...]
    stations: tuple[StationSpec, ...]
    labware: tuple[LabwareSpec, ...] = ()
    transfers: tuple[TransferWay, ...] = ()

    @property
    def places(self) -> tuple[StationSpec, ...]:
        """The stations at which labware can stand: for a hotel with shelves, its shelves but not the hotel
        itself."""
        hotels = {station.hotel for station in self.stations}
        return tuple(station for station in self.stations if station.name not in hotels)


LABWARE_TYPE, PLATE_TYPE = "labware_type", "plate_type"
"""Names of arguments for the type of the labware that an arm carries, and for the type of the plate whose lid
it carries. The lab fills them in if an action has them and the step does not set them. Poses may depend on
them."""


class Arg(msgspec.Struct, frozen=True):
    """An argument of an action. ``type`` is str, int, float, bool, list, dict, any, station or
    file; ``minimum`` and ``maximum`` in ``unit``."""

    name: str
    type: str = "any"
    required: bool = True
    default: Any = None
    aliases: tuple[str, ...] = ()
    unit: str = ""
    minimum: float | None = None
    maximum: float | None = None
    choices: tuple[Any, ...] = ()
    description: str = ""


class ActionSpec(msgspec.Struct, frozen=True):
    """An action that a module offers. ``duration_s`` is nominal. ``exclusive`` actions occupy the module;
    pure queries do not. An action that ``recovers`` may start while the module is in error, and its success
    ends the error. An action ``by_person`` ends when a person reports its end. ``returns`` is the result of a
    module that is simulated from its description alone. ``dangerous`` names a danger, or an effect that
    cannot be undone (laser, hot, irreversible …); empty for most. ``duration_from`` is the source of the
    duration if arguments or the file of the action determine it: ``{seconds}``, ``20 + {minutes}`` (in the
    unit of the argument), ``{file:protocol:resources.seconds}``."""

    name: str
    description: str = ""
    args: tuple[Arg, ...] = ()
    effects: tuple[AnyEffect, ...] = ()
    duration_s: float = 1.0
    safe_to_repeat: bool = False
    cancellable: bool = False
    exclusive: bool = True
    aliases: tuple[str, ...] = ()
    result: str = ""
    recovers: bool = False
    by_person: bool = False
    returns: Any = None
    dangerous: str = ""
    duration_from: str = ""


class Station(msgspec.Struct, frozen=True):
    """A station in a driver's description, independent of any workcell; ``name`` is local."""

    name: str
    kind: StationKind = "nest"
    capacity: int = 1
    access: dict[str, Any] = {}
    claim: bool = True
    aliases: tuple[str, ...] = ()


class Description(msgspec.Struct, frozen=True):
    """A driver's description of itself, without any device: the answer of the ``about`` operation without the
    live part."""

    driver: str
    version: str
    description: str
    manipulator: bool = False
    models: tuple[str, ...] = ()
    actions: tuple[ActionSpec, ...] = ()
    stations: tuple[Station, ...] = ()
    variables: dict[str, Any] = {}
    rest: dict[str, Any] = {}
    levels: dict[str, float] = {}
    units: dict[str, str] = {}

    def action(self, name: str) -> ActionSpec | None:
        """The action of that name or alias."""
        return next((a for a in self.actions if name == a.name or name in a.aliases), None)


OnBreach = Literal["continue", "fail", "ask"]
"""The consequence of a step that starts too late: nothing, the end of its run, or a question to a person."""


class Window(msgspec.Struct, frozen=True, forbid_unknown_fields=True, gc=False):
    """A step starts at least ``wait_s`` and at most ``within_s`` after the end of step ``anchor`` (lab
    seconds; ``within_s`` None: no limit). With ``of``, the time counts from a step of another run of the same
    experiment. ``of`` names that run by its workflow or id, ``of_step`` names the step, and ``anchor`` is
    null."""

    anchor: int | None
    wait_s: float = 0.0
    within_s: float | None = None
    on_breach: OnBreach = "continue"
    of: str = ""
    of_step: str = ""


class Part(StrEnum):
    """A part of a plan: the workflow itself, or the steps after a cancellation."""

    MAIN = "main"
    ON_CANCEL = "on_cancel"


MAIN, ON_CANCEL = Part.MAIN, Part.ON_CANCEL

AnyPart = Part | int
"""A part of a plan; a number is the index of the failed step after which the part is carried out."""


def find_served_step(part: AnyPart) -> int | None:
    """The failed step after which a part of a plan is carried out; None if there is none."""
    return part if isinstance(part, int) else None


class Condition(msgspec.Struct, frozen=True, forbid_unknown_fields=True, gc=False):
    """An expression with the payload filled in: ``text`` as it was written, and ``tree`` as it was parsed
    (JSON). A name in the tree is ``["result", field…]`` for the step's own result, or ``["steps", key,
    field…]``."""

    text: str
    tree: str


class OnError(msgspec.Struct, frozen=True, forbid_unknown_fields=True, gc=False):
    """The reaction to a failed step whose outcome is known and which has no retries left. The run fails;
    continues without the step (``skip``); asks a person, who may skip the step if ``may_skip``; or carries
    out the steps whose ``part`` is this step (``run``), and then fails or continues."""

    do: Literal["fail", "skip", "ask", "run"]
    then: Literal["fail", "go_on"] = "fail"
    may_skip: bool = False


class Retry(msgspec.Struct, frozen=True, forbid_unknown_fields=True, gc=False):
    """A step that failed without any effect is tried again, at most ``times`` times, ``delay_s`` lab seconds
    after the failure. ``reset`` is the step that resets its module before, if there is one."""

    times: int
    delay_s: float = 0.0
    reset: int | None = None


class PlanStep(msgspec.Struct, frozen=True, forbid_unknown_fields=True, gc=False):
    """A step, ready to run. Its arguments hold values or ``{"$result": [step, field…]}``, with ``"$file":
    true`` where the action takes a file. ``after`` are indices of the steps that must be done before. If the
    action has not ended ``timeout_s`` lab seconds after the request, its outcome counts as unknown. ``part``
    is the part of the plan to which the step belongs. It is the workflow itself, the steps under
    ``on_cancel``, or the steps after a failure of the step with that index. Steps under ``on_cancel`` wait
    for all steps before them, because some may be left out. The step is done only if ``when`` is true, and
    its result must fulfil ``expect``. ``hazard`` is the danger that its driver declares; ``dangerous`` is the
    same text if a second person has to approve it."""

    key: str
    module: ModuleName
    action: str
    args: dict[str, Any] = {}
    after: tuple[int, ...] = ()
    effects: tuple[AnyEffect, ...] = ()
    duration_s: float = 1.0
    safe_to_repeat: bool = False
    exclusive: bool = True
    windows: tuple[Window, ...] = ()
    recovers: bool = False
    retry: Retry | None = None
    timeout_s: float | None = None
    by_person: bool = False
    on_error: OnError | None = None
    part: AnyPart = MAIN
    when: Condition | None = None
    expect: Condition | None = None
    dangerous: str = ""
    hazard: str = ""

    @property
    def serves(self) -> int | None:
        """The failed step after which this step is carried out; None if there is none."""
        return find_served_step(self.part)


class Hold(msgspec.Struct, frozen=True, forbid_unknown_fields=True, gc=False):
    """A run keeps a module exclusively from the request of step ``first`` to the end of step ``last``,
    wherever its labware is in between."""

    module: ModuleName
    first: int
    last: int


class Plan(msgspec.Struct, frozen=True):
    """A workflow with its payload filled in, unrolled and checked.

    ``feeds`` are the indices of steps whose results later steps read. ``files`` maps names in arguments to
    the digests of their blobs. ``holds`` are additional to the holding by labware, doors and lids.
    """

    workflow: str
    workcell: str
    steps: tuple[PlanStep, ...]
    feeds: tuple[int, ...] = ()
    files: dict[str, str] = {}
    holds: tuple[Hold, ...] = ()

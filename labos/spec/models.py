"""The files of LabOS in its own form: workcell, workflow and labware.

Other dialects are rewritten into this form first (``labos.spec.dialects``), so that there is
one meaning. Unknown keys are errors.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Discriminator, Field, Tag

from labos.core.model import OnBreach, StationKind, Verify
from labos.spec.about import About, Extends
from labos.spec.parts import Aliases, Comment, Label, Many, Name, Part, Seconds, Version


class Amount(Part):
    """An amount of a consumable, with a unit."""

    amount: float = Field(ge=0)
    """the amount"""
    unit: str = ""
    """uL, mL, L, mg, g, mm, m …; the unit of the resource, if left out"""


OnErrorWord = Literal["fail", "skip", "ask"]
"""The reaction to a failed step without retries left: the run ends, continues without the step, or a person
is asked."""


class RetryEntry(Part):
    """A step that failed without any effect is tried again; with ``reset``, its module is reset before."""

    times: int = Field(ge=1, le=100)
    """the number of retries, at most 100"""
    delay: Seconds = Field(default=0.0, ge=0)
    """the time before a retry: seconds, or text such as ``10 min``"""
    reset: bool = False
    """whether its module is reset before a retry"""


class SetupChangeEntry(Part):
    """A change of the set-up with its own time."""

    from_: Any = Field(alias="from")
    """the value before"""
    to: Any
    """the value after"""
    takes: Seconds = Field(ge=0)
    """the additional time of an action with this change"""


class SetupEntry(Part):
    """The time for setting a module up for another value of an argument of its actions."""

    by: str = Field(min_length=1)
    """the argument of its actions for whose value the module is set up"""
    takes: Seconds = Field(ge=0)
    """the additional time of an action with another value than the last one"""
    changes: list[SetupChangeEntry] = []
    """changes with their own times"""


class TogetherEntry(Part):
    """Actions that a module carries out for the labware of several runs at once, and how long a run waits for
    that of others."""

    actions: list[str] = Field(min_length=1)
    """the actions that it carries out for all labware in it at once"""
    wait: Seconds = Field(default=0.0, ge=0)
    """how long a run whose labware is in it waits for that of others, at most"""


class ModuleEntry(Part):
    """An instrument in a workcell. ``model`` or ``driver`` determines the driver; ``coordinates`` are x, y, z
    in metres and a quaternion, from the workcell's origin; ``zone`` is the zone in which it acts. ``retry``,
    ``timeout`` and ``on_error`` are defaults for steps on it. ``interface`` names the adapter of a foreign
    node, ``about`` describes a node without a driver, and ``extends`` adds to the driver's description. With
    ``second_person``, runs with dangerous steps there wait for an approval. ``setup`` is the time for a
    change to other work, and ``together`` are its actions for several runs at once."""

    name: Name
    """the module's name, as the workcell's"""
    model: str = ""
    """a model of a driver; either this or ``driver``"""
    driver: str = ""
    """the driver's name, if the model does not determine it"""
    interface: str = ""
    """the protocol of the module's node; LabOS' own, if left out or ``native``"""
    about: About | None = None
    """the description of a foreign node without a driver"""
    extends: Extends | None = None
    """parts of its own node that its driver does not have; only with an ``interface``"""
    config: dict[str, Any] = {}
    """a table for the driver: addresses, ports"""
    coordinates: list[float] | None = None
    """x, y, z in metres and a quaternion, from the workcell's origin"""
    regrip: str = ""
    """the station where an arm changes from one grip to another"""
    resources: dict[str, float | str | Amount] = {}
    """capacities of consumables: a number in their own unit, or with another (20 mL)"""
    variables: dict[str, Any] = {}
    """first values of its variables"""
    rest: dict[str, Any] | None = None
    """values of its variables at which other runs can use it"""
    zone: Name | None = None
    """the zone in which the module acts"""
    active: bool = True
    """false leaves the module out"""
    retry: RetryEntry | None = None
    """the default number of retries of a step on it that failed without any effect"""
    timeout: Seconds | None = Field(default=None, gt=0)
    """the default time after which the outcome of a step on it counts as unknown"""
    on_error: OnErrorWord | None = None
    """the default reaction when a step on it has finally failed"""
    second_person: bool = False
    """true: runs with dangerous steps there wait for a second person's approval"""
    setup: SetupEntry | None = None
    """the time for setting it up for another value of an argument"""
    together: TogetherEntry | None = None
    """actions for the labware of several runs at once"""
    comment: Comment = ""


MOST_SHELVES = 500


class StationEntry(Part):
    """Changes a station of a driver, or adds one. ``reach`` lists the possible grips of a manipulator there
    (an empty list: any), or those grips for each labware type. ``rotation`` is the rotation of the nest, and
    ``a1`` the required rotation of labware in it (degrees). Only one arm at a time is in a ``zone``. Labware
    at an ``independent`` station does not block its module for other runs. ``observer`` is the module that
    can see this station, and ``verify`` says when it checks whether a move succeeded. A hotel has ``shelves``
    for one piece each, into which arms reach. If ``transfers`` is false, transfers that name no module do not
    use this station."""

    kind: StationKind | None = None
    """the kind of the station; ``nest`` by default"""
    capacity: int | None = Field(default=None, ge=1)
    """its capacity for pieces of labware"""
    shelves: int | None = Field(default=None, ge=1, le=MOST_SHELVES)
    """the number of shelves of a hotel, for one piece each; arms are taught each of them"""
    accepts: list[str] | None = None
    """labware types; any, if left out"""
    access: dict[str, Any] | None = None
    """values of the module's variables with which an arm can reach in"""
    claim: bool | None = None
    """whether labware here blocks the module for other runs"""
    independent: bool = False
    """labware here does not claim the module"""
    zone: Name | None = None
    """a part of the bench in which only one arm may be at a time"""
    reach: dict[str, list[str] | dict[str, list[str]]] = {}
    """module, then its possible grips here, by labware type if they differ; empty for any"""
    rotation: Literal[0, 90, 180, 270] | None = None
    """the rotation of the nest in the room's frame, in degrees"""
    a1: Literal[0, 90, 180, 270] | None = None
    """the required rotation of labware in the nest, in degrees; any, if left out"""
    observer: Name | None = None
    """the module that can see this station"""
    verify: Verify | None = None
    """when the observer checks whether a move succeeded"""
    transfers: bool = True
    """false: only steps that name their module move labware to or from here"""
    aliases: Aliases = []
    comment: Comment = ""


ANY = "any"
"""Stands for all labware types that have no pose of their own at a location."""


class ShelfPoses(Part):
    """Joint values at the first shelf of a hotel, and their increments from each shelf to the next."""

    first: list[float]
    """joint values at the lowest shelf"""
    step: list[float]
    """the increments from one shelf to the next"""

    def find_pose(self, number: int) -> list[float]:
        """The joint values at a shelf, counted from 1."""
        return [round(a + (number - 1) * b, 9) for a, b in zip(self.first, self.step, strict=True)]


def _find_kind_of_pose(value: object) -> str:
    if isinstance(value, ShelfPoses) or (isinstance(value, dict) and "first" in value):
        return "shelves"
    return "types" if isinstance(value, dict) else "pose"


PoseEntry = Annotated[
    Annotated[list[float], Tag("pose")]
    | Annotated[
        dict[str, list[float]],
        Field(json_schema_extra={"propertyNames": {"not": {"enum": ["first", "step"]}}}),
        Tag("types"),
    ]
    | Annotated[ShelfPoses, Tag("shelves")],
    Discriminator(_find_kind_of_pose),
]
"""Joint values; or those of each labware type and of ``any`` other type; or those of a hotel's shelves."""


class TransferEntry(Part):
    """How labware may be moved if a step names no module: ``source`` and ``target`` are the names of the
    arguments of the ``action`` for the two stations, and ``args`` are further arguments. The way with the
    least cost is used. ``from`` and ``to`` are the stations for which this entry takes precedence over
    others."""

    module: Name
    """the module that moves labware"""
    action: str = "transfer"
    """the action of the module"""
    source: str = "source"
    """the action's argument for the source"""
    target: str = "target"
    """the action's argument for the target"""
    cost: float = Field(default=1.0, gt=0)
    """the way with the least total cost is used"""
    args: dict[str, Any] = {}
    """further arguments of the action"""
    from_: list[str] = Field(default=[], alias="from")
    """only for transfers from these stations; takes precedence over entries for all stations"""
    to: list[str] = []
    """only for transfers to these stations; takes precedence over entries for all stations"""


class WorkcellFile(Part):
    """Modules and stations in fixed positions. ``locations`` contains poses by manipulator and station; if
    they differ by labware type, those of the types, and ``any`` for all other labware. ``stock`` is the
    labware at the start: station → labware type → count. ``expired`` says whether packs may be used after
    their expiry date. ``labware`` names files, or folders of files, with the lab's own labware types.
    ``transfers`` are the ways for a transfer that names no module; without them, all that the modules can
    do."""

    labos: Version = 1
    name: Name
    """the workcell's name: letters, digits, _, -, spaces and brackets"""
    description: Comment = ""
    config: dict[str, Any] = {}
    """a table of anything"""
    modules: list[ModuleEntry] = Field(min_length=1)
    """the instruments and arms"""
    locations: dict[str, dict[str, PoseEntry]] = {}
    """taught places: module, station, joint values, or those of each labware type and ``any``"""
    stations: dict[str, StationEntry] = {}
    """differences from the drivers' descriptions, and stations that belong to no module"""
    stock: dict[str, dict[str, Annotated[int, Field(ge=0)]]] | None = None
    """the labware when the lab is first declared: station, then labware type, then count"""
    expired: Literal["refuse", "warn"] = "refuse"
    """whether packs may be used after their expiry date: refuse, or warn"""
    labware: str | list[str] = []
    """files that define labware types, or folders of them, relative to this file's folder"""
    transfers: list[TransferEntry] = []
    """how labware is moved if a step names no module; any possible way, if left out"""


class Parameter(Part):
    """A value that a workflow takes from its payload."""

    default: Any = None
    """the value if the payload holds none"""
    required: bool = False
    """whether the payload must hold it"""
    description: Comment = ""


class AfterStep(Part):
    """A time that begins with another step's end."""

    after: str
    """the step whose end counts"""
    of: str = ""
    """the workflow or the run of that step, if it is not this one"""


class Wait(AfterStep):
    """The step starts no sooner than this after another step's end. ``of`` names the run whose
    step it is, or its workflow; empty for the same run."""

    at_least: Seconds = Field(ge=0)
    """the time that must pass: seconds, or text such as ``10 min``"""


class Within(AfterStep):
    """The step starts no later than this after another step's end; ``of`` as for ``Wait``."""

    at_most: Seconds = Field(ge=0)
    """the time within which the step starts: seconds, or text such as ``10 min``"""
    on_breach: OnBreach = "continue"
    """the reaction when it starts too late"""


class ForEach(Part):
    """The entry is repeated for each element of a list, which is ``payload.<item>`` in it."""

    item: Name
    """the name of the element in the entry's payload"""
    in_: str | list[Any] = Field(alias="in")
    """the list: ``payload.plates``, or the elements themselves"""
    parallel: bool = False
    """whether the entry's rounds need not wait for each other"""


class RunSteps(Part):
    """The steps after a step has finally failed, from a file or given here, and whether the run continues
    after them."""

    run: str | list[StepEntry] = Field(min_length=1)
    """a list of steps, or a workflow file whose steps they are"""
    then: Literal["fail", "go_on"] = "fail"
    """whether the run then fails, or continues with the steps after it"""


OnErrorEntry = Annotated[
    Annotated[OnErrorWord, Tag("word")] | Annotated[RunSteps, Tag("steps")],
    Discriminator(lambda value: "steps" if isinstance(value, dict | RunSteps) else "word"),
]


NONE = "none"
"""The value of a step's field that switches its module's default off."""

NoDefault = Literal["none"]

RetryOfStep = Annotated[
    Annotated[NoDefault, Tag("word")] | Annotated[RetryEntry, Tag("table")],
    Discriminator(lambda value: "word" if isinstance(value, str) else "table"),
]

TimeoutOfStep = Annotated[
    Annotated[NoDefault, Tag("word")] | Annotated[Seconds, Field(gt=0), Tag("time")],
    Discriminator(lambda value: "word" if value == NONE else "time"),
]


ANY_OF, SAME_AS = "any ", "same as "
"""The beginnings of ``module:`` for a step that one of several modules may do, and for one with the module of
another step."""


class AnyModule(Part):
    """One of these modules."""

    any: list[Name] = Field(min_length=1)
    """the modules that can do the step; one of them is chosen"""


def _show_any(value: object) -> object:
    """``{any: [a, b]}`` as the equivalent text."""
    if not isinstance(value, dict):
        return value
    names = value.get("any")
    names = names if isinstance(names, list) and all(isinstance(name, str) for name in names) else []
    if set(value) != {"any"} or not names:
        raise ValueError("a choice of modules is written {any: [one, other]}")
    return ANY_OF + ", ".join(names) + ("," if len(names) == 1 else "")


ModuleOfStep = Annotated[str, BeforeValidator(_show_any, json_schema_input_type=str | AnyModule)]


class StepEntry(Part):
    """One action on one module, or (``use``) all steps of another file. Without ``after``, it follows
    the step before it."""

    name: Label
    """the step's name"""
    module: ModuleOfStep = ""
    """the module's name; ``any <driver>`` or ``{any: [a, b]}``: one of them; ``same as <step>``"""
    action: str = ""
    """one of the module's actions, or an alias of it"""
    args: dict[str, Any] = {}
    """the action's arguments, by name or alias; ``payload.x`` stands for a value of the payload"""
    use: str = ""
    """another workflow file, whose steps replace this entry; instead of ``module`` and ``action``"""
    payload: dict[str, Any] = {}
    """the payload of the file that is used; the whole payload, if left out"""
    for_each: ForEach | None = None
    """a list: the entry is repeated for each of its elements"""
    when: str = ""
    """a condition on the payload; if it is false, the entry is left out"""
    after: list[str] | None = None
    """names of steps that must be done first; the one before it, if left out"""
    wait: Many[Wait] = []
    """it starts no sooner than a time after another step's end"""
    within: Many[Within] = []
    """it starts no later than a time after another step's end"""
    retry: RetryOfStep | None = None
    """the retries after a failure without any effect; or ``none``"""
    timeout: TimeoutOfStep | None = None
    """the time after which its outcome is unknown: seconds, text such as ``10 min``, or ``none``"""
    on_error: OnErrorEntry | None = None
    """the reaction when it has finally failed"""
    expect: str = ""
    """a condition on its result; if it is false, the step has failed"""
    comment: Comment = ""


class HoldEntry(Part):
    """Reserves a module for the run from the start of one step to the end of another."""

    start: str = Field(alias="from")
    """the step whose start begins it"""
    until: str
    """the step whose end ends it"""


OnCancelEntry = Annotated[
    Annotated[str, Tag("file")]
    | Annotated[list[StepEntry], Field(min_length=1, max_length=200), Tag("steps")],
    Discriminator(lambda value: "file" if isinstance(value, str) else "steps"),
]


WhenBroken = Literal["refuse", "warn", "accept"]
"""The reaction if a run cannot keep a window for all durations of its steps: it is refused, a warning is
given, or nothing happens."""


class WorkflowFile(Part):
    """Steps on modules. ``modules`` lists the modules of the steps; it may be left out. ``hold`` says how
    long a module is reserved for the run, or ``none`` for no longer than necessary. ``windows`` is the
    reaction if a window cannot be kept for all durations of the steps (``warn``). ``on_cancel`` are the steps
    that clear labware away when a run is cancelled, or a file with such steps."""

    labos: Version = 1
    name: Label
    """the workflow's name"""
    description: Comment = ""
    metadata: dict[str, Any] = {}
    """a table of anything, kept with the file"""
    workcell: str = ""
    """the workcell for which it was written; for people"""
    modules: list[str] | None = None
    """the modules that it uses; a module that the workcell does not have causes a warning"""
    parameters: dict[str, Parameter] = {}
    """the values that it takes from the payload, by name"""
    hold: dict[str, Literal["none"] | HoldEntry] = {}
    """how long modules are reserved for the run, by module; ``none`` for no longer than necessary"""
    windows: WhenBroken | None = None
    """the reaction if a run can miss a window when its steps take shorter or longer"""
    steps: list[StepEntry] = Field(min_length=1, max_length=2000)
    """the steps; without ``after``, each follows the previous one"""
    on_cancel: OnCancelEntry | None = None
    """steps that clear labware away when a run is cancelled, or a file with them"""

    def iterate_entries(self) -> Iterator[tuple[tuple[str | int, ...], StepEntry]]:
        """All entries in the file, with their paths: also those for failures and cancellation."""
        on_cancel = self.on_cancel if isinstance(self.on_cancel, list) else []
        for top, entries in (("steps", self.steps), ("on_cancel", on_cancel)):
            for index, entry in enumerate(entries):
                yield (top, index), entry
                if isinstance(entry.on_error, RunSteps) and isinstance(entry.on_error.run, list):
                    for number, inner in enumerate(entry.on_error.run):
                        yield (top, index, "on_error", "run", number), inner


class Footprint(Part):
    """Outer size in millimetres."""

    length_mm: float = Field(gt=0)
    """along its long side, in mm"""
    width_mm: float = Field(gt=0)
    """along its short side, in mm"""
    height_mm: float = Field(gt=0)
    """without a lid, in mm"""


class Wells(Part):
    """A grid of wells. ``a1_x_mm`` and ``a1_y_mm`` are the distances of the centre of A1 from the left and
    the back edge; ``volume_ul`` is the capacity of a well."""

    rows: int = Field(ge=1)
    """the number of rows: A, B …"""
    columns: int = Field(ge=1)
    """the number of columns: 1, 2 …"""
    pitch_mm: float = Field(gt=0)
    """from one well's centre to the next one's, in mm"""
    a1_x_mm: float = 0.0
    """centre of A1 from the left edge, in mm"""
    a1_y_mm: float = 0.0
    """centre of A1 from the back edge, in mm"""
    volume_ul: float = Field(gt=0)
    """the capacity of a well, in µL"""


class LabwareType(Part):
    """A kind of labware; ``grips`` are the possible grips (an empty list: any). A type that is not
    ``stackable`` is refused at stacks of more than one piece."""

    description: Comment = ""
    footprint: Footprint
    """outer size"""
    wells: Wells | None = None
    """its grid of wells, if it has any"""
    stackable: bool = True
    """false: no piece may stand on another, and no stack accepts it"""
    grips: list[str] = []
    """the possible grips; any, if left out"""
    source: str = ""
    """the source of the measures"""


class LabwareFile(Part):
    """Labware types by name."""

    labos: Version = 1
    labware: dict[Name, LabwareType] = Field(min_length=1)
    """labware types by name"""

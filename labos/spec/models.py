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
from labos.spec.parts import Label, Many, Name, Part, Seconds


class Amount(Part):
    """An amount of a consumable, with a unit."""

    amount: float = Field(ge=0)
    unit: str = ""


OnErrorWord = Literal["fail", "skip", "ask"]
"""The reaction to a failed step without retries left: the run ends, continues without the step, or a person
is asked."""


class RetryEntry(Part):
    """A step that failed without any effect is tried again; with ``reset``, its module is reset before."""

    times: int = Field(ge=1, le=100)
    delay: Seconds = Field(default=0.0, ge=0)
    reset: bool = False


class SetupChangeEntry(Part):
    """A change of the set-up with its own time."""

    from_: Any = Field(alias="from")
    to: Any
    takes: Seconds = Field(ge=0)


class SetupEntry(Part):
    """The time for setting a module up for another value of an argument of its actions."""

    by: str = Field(min_length=1)
    takes: Seconds = Field(ge=0)
    changes: list[SetupChangeEntry] = []


class TogetherEntry(Part):
    """Actions that a module carries out for the labware of several runs at once, and how long a run waits for
    that of others."""

    actions: list[str] = Field(min_length=1)
    wait: Seconds = Field(default=0.0, ge=0)


class ModuleEntry(Part):
    """An instrument in a workcell. ``model`` or ``driver`` determines the driver; ``coordinates`` are x, y, z
    in metres and a quaternion, from the workcell's origin; ``zone`` is the zone in which it acts. ``retry``,
    ``timeout`` and ``on_error`` are defaults for steps on it. ``interface`` names the adapter of a foreign
    node, ``about`` describes a node without a driver, and ``extends`` adds to the driver's description. With
    ``second_person``, runs with dangerous steps there wait for an approval. ``setup`` is the time for a
    change to other work, and ``together`` are its actions for several runs at once."""

    name: Name
    model: str = ""
    driver: str = ""
    interface: str = ""
    about: About | None = None
    extends: Extends | None = None
    config: dict[str, Any] = {}
    coordinates: list[float] | None = None
    regrip: str = ""
    resources: dict[str, float | str | Amount] = {}
    variables: dict[str, Any] = {}
    rest: dict[str, Any] | None = None
    zone: Name | None = None
    active: bool = True
    retry: RetryEntry | None = None
    timeout: Seconds | None = Field(default=None, gt=0)
    on_error: OnErrorWord | None = None
    second_person: bool = False
    setup: SetupEntry | None = None
    together: TogetherEntry | None = None
    comment: str = ""


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
    capacity: int | None = Field(default=None, ge=1)
    shelves: int | None = Field(default=None, ge=1, le=MOST_SHELVES)
    accepts: list[str] | None = None
    access: dict[str, Any] | None = None
    claim: bool | None = None
    independent: bool = False
    zone: Name | None = None
    reach: dict[str, list[str] | dict[str, list[str]]] = {}
    rotation: Literal[0, 90, 180, 270] | None = None
    a1: Literal[0, 90, 180, 270] | None = None
    observer: Name | None = None
    verify: Verify | None = None
    transfers: bool = True
    aliases: list[str] = []
    comment: str = ""


ANY = "any"
"""Stands for all labware types that have no pose of their own at a location."""


class ShelfPoses(Part):
    """Joint values at the first shelf of a hotel, and their increments from each shelf to the next."""

    first: list[float]
    step: list[float]

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
    action: str = "transfer"
    source: str = "source"
    target: str = "target"
    cost: float = Field(default=1.0, gt=0)
    args: dict[str, Any] = {}
    from_: list[str] = Field(default=[], alias="from")
    to: list[str] = []


class WorkcellFile(Part):
    """Modules and stations in fixed positions. ``locations`` contains poses by manipulator and station; if
    they differ by labware type, those of the types, and ``any`` for all other labware. ``stock`` is the
    labware at the start: station → labware type → count. ``expired`` says whether packs may be used after
    their expiry date. ``labware`` names files, or folders of files, with the lab's own labware types.
    ``transfers`` are the ways for a transfer that names no module; without them, all that the modules can
    do."""

    labos: Literal[1] = 1
    name: Name
    description: str = ""
    config: dict[str, Any] = {}
    modules: list[ModuleEntry] = Field(min_length=1)
    locations: dict[str, dict[str, PoseEntry]] = {}
    stations: dict[str, StationEntry] = {}
    stock: dict[str, dict[str, Annotated[int, Field(ge=0)]]] | None = None
    expired: Literal["refuse", "warn"] = "refuse"
    labware: str | list[str] = []
    transfers: list[TransferEntry] = []


class Parameter(Part):
    """A value that a workflow takes from its payload."""

    default: Any = None
    required: bool = False
    description: str = ""


class Wait(Part):
    """The step starts no sooner than this after another step's end. ``of`` names the run whose
    step it is, or its workflow; empty for the same run."""

    after: str
    of: str = ""
    at_least: Seconds = Field(ge=0)


class Within(Part):
    """The step starts no later than this after another step's end; ``of`` as for ``Wait``."""

    after: str
    of: str = ""
    at_most: Seconds = Field(ge=0)
    on_breach: OnBreach = "continue"


class ForEach(Part):
    """The entry is repeated for each element of a list, which is ``payload.<item>`` in it."""

    item: Name
    in_: str | list[Any] = Field(alias="in")
    parallel: bool = False


class RunSteps(Part):
    """The steps after a step has finally failed, from a file or given here, and whether the run continues
    after them."""

    run: str | list[StepEntry] = Field(min_length=1)
    then: Literal["fail", "go_on"] = "fail"


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
    module: ModuleOfStep = ""
    action: str = ""
    args: dict[str, Any] = {}
    use: str = ""
    payload: dict[str, Any] = {}
    for_each: ForEach | None = None
    when: str = ""
    after: list[str] | None = None
    wait: Many[Wait] = []
    within: Many[Within] = []
    retry: RetryOfStep | None = None
    timeout: TimeoutOfStep | None = None
    on_error: OnErrorEntry | None = None
    expect: str = ""
    comment: str = ""


class HoldEntry(Part):
    """Reserves a module for the run from the start of one step to the end of another."""

    start: str = Field(alias="from")
    until: str


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

    labos: Literal[1] = 1
    name: Label
    description: str = ""
    metadata: dict[str, Any] = {}
    workcell: str = ""
    modules: list[str] | None = None
    parameters: dict[str, Parameter] = {}
    hold: dict[str, Literal["none"] | HoldEntry] = {}
    windows: WhenBroken | None = None
    steps: list[StepEntry] = Field(min_length=1, max_length=2000)
    on_cancel: OnCancelEntry | None = None

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
    width_mm: float = Field(gt=0)
    height_mm: float = Field(gt=0)


class Wells(Part):
    """A grid of wells. ``a1_x_mm`` and ``a1_y_mm`` are the distances of the centre of A1 from the left and
    the back edge; ``volume_ul`` is the capacity of a well."""

    rows: int = Field(ge=1)
    columns: int = Field(ge=1)
    pitch_mm: float = Field(gt=0)
    a1_x_mm: float = 0.0
    a1_y_mm: float = 0.0
    volume_ul: float = Field(gt=0)


class LabwareType(Part):
    """A kind of labware; ``grips`` are the possible grips (an empty list: any). A type that is not
    ``stackable`` is refused at stacks of more than one piece."""

    description: str = ""
    footprint: Footprint
    wells: Wells | None = None
    stackable: bool = True
    grips: list[str] = []
    source: str = ""


class LabwareFile(Part):
    """Labware types by name."""

    labos: Literal[1] = 1
    labware: dict[Name, LabwareType] = Field(min_length=1)

"""Completes another lab's workcell file from the workflows that use it.

Modules without a description are drafted: actions and arguments as the workflows write them, and stations
where they put labware. Each assumption gives a warning, so that a person can correct it.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from labos.core.arguments import list_names
from labos.core.effects import Unlid
from labos.core.ids import local, split_place
from labos.core.model import ActionSpec, Description
from labos.spec.about import About, ActionAbout, ArgAbout, ExtendedAction, Extends, StationAbout
from labos.spec.findings import Remarks
from labos.spec.interfaces import is_configured
from labos.spec.models import ModuleEntry, StationEntry, WorkcellFile
from labos.spec.references import find_result, list_keys
from labos.spec.stations import Stations, strip_place
from labos.spec.uses import ResultUse, Use

DURATION_S = 10.0
"""The assumed duration of an action without a known one (lab seconds)."""

SOURCES = ("source", "from", "pos1", "pick", "start", "source_location", "from_location")
TARGETS = ("target", "to", "pos2", "place", "end", "destination", "target_location", "to_location", "dest")
"""Names of arguments between which labware is carried."""

PLACES = (*SOURCES, *TARGETS, "location", "loc", "position", "pos", "station", "nest")
"""Names of arguments whose texts are places."""


def draft_modules(
    file: WorkcellFile,
    described: Mapping[str, Description],
    uses: Sequence[Use],
    remarks: Remarks,
) -> WorkcellFile:
    """The file with the actions of its modules that are not known yet. ``described`` are the modules with a
    description from a driver or the file itself, by name."""
    places = _list_places(file)
    modules = []
    for index, entry in enumerate(file.modules):
        wanted = [use for use in uses if use.module == entry.name]
        known = described.get(entry.name)
        change: dict[str, Any] = {}
        if entry.active and known is None and entry.about is None:
            change = {
                "about": _draft_about(entry, wanted, places, described),
                "driver": "",
                "active": True,
            }
            _warn_of_missing_driver(entry, ("modules", index), wanted, remarks)
        elif entry.active and known is not None and entry.about is None:
            more = _draft_extends(known, wanted, places, remarks, ("modules", index), described)
            change = {"extends": more} if more else {}
        modules.append(entry.model_copy(update=change))
    return file.model_copy(update={"modules": modules})


def draft_stations(
    file: WorkcellFile,
    described: Mapping[str, Description],
    uses: Sequence[Use],
    stations: Stations,
    remarks: Remarks,
) -> WorkcellFile:
    """The file with the places that the workflows name and that have no description, and with the arms that
    reach them. A module's own node gets the workflow's word for a place that it was not taught. ``stations``
    are the known ones."""
    written = dict(file.stations)
    warned: set[str] = set()
    words: dict[str, dict[str, str]] = {}
    for use in uses:
        action = described[use.module].action(use.action) if use.module in described else None
        if action is None:
            continue
        for text, is_end in _list_named_places(use, action):
            name = _find(stations, text, use.module)
            if name is None:
                name = _declare(text, described, file, written)
                if text not in warned:
                    warned.add(text)
                    what = name if _find(stations, name, "") else f"a nest, {name}"
                    remarks.add_warning(
                        f"There is no description of the place {text!r} ({use.where}): it is assumed "
                        f"to be {what}.",
                        ("stations", name),
                        "Describe it: `stations: {{name}: {kind: …}}`.",
                        assumed="place",
                    )
            if text != name and not _is_taught(stations, file, use.module, name):
                words.setdefault(use.module, {}).setdefault(name, text)
            is_own = name.startswith(f"{use.module}.")
            is_taught = is_own or _is_taught(stations, file, use.module, name)
            if is_end and use.module in file.locations and not is_taught:
                entry = written.get(name, StationEntry())
                if use.module not in entry.reach:
                    written[name] = entry.model_copy(update={"reach": {**entry.reach, use.module: []}})
                    remarks.add_warning(
                        f"{use.module} was never taught {name}, which it reaches in {use.where}.",
                        ("locations", use.module),
                        f"Teach it before it runs for real: `locations: {{{use.module}: {{{name}: […]}}}}`.",
                        key=True,
                        assumed="pose",
                    )
    modules = [_with_words(entry, words.get(entry.name, {})) for entry in file.modules]
    return file.model_copy(update={"stations": written, "modules": modules})


def _with_words(entry: ModuleEntry, words: Mapping[str, str]) -> ModuleEntry:
    """Add the words to a module whose own node has other names for places than LabOS."""
    if not words or not is_configured(entry.interface, entry.config):
        return entry
    ways = {**words, **(entry.config.get("representations") or {})}
    return entry.model_copy(update={"config": {**entry.config, "representations": ways}})


def takes_lids_off(uses: Iterable[Use], described: Mapping[str, Description]) -> bool:
    """Whether any step takes a lid off a plate."""
    return any(
        isinstance(effect, Unlid)
        for use in uses
        if use.module in described and (action := described[use.module].action(use.action)) is not None
        for effect in action.effects
    )


# -- what a module offers ------------------------------------------------------------------------


def _draft_about(
    entry: ModuleEntry, uses: Sequence[Use], places: set[str], described: Mapping[str, Description]
) -> About:
    actions = {name: _draft_action(named, places, described) for name, named in _sort_by_action(uses).items()}
    carries = any(effect for action in actions.values() for effect in action.effects)
    stations = {"gripper": StationAbout(kind="gripper")} if carries else {}
    what = entry.comment or entry.model or "An instrument that no driver serves"
    return About(
        description=f"{what}. Drafted from the workflows that use it.",
        manipulator=carries,
        stations=stations,
        actions=actions,
    )


def _draft_extends(
    known: Description,
    uses: Sequence[Use],
    places: set[str],
    remarks: Remarks,
    path: tuple[str | int, ...],
    described: Mapping[str, Description],
) -> Extends | None:
    found: dict[str, ExtendedAction] = {}
    for offered, named in _sort_by_action(uses, known).items():
        action, name = known.action(offered), named[0].action
        fitting = [use for use in named if action is None or not _lacks_args(action, use)]
        new = _list_unknown_args(action, fitting) if action is not None else []
        where = (fitting or named)[0].where
        if action is None:
            found[offered] = ExtendedAction(**_draft_action(named, places, described).model_dump())
            message = f"The driver {known.driver} does not know the action {name!r} ({where})."
        elif not fitting:
            found[offered] = ExtendedAction(
                replaces=True, **_draft_action(named, places, described).model_dump()
            )
            message = f"The driver {known.driver} knows {name!r} with other arguments ({where})."
        elif new:
            args = {arg: _draft_arg(arg, fitting, places, required=False) for arg in new}
            found[offered] = ExtendedAction(args=args, duration=action.duration_s)
            some = ", ".join(new)
            message = f"The driver {known.driver} does not know what {some} of {name!r} means ({where})."
        else:
            continue
        drafted = found.get(offered)
        is_silent = drafted is not None and drafted.effects == [] and (action is None or drafted.replaces)
        believes = " LabOS assumes that it moves no labware." if is_silent else ""
        remarks.add_warning(
            f"{message} LabOS passes it on unchanged, without knowing what it means.{believes}",
            path,
            "Write below `extends:` what it does, or correct its name.",
            assumed="action",
        )
    return Extends(actions=found) if found else None


def _list_unknown_args(action: ActionSpec, uses: Iterable[Use]) -> list[str]:
    known = list_names(action)
    return list(dict.fromkeys(name for use in uses for name in use.args if name not in known))


def _lacks_args(action: ActionSpec, use: Use) -> bool:
    """Whether a step leaves out an argument that the driver needs."""
    return any(
        arg.required and not any(name in use.args for name in (arg.name, *arg.aliases)) for arg in action.args
    )


def _draft_action(uses: Sequence[Use], places: set[str], described: Mapping[str, Description]) -> ActionAbout:
    """An action drafted from its steps. An action with two places carries labware from one to the other. Its
    result has the fields that later steps read."""
    names = list(dict.fromkeys(name for use in uses for name in use.args))
    always = {name for name in names if all(name in use.args for use in uses)}
    args = {name: _draft_arg(name, uses, places, required=name in always) for name in names}
    ends = [name for name, arg in args.items() if arg.type == "station" and name in always]
    effects: list[dict[str, dict[str, Any] | None]] = []
    source = next((name for name in ends if name.lower() in SOURCES), "")
    target = next((name for name in ends if name.lower() in TARGETS), "")
    if source and target:
        effects = [{"move": {"source": f"{{{source}}}", "target": f"{{{target}}}"}}]
    returns: Any = None
    for later in (later for use in uses for later in use.result_uses):
        returns = _add_field(returns, later.fields, _make_example_value(later, described))
    return ActionAbout(args=args, effects=effects, duration=DURATION_S, returns=returns)


def _add_field(returns: Any, fields: Sequence[str], value: Any) -> Any:
    """The result with this value added, unless it has one there."""
    if not fields:
        return value if returns is None else returns
    inner = returns if isinstance(returns, dict) else {}
    name, *rest = fields
    return {**inner, name: _add_field(inner.get(name), rest, value)}


def _make_example_value(later: ResultUse, described: Mapping[str, Description]) -> Any:
    """A value that fits the argument of a later step."""
    action = described[later.module].action(later.action) if later.module in described else None
    arg = list_names(action).get(later.arg) if action is not None else None
    kind = arg.type if arg is not None else "any"
    if kind == "file" or "files" in later.fields:
        return {"file": "simulated.txt", "text": "simulated\n"}
    if arg is not None and arg.default is not None:
        return arg.default
    if arg is not None and arg.choices:
        return arg.choices[0]
    if kind in ("int", "float") and arg is not None:
        return arg.minimum if arg.minimum is not None else min(0, arg.maximum or 0)
    return {"str": "simulated", "bool": False, "list": [], "dict": {}}.get(kind, 0)


def _draft_arg(name: str, uses: Iterable[Use], places: set[str], *, required: bool) -> ArgAbout:
    values = [use.args[name] for use in uses if name in use.args]
    is_place = all(_is_place(name, value, places) for value in values)
    return ArgAbout(type="station" if is_place else "any", required=required)


def _is_place(name: str, value: Any, places: set[str]) -> bool:
    """Whether an argument names a place. Joint values instead of a place are reported later."""
    if name.lower() in PLACES:
        return isinstance(value, str | list)
    return isinstance(value, str) and strip_place(value) in places


def _sort_by_action(uses: Iterable[Use], known: Description | None = None) -> dict[str, list[Use]]:
    """The steps that use an action, by its name. Steps that use an alias of a ``known`` action are
    included."""
    found: dict[str, list[Use]] = {}
    for use in uses:
        action = known.action(use.action) if known is not None else None
        found.setdefault(action.name if action is not None else use.action, []).append(use)
    return found


# -- places --------------------------------------------------------------------------------------


def _list_places(file: WorkcellFile) -> set[str]:
    """The places that the file names."""
    return {strip_place(place) for places in file.locations.values() for place in places} | {
        strip_place(place) for place in file.stations
    }


def _list_named_places(use: Use, action: ActionSpec) -> list[tuple[str, bool]]:
    """The places that a step names, and whether labware is carried from or to them."""
    ends = {
        str(getattr(effect, field)).strip("{}")
        for effect in action.effects
        for field in ("source", "target")
        if hasattr(effect, field)
    }
    known = list_names(action)
    return [
        (value, known[name].name in ends)
        for name, value in use.args.items()
        if name in known and known[name].type == "station"
        if isinstance(value, str) and value and not list_keys(value) and find_result(value) is None
    ]


def _find(stations: Stations, text: str, module: str) -> str | None:
    """The file's name of the station to which a step's word refers; None if there is none."""
    found = stations.find_known(text, module)
    return local(found) if found is not None else None


def _declare(
    text: str, described: Mapping[str, Description], file: WorkcellFile, written: dict[str, StationEntry]
) -> str:
    """Add a place without a description, under the module with whose name it begins. Returns its name."""
    bare = strip_place(text)
    owner, last = split_place(bare)
    owner = next((entry.name for entry in file.modules if entry.name.lower() == owner.lower()), owner)
    aliases: list[str] = []
    if not owner:
        modules = sorted((entry.name for entry in file.modules), key=len, reverse=True)
        owner = next((name for name in modules if _begins_with(bare, name)), "wc")
        last = bare[len(owner) :].lstrip("_- ") if owner != "wc" else bare
        last = _find_station_like(last, described.get(owner)) or "default"
        aliases = [] if owner == "wc" else [text]
    name = f"{owner}.{last}"
    entry = written.get(name, StationEntry())
    more = [alias for alias in aliases if alias not in entry.aliases]
    written[name] = entry.model_copy(update={"aliases": [*entry.aliases, *more]})
    return name


def _begins_with(place: str, module: str) -> bool:
    """Whether a place begins with a module's name: ``ot2_alpha_deck1``."""
    return re.match(rf"{re.escape(module)}([_\- ]|$)", place, re.IGNORECASE) is not None


def _find_station_like(last: str, description: Description | None) -> str:
    """The driver's station to which a word refers, or the word itself."""
    own = {station.name.lower(): station.name for station in (description.stations if description else ())}
    places = [name for name in own.values() if name != "gripper"]
    if not last and len(places) == 1:
        return places[0]
    # ``ot2_alpha_deck1``: the last of several words may be a station's name.
    final = re.split(r"[_\- ]", last.lower())[-1]
    return own.get(last.lower(), own.get(final, last))


def _is_taught(stations: Stations, file: WorkcellFile, module: str, place: str) -> bool:
    """Whether a module was taught the pose for a place."""
    return any(_find(stations, taught, module) == place for taught in file.locations.get(module, {}))


# -- what is reported ----------------------------------------------------------------------------


def _warn_of_missing_driver(
    entry: ModuleEntry, path: tuple[str | int, ...], uses: Sequence[Use], remarks: Remarks
) -> None:
    what = f"the model {entry.model!r}" if entry.model else "no model"
    names = ", ".join(sorted({use.action for use in uses}))
    drafted = f"its actions are drafted from the workflows: {names}" if names else "no workflow uses it"
    remarks.add_warning(
        f"There is no driver for the module {entry.name!r} ({what}); {drafted}.",
        (*path, "model") if entry.model else path,
        "It can be simulated. Write below `about:` what its actions do to labware and how long they take.",
        assumed="module",
    )

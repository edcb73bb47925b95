"""Proposes how a workflow of one workcell runs on another: the corresponding modules, and the differences."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import PurePath
from typing import Any

import msgspec

from labos.core.arguments import list_names
from labos.core.ids import local, split_written_place
from labos.core.model import Description, Workcell
from labos.errors import BadInput
from labos.spec.about import describe_modules
from labos.spec.findings import suggest_name
from labos.spec.models import StepEntry, WorkflowFile
from labos.spec.references import iterate_texts, list_keys
from labos.spec.stations import Stations

SAME_DRIVER, SAME_NAME, BOTH_CARRY, ACTION, ARGUMENT, STATION = 40.0, 20.0, 10.0, 4.0, 0.5, 2.0
"""Points for a candidate module: for the same driver, the same name, or if both are manipulators; and for
each action, argument and station that the workflow uses."""


NAMES_NOTHING = ("name", "description", "metadata", "labos")
"""Keys of a workflow file below which names are not names of modules."""


class ModuleMatch(msgspec.Struct, frozen=True):
    """A module of the old workcell and the one that replaces it (empty: none), with the reason ``why``."""

    module: str
    becomes: str
    why: str


class Retargeting(msgspec.Struct, frozen=True):
    matches: list[ModuleMatch]
    misfits: list[str]

    @property
    def mapping(self) -> dict[str, str]:
        return {match.module: match.becomes for match in self.matches if match.becomes}


class _Need(msgspec.Struct):
    """The actions with their arguments, and the stations, that a workflow needs of a module."""

    actions: dict[str, set[str]] = {}
    stations: set[str] = set()


def propose(
    file: WorkflowFile,
    old: Workcell,
    new: Workcell,
    given: Mapping[str, str],
    descriptions: Mapping[str, Description],
) -> Retargeting:
    """The modules of ``new`` that replace those of ``old``; ``given`` fixes some of them. Raises BadInput for
    a name of no module."""
    before, after = (
        {local(name): about for name, about in describe_modules(cell, descriptions).items()}
        for cell in (old, new)
    )
    for one, other in given.items():
        _refuse_strangers(one, before, old.name)
        _refuse_strangers(other, after, new.name)
    places = Stations(new.name, new.stations)
    matches, misfits = list[ModuleMatch](), list[str]()
    for name, need in _list_needs(file, before).items():
        if name in given:
            chosen, why = given[name], "as you said"
        else:
            chosen, why = _choose(name, before[name], need, after, places)
        matches.append(ModuleMatch(name, chosen, why))
        if chosen:
            misfits += _list_misfits(name, chosen, after[chosen], need, places)
        else:
            actions = ", ".join(sorted(need.actions)) or "only stations, no action"
            misfits.append(f"No module of {new.name} stands in for {name} ({actions}).")
    return Retargeting(matches, misfits)


def _refuse_strangers(name: str, modules: Mapping[str, Description], workcell: str) -> None:
    if name not in modules:
        raise BadInput(
            f"--map: the workcell {workcell} has no module {name!r}.",
            remedy=suggest_name(name, modules, "module"),
        )


def _list_needs(file: WorkflowFile, modules: Mapping[str, Description]) -> dict[str, _Need]:
    """The needs by module, in the order in which the workflow names them."""
    found: dict[str, _Need] = {}
    for _, entry in file.iterate_entries():
        if entry.module in modules and not list_keys(entry.module):
            need = found.setdefault(entry.module, _Need())
            need.actions.setdefault(entry.action, set()).update(entry.args)
        for owner, station in _iterate_places(entry, modules):
            found.setdefault(owner, _Need()).stations.add(station)
    return found


def _iterate_places(entry: StepEntry, modules: Mapping[str, Description]) -> Iterator[tuple[str, str]]:
    values: list[Any] = [entry.args, entry.payload]
    for text in iterate_texts([value for value in values if value]):
        owner, station = split_written_place(text)
        if owner in modules and re.fullmatch(r"[\w.]+", station):
            yield owner, station


def _choose(
    wanted: str, old: Description, need: _Need, modules: Mapping[str, Description], places: Stations
) -> tuple[str, str]:
    """The module with the most points for ``wanted`` among those that have all actions; with equal
    points, the first by name."""
    best, chosen, why = 0.0, "", "no module here does that"
    for name, module in sorted(modules.items()):
        actions = {action: module.action(action) for action in need.actions}
        held = [station for station in need.stations if places.list_matches(f"{name}.{station}")]
        if None in actions.values() or not (actions or held):
            continue
        taken = sum(
            bool(spec and arg in list_names(spec))
            for action, spec in actions.items()
            for arg in need.actions[action]
        )
        reasons = {
            "the same driver": SAME_DRIVER * (module.driver == old.driver),
            "the same name": SAME_NAME * (name == wanted),
            "both carry": BOTH_CARRY * (module.manipulator and old.manipulator),
            "the same actions": ACTION * len(actions) + ARGUMENT * taken,
            "the same stations": STATION * len(held),
        }
        if (score := sum(reasons.values())) > best:
            best, chosen = score, name
            why = ", ".join(reason for reason, weight in reasons.items() if weight)
    return chosen, why


def _list_misfits(name: str, new: str, about: Description, need: _Need, places: Stations) -> Iterator[str]:
    """The needs of the workflow that the module ``new`` does not fulfil."""
    for action, args in sorted(need.actions.items()):
        spec = about.action(action)
        if spec is None:
            yield f"{new} has no action {action!r}, which {name} has."
            continue
        known = list_names(spec)
        for arg in sorted(args - known.keys()):
            yield f"{new}.{action} takes no argument {arg!r}, which {name}.{action} takes."
    for station in sorted(need.stations):
        if not places.list_matches(f"{new}.{station}"):
            yield f"{new} has no station {station!r}: make it an alias of one in the workcell file."


def rename(text: str, mapping: Mapping[str, str], workcells: tuple[str, str]) -> str:
    """A workflow's text with the new names of modules and of the workcell; the rest, with its comments, is
    not changed."""
    old, new = (PurePath(cell).stem for cell in workcells)
    names = {one: other for one, other in mapping.items() if one != other}
    some = "|".join(sorted(map(re.escape, names), key=len, reverse=True))
    in_steps = re.compile(rf"(?<![\w./-])(?:{some})(?=\.\w)|(?<=module: )(?:{some})(?![\w.-])")
    in_lists = re.compile(rf"(?<![\w./-])(?:{some})(?![\w-])")
    whole = rf"(?<![\w-]){re.escape(old)}(?![\w-])"
    last_name = re.compile(rf"{whole}(?!.*{whole})")  # folders may have the same name
    lines, top = [], ""
    for line in text.split("\n"):
        if key := re.match(r"([\w-]+):", line):
            top = key[1]
        if top == "workcell":
            line = last_name.sub(new, line)
        elif names and top not in NAMES_NOTHING and not line.lstrip().startswith("#"):
            pattern = in_lists if top in ("modules", "hold") else in_steps
            line = pattern.sub(lambda found: names[found[0]], line)
        lines.append(line)
    return "\n".join(lines)


def compare_lines(old: str, new: str) -> Sequence[str]:
    """The lines that differ, in the form of ``diff``."""
    import difflib

    return [
        line
        for line in difflib.unified_diff(
            old.splitlines(), new.splitlines(), "before", "after", lineterm="", n=0
        )
        if not line.startswith("@@")
    ]

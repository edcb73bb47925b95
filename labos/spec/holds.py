"""The modules that a run keeps from others, besides those that its labware there keeps.

By default, a run that works on a module before it brings its labware there (opens its lid, warms it up) keeps
the module until the labware has arrived. ``hold:`` changes this.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence

from labos.core.effects import list_carried
from labos.core.ids import ModuleName, StationName
from labos.core.model import MAIN, Hold, ModuleSpec, PlanStep
from labos.spec.findings import Remarks, suggest_name
from labos.spec.models import HoldEntry
from labos.spec.steps import Steps


def make_holds(
    written: Mapping[str, str | HoldEntry],
    modules: Mapping[str, ModuleSpec],
    claims: Mapping[StationName, str],
    steps: Steps,
    planned: Sequence[PlanStep],
    remarks: Remarks,
) -> tuple[Hold, ...]:
    """The holds of a plan. ``claims`` returns the module to whose deck a station belongs. Faults go to the
    remarks."""
    order = [index for index in steps.sort_steps() if steps.layout.leaves[index].part == MAIN]
    explicit: dict[ModuleName, Hold | None] = {}
    for name, entry in written.items():
        module = modules.get(name)
        if module is None:
            remarks.error(
                f"There is no module {name!r} to hold.",
                ("hold", name),
                suggest_name(name, modules, "module"),
                key=True,
            )
            continue
        explicit[module.name] = None
        if isinstance(entry, HoldEntry):
            first = steps.find(entry.start, ("hold", name, "from"))
            last = steps.find(entry.until, ("hold", name, "until"))
            if first is None or last is None:
                continue
            if order and not {first, last} <= set(order):
                remarks.error("A step for emergencies holds nothing.", ("hold", name), "Name other steps.")
                continue
            if order and order.index(last) < order.index(first):
                remarks.error(
                    f"The step {entry.until!r} comes before {entry.start!r}.",
                    ("hold", name, "until"),
                    "Name a later step.",
                )
                continue
            explicit[module.name] = Hold(module.name, first, last)
    found = [hold for hold in make_default_holds(claims, planned, order) if hold.module not in explicit]
    return (*found, *(hold for hold in explicit.values() if hold is not None))


def make_default_holds(
    claims: Mapping[StationName, str], planned: Sequence[PlanStep], order: Sequence[int]
) -> list[Hold]:
    """Holds from a run's first work on a module with a deck to the step that brings its labware there."""
    decks = set(claims.values())
    standing: Counter[str] = Counter()
    begun: dict[str, int] = {}
    found: list[Hold] = []
    for index in order:
        step = planned[index]
        moves = list_carried(step.effects)
        if step.exclusive and not moves and step.module in decks and not standing[step.module]:
            begun.setdefault(step.module, index)
        for effect in moves:
            standing[claims.get(effect.emptied, "")] -= 1
            deck = claims.get(effect.filled, "")
            standing[deck] += 1
            if deck in begun:
                found.append(Hold(ModuleName(deck), begun.pop(deck), index))
    return found

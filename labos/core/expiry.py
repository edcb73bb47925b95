"""What is past its date is not used, unless the workcell says that it may be.

A pack is good through the day that it bears (``2027-05-31``, by UTC). What an action uses comes from
the oldest packs first, so an old one that is past its date keeps the fresh ones behind it from being
used: somebody has to take it out.
"""

from __future__ import annotations

import re

from labos.core import reasons
from labos.core.days import day_of
from labos.core.effects import Consumes
from labos.core.ids import ModuleName
from labos.core.model import PlanStep
from labos.core.resources import Level, Lot, sum_needed
from labos.core.runs import RunState
from labos.core.state import LabState
from labos.core.waits import Wait, module_key

DATE = re.compile(r"\d{4}-(0[1-9]|1[0-2])-(0[1-9]|[12]\d|3[01])")
"""A day as packs bear it."""

WARN = "warn"
"""What a module's ``expired`` says where old packs may be used all the same."""


def check_in_date(state: LabState, run: RunState, step: PlanStep, now: int) -> Wait | None:
    """Whether what a step uses up is not past its date; of a run that is still to be let in, what all
    its steps use up: it would stop half-way."""
    amounts: dict[tuple[ModuleName, str], float] = {}
    if run.has_started:
        for effect in step.effects:
            if isinstance(effect, Consumes):
                amounts[step.module, effect.resource] = sum_needed(step.effects, effect.resource)
    else:
        for _, module, resource, amount in state.runs.plans[run.plan].uses_up:
            amounts[module, resource] = amounts.get((module, resource), 0.0) + amount
    for (module, resource), amount in amounts.items():
        level = state.resources.find(module, resource)
        if level is None or not any(lot.expires for lot in level.lots):
            continue
        known = state.modules.by_name.get(module)
        old = find_first_expired(level, amount, day_of(now))
        if old is not None and known is not None and known.spec.expired != WARN:
            names = (module, resource, old.name or "without a name", old.expires)
            return Wait(reasons.Expired(*names), (module_key(module),))
    return None


def find_first_expired(level: Level, amount: float, today: str) -> Lot | None:
    """The first pack past its date among those that an amount comes from."""
    for lot in level.lots:
        if amount <= 0:
            return None
        if lot.expires and lot.expires < today:
            return lot
        amount -= lot.left
    return None

"""Resources after their expiry date are not used, unless the workcell allows it.

A pack may be used through its last day (``2027-05-31``, by UTC). An action uses the oldest packs first. So an
old pack after its expiry date keeps newer packs from being used: a person has to take it out.
"""

from __future__ import annotations

import re

from labos.core import reasons
from labos.core.days import day_of
from labos.core.effects import Consumes
from labos.core.ids import ModuleName, module_key
from labos.core.model import PlanStep
from labos.core.resources import Level, Lot, sum_by_supply, sum_needed
from labos.core.runs import RunState
from labos.core.state import LabState
from labos.core.waits import Wait

DATE = re.compile(r"\d{4}-(0[1-9]|1[0-2])-(0[1-9]|[12]\d|3[01])")
"""A date as packs show it."""

WARN = "warn"
"""The value of a module's ``expired`` that allows the use of old packs."""


def check_in_date(state: LabState, run: RunState, step: PlanStep, now: int) -> Wait | None:
    """Check that the packs for a step are not after their expiry date. For a run that has not started, the
    packs for all its steps are checked: otherwise it would stop half-way."""
    amounts: dict[tuple[ModuleName, str], float] = {}
    if run.has_started:
        for effect in step.effects:
            if isinstance(effect, Consumes):
                amounts[step.module, effect.resource] = sum_needed(step.effects, effect.resource)
    else:
        amounts = sum_by_supply(state.runs.plans[run.plan].uses_up)
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
    """The first pack after its expiry date among the packs from which an amount is taken."""
    for lot in level.lots:
        if amount <= 0:
            return None
        if lot.expires and lot.expires < today:
            return lot
        amount -= lot.left
    return None

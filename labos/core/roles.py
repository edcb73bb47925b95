"""The role of a user in a workcell, and the role that a plan needs."""

from __future__ import annotations

from labos.core.model import Plan, PlanStep
from labos.core.state import LabState
from labos.core.users import ROLES, Role, rank


def rank_role_in(state: LabState, user: str, cell: str) -> int:
    """The rank of a user's role in a workcell (``*``: in the whole lab; empty: the best anywhere)."""
    return state.users.rank_role(user, state.shares.group_of.get(user, ""), cell)


def find_role_for(plan: Plan) -> Role:
    """The role that is needed to submit a run of a plan. Resetting a module after an error needs an operator,
    because it is unknown whose work caused the error. A run may reset the module of its own step after that
    step has failed."""
    resets = any(step.recovers and not _follows_own_step(plan, step) for step in plan.steps)
    return "operator" if resets else "submitter"


def _follows_own_step(plan: Plan, step: PlanStep) -> bool:
    return step.serves is not None and plan.steps[step.serves].module == step.module


def explain_lacking_role(state: LabState, user: str, plan: Plan) -> str:
    """Why a run of a plan is not, or no longer, allowed for a user, as a sentence; empty if it is."""
    needs = find_role_for(plan)
    has = rank_role_in(state, user, plan.workcell)
    if state.users.is_open or (state.users.get(user) is not None and has >= rank(needs)):
        return ""
    return f"{plan.workflow!r} needs the role {needs} in {plan.workcell}; {user} is {ROLES[has]} there."

"""Every wait in one sentence, with names."""

from __future__ import annotations

from labos.core.ids import local
from labos.core.waits import Wait

SENTENCES = {
    "paused": "run {0} is paused",
    "halted": "{1} has paused {0}",
    "log_shorter": "this log ends at {1} and {0} knows more: nothing starts before the bench was compared",
    "cancelling": "run {0} is being cancelled",
    "not_pending": "step {0!r} is already under way",
    "after": "an earlier step has not ended",
    "retry_later": "step {0!r} failed and is tried again in a while",
    "asked": "step {0!r} failed, and a person has to say what follows",
    "too_early": "step {0!r} has to wait a set time",
    "no_module": "there is no module {0}",
    "access": "{1} reaches into the workcell {0}",
    "out_of_service": "{0} is out of service ({1})",
    "module_down": "{0} is {1} ({2})",
    "unwatched": "{1}, which looks at {0} after every motion, is {2}",
    "module_busy": "{0} is busy",
    "unsettled": "nobody knows how {0} ended what it did last",
    "held": "{0} is held by {1}",
    "setpoint": "{1} of {0} is set to {2} for {3}",
    "zone_busy": "{0} is at work in the zone {1}",
    "zone_barred": "{0} stands still in the zone {1}",
    "hand_full": "the hand of {0} holds {1}",
    "reached_into": "an arm is reaching into {0}",
    "requires": "{0} needs {1} = {2}",
    "used_up": "{0} has too little {1} left",
    "expired": "{1} of {0} is past its date (lot {2} was good until {3})",
    "stack_empty": "the stack {0} is empty",
    "buried": "{1} stands on top of the stack {0}",
    "uncertain": "it is not known what stands at {0}",
    "lost": "it is not known where {0} is",
    "outcome": "it is not known how step {0!r} ended",
    "in_motion": "{0} is in motion at {1}",
    "not_yours": "{0} at {1} belongs to {2}",
    "undeclared": "nobody has said what stands at {0}",
    "nothing_there": "nothing stands at {0}",
    "no_access": "{0} can be reached only with {1} = {2}",
    "not_accepted": "{0} does not accept {1}",
    "wrong_way": "{0} would lie turned by {2} degrees at {1}, which takes it turned by {3}",
    "no_grip": "{0} cannot hold {2} {3} at {1}, only {4}",
    "waste_full": "the waste {0} is full",
    "occupied": "{0} is occupied by {1}",
    "reserved": "{0} is reserved for run {1}, whose step {2!r} has to start in time",
    "not_in_time": "{0} would not be free in time for {1!r}",
    "would_delay": "starting {0!r} now would make run {1} late for {2!r}",
    "follows_late": "if {0!r} started now, {2!r} could not start in time",
    "after_elder": "run {0} has waited longer and goes first",
    "better_here": "{1} is down, and beyond {0!r} it would stand in others' way",
    "no_way_out": "once started with {0!r} it could not reach its end now",
    "gone": "the run has ended",
}

REMEDIES = {
    "paused": "Let it go on: labos resume {0}",
    "halted": "Let it go on: labos resume {0}",
    "log_shorter": "Go round the bench and say what stands where: labos bench round",
    "asked": "Answer what is asked: labos resolve {1}",
    "no_module": "Set up a workcell that has it: labos up WORKCELL",
    "out_of_service": "Look at it, then answer what is asked (labos resolve) or: labos in-service {0}",
    "access": "It goes on when everybody is out: labos access {0} --done",
    "GONE": "Start its node again: labos node start --name {0} --workcell {workcell}",
    "ERROR": "Look at it, then: labos reset {0}",
    "zone_barred": "Look at it, then: labos reset {0}",
    "unwatched": "Bring {1} back, or write `verify: on_doubt` for {0} in the workcell file.",
    "used_up": "Refill it and say so: labos replenish {0} {1} --lot LOT",
    "expired": "Take the old pack out and say so: labos replenish {0} {1} --lot LOT --instead",
    "stack_empty": "Fill it and say so: labos load {0} --type TYPE --count N --lot LOT",
    "uncertain": "Look there and answer what is asked: labos resolve",
    "lost": "Look for it and answer what is asked: labos resolve",
    "outcome": "Look there and answer what is asked: labos resolve",
    "unsettled": "Look there and answer what is asked: labos resolve {1}",
    "not_yours": "Let a run of its owner move it away.",
    "undeclared": "Say what stands there: labos bench declare {0}=TYPE, or {0}= if nothing does",
    "nothing_there": "Put some there and say so: labos place {0} TYPE",
    "not_accepted": "Put labware there that it accepts, or change `accepts:` in the workcell file.",
    "waste_full": "Empty it and say so: labos unload {0} --all",
    "wrong_way": "Grip it otherwise in the workflow (narrow here, wide there), or turn it by hand.",
    "no_grip": "Grip it otherwise in the workflow, or teach the arm and say so under `reach:`.",
    "occupied": "It goes on when a run moves that away; what no run moves any more, take away and say so: "
    "labos unload {0}",
    "hand_full": "It goes on when a run puts that down.",
    "buried": "It goes on when a run moves that away.",
    "no_way_out": "It is let in when its way is free; what nobody moves needs a run that takes it away.",
}
"""What a person can do about a wait; those that pass by themselves have none."""


def remedy(wait: Wait) -> str:
    """What a person can do about a wait; empty if there is nothing to do but wait."""
    code = wait.names[1] if wait.code == "module_down" and len(wait.names) > 1 else wait.code
    first = wait.names[0] if wait.names else ""
    workcell = first.partition("/")[0]
    second = wait.names[1] if len(wait.names) > 1 else ""
    return REMEDIES.get(code, "").format(_named(first), _named(second), workcell=workcell)


def sentence(wait: Wait) -> str:
    """What a wait is for, in words a scientist uses."""
    names = [_named(name) for name in wait.names]
    if wait.code == "unsafe":
        return f"starting {names[0]!r} now would trap {', '.join(_who(n) for n in wait.names[1:])}"
    template = SENTENCES.get(wait.code, wait.code + " {0}")
    return template.format(*names, *("",) * 6).replace(" ()", "")


def _named(name: str) -> str:
    """A module, station or labware without its workcell; an owner in words."""
    kind, colon, which = name.partition(":")
    return f"{kind} {which}" if colon and kind in ("run", "experiment", "user") else local(name)


def _who(name: str) -> str:
    kind, _, which = name.rpartition(":")
    return f"experiment {which}" if kind == "experiment" else f"run {which}"

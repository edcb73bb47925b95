"""``decide`` answers a command with events or a rejection. There is one file per family of commands.

``carry_out`` folds these events, and then the events that follow from them (``reactions``). So each event is
computed from the state after all earlier ones.
"""

from collections.abc import Callable

from labos.core.decide._base import DECIDERS, UNFIT, Command, Decision, Rejection, Report, check_recordable
from labos.core.decide.limits import cut_report, refuse_misfit, shorten_report
from labos.core.decide.reactions import REACTIONS
from labos.core.decide.rights import Denied, check_rights  # its table imports the modules of all commands
from labos.core.decide.submissions import hold_for_approval, name_both_actors
from labos.core.decide.wording import refer_to_words
from labos.core.registry import Event
from labos.core.state import LabState
from labos.core.users import LABOS
from labos.core.words import Keep

__all__ = ["LABOS", "REACTIONS", "Command", "Decision", "Denied", "Rejection", "carry_out", "decide"]

MOST_REACTIONS = 10_000
"""The most events that may follow from a command, unless the command itself has more than a tenth of this
number."""


def carry_out(
    state: LabState,
    command: Command,
    write: Callable[[Event], Event],
    actor: str,
    keep: Keep | None = None,
) -> list[Event] | Rejection:
    """Decide a command of ``actor``. ``write`` folds each of its events, and returns the event as it is
    stored, before the next event is computed. Then the events that follow are computed, in order, until no
    more follow. With ``keep``, the words of the command are stored beside the log. Returns all these events,
    or why the command cannot be carried out: then nothing was written. If an exception is raised, the state
    is left with a part of the events."""
    decision = decide(state, command, actor, keep)
    if isinstance(decision, Rejection):
        return decision
    events = [write(event) for event in decision]
    most = len(events) + max(MOST_REACTIONS, 10 * len(events))
    for event in events:  # includes the events that are added meanwhile
        for react in REACTIONS.get(type(event), ()):
            for follows in react(state, event):
                events.append(write(follows))
                if len(events) > most:
                    raise RuntimeError(f"The reactions to {type(command).__name__} do not end.")
    return events


def decide(state: LabState, command: Command, actor: str, keep: Keep | None = None) -> Decision:
    """The events that carry out a command of ``actor``, or why it cannot be carried out (``Denied`` if the
    actor may not). The state is not changed. The events that follow from these are not included."""
    if refusal := check_rights(state, command, actor):
        return refusal
    if isinstance(command, Report):
        command = cut_report(command)
    elif fault := refuse_misfit(command):
        return fault
    elif keep is not None:
        command = refer_to_words(command, keep)
    decision = _decide(state, command, actor)
    if isinstance(command, Report) and isinstance(decision, Rejection) and decision.code == UNFIT:
        return _decide(
            state, shorten_report(command), actor
        )  # a report of a past event is recorded in any case, if necessary without the words
    return decision


def _decide(state: LabState, command: Command, actor: str) -> Decision:
    command = name_both_actors(command, actor)
    return check_recordable(hold_for_approval(state, command, DECIDERS[type(command)](state, command), actor))

"""Fold: one event after the other into the state. The state is changed in place."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable
from operator import attrgetter
from typing import Any, get_type_hints

from labos.core import (
    actions,
    approvals,
    bench,
    bookings,
    campaigns,
    erasure,
    failures,
    interventions,
    lab,
    lengths,
    modules,
    open_experiments,
    repeated,
    resources,
    runs,
    shares,
    shorter,
    signatures,
    steps,
    suggestions,
    users,
)
from labos.core.actions import ActionRequested, ActionSucceeded
from labos.core.bookings import BookingCancelled, BookingEnded
from labos.core.campaigns import CampaignCompleted
from labos.core.experiments import ExperimentEnded
from labos.core.interventions import InterventionResolved
from labos.core.labware import LabwareRemoved
from labos.core.registry import TYPES, Event, decode, list_handlers
from labos.core.runs import RunCancelled, RunCompleted, RunFailed, RunSubmitted
from labos.core.state import LabState

Handler = Callable[[Any, Any, int], None]

_SLICES = (
    (lab, "lab"),
    (modules, "modules"),
    (failures, "modules"),
    (bench, "bench"),
    (actions, "actions"),
    (runs, "runs"),
    (steps, "runs"),
    (approvals, "runs"),
    (resources, "resources"),
    (interventions, "interventions"),
    (open_experiments, "experiments"),
    (shares, "shares"),
    (campaigns, "campaigns"),
    (shorter, "shorter"),
    (users, "users"),
    (approvals, "campaigns"),
    (approvals, "experiments"),
    (approvals, "approvals"),
    (bookings, "bookings"),
    (repeated, "lab"),
    (signatures, "lab"),
    (suggestions, "suggestions"),
    (erasure, "erasures"),
)
"""The modules with functions that fold events, and the slice of the state that they change."""


def _make_table() -> dict[type[Event], tuple[tuple[str, Handler], ...]]:
    table: dict[type[Event], list[tuple[str, Handler]]] = {kind: [] for kind in TYPES.values()}
    kinds = get_type_hints(LabState)
    for module, name in _SLICES:
        for kind, handler in list_handlers(vars(module), kinds[name]).items():
            table[kind].append((name, handler))
    return {kind: tuple(handlers) for kind, handlers in table.items()}


TABLE = _make_table()

_ENDED_STREAMS: dict[type[Event], Callable[[Any], str]] = {
    RunCompleted: attrgetter("run"),
    RunFailed: attrgetter("run"),
    RunCancelled: attrgetter("run"),
    ExperimentEnded: attrgetter("experiment"),
    CampaignCompleted: attrgetter("campaign"),
    LabwareRemoved: attrgetter("labware"),
    InterventionResolved: InterventionResolved.stream,
    BookingCancelled: BookingCancelled.stream,
    BookingEnded: lambda event: event.stream() if event.over else "",
}
"""Events that end a stream, with the function that finds the stream (empty: none): no event may follow in
it."""


def _learn(state: LabState, event: ActionSucceeded, at: int) -> None:
    """Learn the duration of an action before its record is deleted. An action with a set-up before it is not
    used: learned durations are without set-ups."""
    action, run = state.actions.open.get(event.action), state.runs.active.get(event.run)
    if action is not None and run is not None:
        step = state.runs.plan_of(run).steps[event.step]
        flight = state.modules.by_name[event.module].in_flight.get(event.action)
        if flight is None or not flight.setup_s:
            lengths.learn(state.lengths, action, step, at, state.lab.pace)


def evolve(state: LabState, event: Event, position: int, recorded_at: int) -> None:
    """Apply one event to the state. Raises KeyError or ValueError if it contradicts the state: such an event
    must never have been written."""
    kind = type(event)
    if kind is ActionSucceeded:
        _learn(state, event, recorded_at)  # type: ignore[arg-type]
    for name, handler in TABLE[kind]:
        handler(getattr(state, name), event, recorded_at)
    # These two events are identified by their positions in the log.
    if kind is ActionRequested:
        actions.fold_action_requested(state.actions, event, recorded_at, position)  # type: ignore[arg-type]
    elif kind is RunSubmitted:
        runs.fold_run_submitted(state.runs, event, recorded_at, position)  # type: ignore[arg-type]
    stream, versions = event.stream(), state.versions
    versions[stream] = versions.get(stream, 0) + 1
    find_ended = _ENDED_STREAMS.get(kind)
    if find_ended is not None:
        versions.pop(find_ended(event), None)
    state.position, state.recorded_at = position, recorded_at


def fold_rows(state: LabState, rows: Iterable[tuple[Any, ...]]) -> None:
    """Apply stored events: (position, type, schema, recorded_at, payload) of each. Raises the errors of
    ``decode`` and ``evolve``; then the state is at the position before the faulty event."""
    for position, kind, schema, recorded_at, payload in rows:
        evolve(state, decode(kind, schema, payload), position, recorded_at)


def evolve_slices(
    state: LabState, slices: Collection[str], event: Event, position: int, recorded_at: int
) -> None:
    """Apply one event to a state that has only some slices."""
    for name, handler in TABLE[type(event)]:
        if name in slices:
            handler(getattr(state, name), event, recorded_at)
    if isinstance(event, ActionRequested) and "actions" in slices:
        actions.fold_action_requested(state.actions, event, recorded_at, position)
    elif isinstance(event, RunSubmitted) and "runs" in slices:
        runs.fold_run_submitted(state.runs, event, recorded_at, position)
    state.position, state.recorded_at = position, recorded_at

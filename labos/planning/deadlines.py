"""Deadlines: the times after which windows, actions, outages, planned work and so on are late or over.

They are kept in order of time. Only those that an event has touched are computed again.
"""

from __future__ import annotations

from collections.abc import Iterator

from labos.core.decide import Command
from labos.core.decide.experiments import AskAboutClosing
from labos.core.decide.nodes import EndOutage
from labos.core.decide.runs import BreachWindow
from labos.core.decide.steps import TimeOutAction
from labos.core.decide.work import NoteOverdue
from labos.core.ids import ActionId, InterventionId, RunId
from labos.core.rules import (
    convert_lab_s,
    find_due_time,
    find_give_up_time,
    find_late_close,
    find_standstill_time,
)
from labos.core.runs import find_anchor
from labos.core.state import LabState
from labos.planning.alarms import Alarms, find_earliest
from labos.planning.booked import BookingTimes
from labos.planning.forecast import is_pending
from labos.planning.touch import BEGUN, DUE, EVERYTHING, OVER, RUN, WINDOW, Touched


class Deadlines:
    """The deadlines of one state, which only moves forward. ``note_changes`` gets what events touch."""

    def __init__(self) -> None:
        self._windows: Alarms[RunId] = Alarms()
        self._closings: Alarms[RunId] = Alarms()
        self._actions: Alarms[ActionId] = Alarms()
        self._questions: Alarms[InterventionId] = Alarms()
        self._bookings = BookingTimes()
        self._filled = False

    def note_changes(self, state: LabState, touched: Touched) -> None:
        """Recompute the deadlines of what has been touched."""
        if not self._filled or touched.whole:
            self._fill(state)
            return
        named = touched.named
        for cell in named.get(EVERYTHING, ()):
            self._note_cell(state, cell)
        for kind in (OVER, RUN, WINDOW):
            for name in named.get(kind, ()):
                self._note_windows(state, RunId(name))
                self._note_closing(state, RunId(name))
        for kind in (BEGUN, DUE, OVER):
            for name in named.get(kind, ()):
                self._note_action(state, ActionId(name))
                self._note_question(state, InterventionId(name))

    def iterate_due(self, state: LabState, now: int) -> Iterator[Command]:
        """The commands for all deadlines that are due."""
        if not self._filled:
            self._fill(state)
        for run in self._windows.list_due(now):
            for step, window, deadline in list(_list_windows(state, run)):
                if now > deadline:
                    yield BreachWindow(run, step, window, now)
        if actions := self._actions.list_due(now):
            for action in actions:
                self._note_action(state, action)  # its time limit may have been extended since
            for action in self._actions.list_due(now):
                yield TimeOutAction(action, now)
        for module, back_at in list(state.modules.back_at.items()):
            if back_at <= now:
                yield EndOutage(module, now)
        if state.bookings.open:
            yield from self._bookings.iterate_due(state.bookings, now)
        if closings := self._closings.list_due(now):
            for run in closings:
                self._note_closing(state, run)  # a person may have been asked since
            for run in self._closings.list_due(now):
                yield AskAboutClosing(run, now)
        for question in self._questions.list_due(now):
            yield NoteOverdue(question, now)

    def find_first(self, state: LabState) -> int | None:
        """The earliest deadline (UTC ns); None if there is none. It may be past, if nothing followed it."""
        if not self._filled:
            self._fill(state)
        while (at := self._actions.find_first()) is not None:
            # The time limit of an action may have been extended since: its device has answered.
            action = self._actions.list_due(at)[0]
            due = _find_due_time(state, action)
            if due == at:
                break
            self._actions.set(action, due)
        alarms = (self._windows.find_first(), self._closings.find_first(), at, self._questions.find_first())
        return find_earliest(
            *alarms, *state.modules.back_at.values(), self._bookings.find_first(state.bookings)
        )

    # -- computing ---------------------------------------------------------------------------

    def _fill(self, state: LabState) -> None:
        self._filled = True
        self._windows.clear()
        self._closings.clear()
        self._actions.clear()
        self._questions.clear()
        for run in state.runs.windowed:
            self._note_windows(state, run)
        for run in state.runs.queued:
            self._note_closing(state, run)
        for action in state.actions.open:
            self._note_action(state, action)
        for question in state.interventions.open:
            self._note_question(state, question)

    def _note_cell(self, state: LabState, cell: str) -> None:
        for run in state.runs.windowed_in.get(cell, ()):
            self._note_windows(state, run)
        for action in state.actions.list_in_cell(cell):
            self._note_action(state, action.id)

    def _note_closing(self, state: LabState, name: RunId) -> None:
        run = state.runs.queued.get(name)
        due = find_late_close(state, run) if run is not None else None
        self._closings.set(name, None if due is None else due + 1)

    def _note_windows(self, state: LabState, run: RunId) -> None:
        windows = _list_windows(state, run) if run in state.runs.windowed else ()
        self._windows.set(run, min((at + 1 for _, _, at in windows), default=None))

    def _note_action(self, state: LabState, action: ActionId) -> None:
        self._actions.set(action, _find_due_time(state, action))

    def _note_question(self, state: LabState, name: InterventionId) -> None:
        question = state.interventions.open.get(name)
        waits = question is not None and question.due_at > 0 and not question.overdue
        self._questions.set(name, question.due_at if question is not None and waits else None)


def _find_due_time(state: LabState, name: ActionId) -> int | None:
    """The time at which an action in flight passes its time limit (UTC ns). The limit is the time-out of its
    step, or it counts since the node is gone or the device stands still. None if there is no limit."""
    action = state.actions.open.get(name)
    if action is None:
        return None
    times = (
        find_due_time(state, action),
        find_give_up_time(state, action),
        find_standstill_time(state, action),
    )
    known = [due for due in times if due is not None]
    return min(known) + 1 if known else None


def _list_windows(state: LabState, name: RunId) -> Iterator[tuple[int, int, int]]:
    """(step, window, deadline) of every running window of a run's pending steps, without the steps that are
    known to be late. Deadlines are UTC ns."""
    run = state.runs.get(name)
    plan = state.runs.plans[run.plan] if run is not None else None
    for index in plan.windowed if plan is not None else ():
        if run is None or plan is None or run.is_breached(index) or not is_pending(run, index):
            continue
        for number, window in enumerate(plan.plan.steps[index].windows):
            ended = find_anchor(run, window)
            if ended is not None and window.within_s is not None:
                yield index, number, ended + convert_lab_s(state, window.within_s)

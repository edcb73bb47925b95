"""A log that has lost its end: no action starts before a person has checked the whole bench."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import get_args

import msgspec

from labos.core.actions import Action, ActionDiscovered, ActionStatus
from labos.core.bench import StationState, remove_labware, split_item
from labos.core.decide._base import Command, Decision, InnerCommand, Rejection, decides, refuse_hotel
from labos.core.decide.contents import list_contents_events, list_recorded
from labos.core.decide.endings import has_open_action, record_end
from labos.core.decide.lookups import decides_about, expect_station
from labos.core.effects import AnyEffect, Carrying, Needs, list_carried, list_places, name_hand
from labos.core.ids import ActionId, LabwareId, ModuleName, StationName, local, workcell_of
from labos.core.labware import GONE, LabwareUncertain
from labos.core.modules import ModuleStatus, VariableSet
from labos.core.registry import Event
from labos.core.runs import RunCancelled, RunCancelling, RunPaused, RunStatus
from labos.core.shorter import STATIONS_PER_EVENT, BenchCompared, LogFoundShorter, StationsChecked
from labos.core.state import LabState
from labos.core.topics import ShorterLog, WhereItStands, name_some

HIGHEST = 2**53
"""No log has more events than this: a higher position from a node is not believed."""

MOST_EFFECTS = 100
"""If an action lists more effects on the bench than this, its effects count as unknown."""

MANY_FOUND = 100
"""The most actions of one journal that are reported at once."""


class FoundAction(msgspec.Struct, frozen=True):
    """An action in a node's journal that the log does not know. ``effects`` is null if the journal does not
    have the planned effects."""

    action: ActionId
    name: str
    status: str
    position: int = 0
    effects: tuple[AnyEffect, ...] | None = None


class ReportShorterLog(InnerCommand, frozen=True):
    """A part of the system knows a position that this log does not have. ``evidence`` names it (a checkpoint,
    a restored backup). ``knows`` describes its knowledge, as words after its name. ``ended`` is the end of
    the log at the time of the comparison. If ``known_position`` is 0, it is only known that the log may be
    shorter."""

    known_position: int
    evidence: str
    ended: int
    knows: str = ""


class SayContents(Command, frozen=True):
    """A person on the round reports the contents of a station, bottom to top. Each entry is the id of
    labware, or the type of labware that the log does not know, with the lid that lies on it (``P7+P8``,
    ``plate96+lid96``). For a waste, only the number counts."""

    station: StationName
    by: str
    contents: tuple[str, ...] = ()


class ConfirmStations(Command, frozen=True):
    """A person on the round confirms that stations are as recorded. This is possible only for stations at
    which no unknown action may have been at work."""

    stations: tuple[StationName, ...]
    by: str


def record_shorter_log(
    state: LabState, evidence: str, knows: str, known: int, ended: int, workcell: str = ""
) -> list[Event]:
    """The events for a piece of evidence; none if it is already recorded. The first piece of evidence opens a
    question to a person."""
    known = known if 0 <= known <= HIGHEST else 0
    if state.shorter.evidence.get(evidence) == knows:
        return []
    events: list[Event] = [LogFoundShorter(evidence, knows, known, ended, workcell)]
    if not state.interventions.open_about(ShorterLog):
        events.append(_ask_for_round(state, evidence, knows, ended))
    return events


def _ask_for_round(state: LabState, evidence: str, knows: str, ended: int) -> Event:
    return state.interventions.ask(
        ShorterLog(),
        f"This log has lost its end: it ends at position {ended}, and {local(evidence)} {knows}. "
        "Labware may stand elsewhere than recorded. Nothing starts until a person has checked the "
        "whole bench: labos bench round",
    )


@decides(ReportShorterLog)
def report_shorter_log(state: LabState, command: ReportShorterLog) -> Decision:
    position = command.known_position
    if position and position <= command.ended:
        return []
    knows = command.knows or (
        f"knows of a log up to position {position}"
        if position
        else "says that it may be older than the bench"
    )
    return record_shorter_log(state, command.evidence, knows, position, command.ended)


def record_journal(
    state: LabState, module: ModuleName, found: Sequence[FoundAction], beyond: int
) -> list[Event]:
    """The events for the data in a module's journal that the log does not have. These are actions, whose
    labware is now uncertain, and the position ``beyond`` up to which the node has received acknowledgements
    (0: none)."""
    actions, doubted = state.actions, state.modules.by_name[module]
    known = {*actions.discovered, *actions.settled, *actions.ended.get(module, ())}
    found = [
        msgspec.structs.replace(
            entry,
            effects=_find_credible(state, entry.effects),
            position=entry.position if 0 <= entry.position <= HIGHEST else 0,
        )
        for entry in found
        if entry.action not in known
    ]
    fresh = [entry for entry in found if entry.action not in actions.open]
    again = [entry.name for entry in found if entry.action in actions.open]
    for reports in (state.shorter.evidence, state.shorter.answered):
        if f"position {beyond}" in reports.get(str(module), ""):
            beyond = 0  # it has reported this before
    knows = []
    if fresh:
        more = f" and {len(fresh) - 1} more" if len(fresh) > 1 else ""
        knows.append(f"carried out {fresh[0].name!r} ({fresh[0].status}){more} that it does not contain")
    if again:
        knows.append(f"received a request for {again[0]!r} once more, which it does not contain")
    if beyond:
        knows.append(f"was informed that the log contains everything up to position {beyond}")
    if not knows:
        return []
    highest = max(beyond, *(entry.position for entry in found), 0)
    # A journal with very many unknown actions may have more than it reports.
    cell = workcell_of(module) if beyond or len(found) >= MANY_FOUND else ""
    events = record_shorter_log(state, str(module), " and ".join(knows), highest, state.position, cell)
    if not (fresh or events):
        return []
    # The states of its lid and door depend on these actions too.
    events += [
        VariableSet(module, variable, None, "labos")
        for variable, value in doubted.values.items()
        if value is not None
    ]
    events += [
        ActionDiscovered(entry.action, module, entry.name, entry.status, entry.position, entry.effects)
        for entry in fresh
    ]
    return events + _doubt_labware(state, module, fresh)


def _find_credible(state: LabState, effects: tuple[AnyEffect, ...] | None) -> tuple[AnyEffect, ...] | None:
    """The planned effects of an action in a journal; None if they name something that this log does not know.
    Then the whole workcell is in doubt."""
    if effects is None or len(effects) > MOST_EFFECTS:
        return None
    on_labware = tuple(effect for effect in effects if isinstance(effect, Carrying | Needs))
    return on_labware if list_places(on_labware) <= state.bench.stations.keys() else None


def _doubt_labware(state: LabState, module: ModuleName, found: Sequence[FoundAction]) -> list[Event]:
    """The possible places of labware that these actions may have moved: its old place, a place on the way, or
    off the bench."""
    maybe: dict[LabwareId, list[StationName]] = {}
    for entry in found:
        for effect in entry.effects or ():
            item = state.bench.labware.get(getattr(effect, "labware", LabwareId("")))
            if item is None:
                continue
            before = item.maybe or ((item.station,) if item.station else ())
            here = maybe.setdefault(item.id, list(before))
            if isinstance(effect, Carrying) and not effect.stock:
                here += [effect.source, effect.via, name_hand(module), effect.target]
            elif isinstance(effect, Needs):
                here.append(effect.station)
    events: list[Event] = []
    for name, known in maybe.items():
        possible = (*dict.fromkeys(place for place in known if place), GONE)
        on = state.bench.labware[name].on
        why = f"{local(module)} has worked on it, and the log does not show the outcome"
        events.append(LabwareUncertain(name, "", possible, why, on=on))
    return events


def list_to_say(state: LabState) -> list[StationName]:
    """The stations that a person still has to report on the round; a hotel by its shelves."""
    shorter, bench = state.shorter, state.bench
    if not shorter.since:
        return []
    return [name for name in bench.stations if name not in shorter.said and name not in bench.shelves]


def must_describe(state: LabState, name: StationName) -> bool:
    """Whether a person must list the contents of a station, because a confirmation that it is as recorded is
    not enough."""
    station = state.bench.stations[name]
    doubtful = any(
        state.bench.labware[item].lid and state.bench.is_lid_in_doubt(state.bench.labware[item])
        for item in station.labware
    )
    return state.shorter.is_touched(name) or name in state.bench.uncertain_at or doubtful


@decides_about(SayContents, expect_station)
def say_contents(state: LabState, command: SayContents, station: StationState) -> Decision:
    wrong = (
        _refuse_without_round(state)
        or refuse_hotel(state, command.station)
        or _refuse_at_work(state, command)
    )
    if wrong:
        return wrong
    events = list_contents_events(state, station, command.contents, command.by)
    if isinstance(events, Rejection):
        return events
    return [*_withdraw_answered(state, command), *events, StationsChecked((command.station,), command.by)]


def _withdraw_answered(state: LabState, command: SayContents) -> list[Event]:
    """Withdraw the questions about these stations, which are older than this report."""
    words = {word for item in command.contents for word in split_item(item)}
    here = words | {*state.bench.stations[command.station].labware}
    found: list[Event] = []
    for question in state.interventions.open_about(*get_args(WhereItStands)):
        motions = [e for e in question.motions if isinstance(e, Carrying | Needs)]
        asked = {
            *list_places(motions),
            name_hand(question.module),
            *state.bench.searched.get(question.id, ()),
        }
        about = {e.labware for e in motions if e.labware} | {*question.labware}
        if command.station in asked or about & here:
            found.append(question.withdraw(f"{command.by} has reported what stands where"))
    return found


@decides(ConfirmStations)
def confirm_stations(state: LabState, command: ConfirmStations) -> Decision:
    wrong = _refuse_without_round(state)
    for name in command.stations:
        if name not in state.bench.stations:
            wrong = wrong or Rejection("no_station", f"There is no station {local(name)}.")
        elif must_describe(state, name):
            wrong = wrong or Rejection(
                "touched",
                f"At {local(name)} actions may have run that this log does not contain, so a "
                "confirmation is not enough.",
                f"Report what stands there: labos bench round --say {local(name)}=WHAT",
            )
        wrong = (
            wrong
            or refuse_hotel(state, name)
            or _refuse_at_work(state, SayContents(name, command.by, tuple(list_recorded(state, name))))
        )
    if wrong:
        return wrong
    names = [name for name in dict.fromkeys(command.stations) if name not in state.shorter.said]
    steps = range(0, len(names), STATIONS_PER_EVENT)
    return [StationsChecked(tuple(names[first : first + STATIONS_PER_EVENT]), command.by) for first in steps]


def _refuse_without_round(state: LabState) -> Rejection | None:
    if state.shorter.since:
        return None
    return Rejection(
        "no_round",
        "There is no sign that this log has lost its end, so no check of the whole bench is needed.",
        "You can report one station at any time: labos observe STATION WHAT",
    )


def _refuse_in_motion(module: str) -> Rejection:
    return Rejection(
        "in_motion",
        f"{module} is carrying out an action that this log does not contain.",
        f"Wait until it is idle, or stop it: labos estop {module}",
    )


def _refuse_at_work(state: LabState, command: SayContents) -> Rejection | None:
    """Why a report about a station would soon be outdated: a motion is under way there, or there is an
    open question about a motion that the log knows. That question has to be answered first; later reports
    count."""
    name, bench = command.station, state.bench
    busy = find_strange_motion(state, workcell_of(name))
    if busy:
        return _refuse_in_motion(busy)
    words = {LabwareId(word) for item in command.contents for word in split_item(item)}
    meant = words | {*bench.stations[name].labware}
    for action in state.actions.open.values():
        motions = list_carried(action.effects)
        reached = list_places(motions) | ({name_hand(action.module)} if motions else set())
        held = [item for item in meant if item in bench.labware and bench.labware[item].moving == action.id]
        if name not in reached and not held:
            continue
        if action.status == ActionStatus.UNKNOWN:
            return _refuse_asked_first(state, action)
        if motions or any(item not in words or bench.labware[item].station != name for item in held):
            return Rejection(
                "in_motion",
                f"{local(action.module)} is at work there ({action.name}).",
                "Report it when the action has ended.",
            )
    return None


def _refuse_asked_first(state: LabState, action: Action) -> Rejection:
    question = state.interventions.find_about(action.id)
    which = question.id if question is not None else "the question about it"
    return Rejection(
        "asked_first",
        f"There is an open question how {action.name!r} on {local(action.module)} ended, which was in "
        "progress there.",
        f"Answer that first (labos resolve {which}); then report the station.",
    )


def find_strange_motion(state: LabState, cell: str) -> str:
    """A module of a workcell (of any, if empty) that is at work on an action that the log does not have."""
    for name, module in state.modules.by_name.items():
        if cell in ("", workcell_of(name)) and module.status == ModuleStatus.BUSY and not module.in_flight:
            return local(name)
    return ""


def finish_round(state: LabState, by: str, note: str) -> Decision:
    """The events that follow when a person declares the round complete. It is refused if stations have not
    been reported; the message names them."""
    left = list_to_say(state)
    if left:
        return Rejection(
            "unsaid",
            f"Nobody has reported what stands at {name_some([local(name) for name in left])}.",
            "Check the whole bench and report it: labos bench round",
        )
    busy = find_strange_motion(state, "")
    if busy:
        return _refuse_in_motion(busy)
    lost = [item for item in state.bench.labware.values() if item.maybe]
    held = next((item for item in lost if item.moving), None)
    if held is not None:
        action = state.actions.open[ActionId(held.moving)]
        if action.status == ActionStatus.UNKNOWN:
            return _refuse_asked_first(state, action)
        return Rejection(
            "in_motion",
            f"{local(action.module)} is at work on {held.id} ({action.name}), and nobody has reported "
            "where that is.",
            "Wait until it has ended, or report where it is.",
        )
    return _end_round(state, by, note)


def _end_round(state: LabState, by: str, note: str) -> Iterator[Event]:
    for run in list(state.runs.active.values()):
        what = "was ended: the log lost its end, so it is not known what the last steps did"
        if not has_open_action(run):
            yield from record_end(state, run, RunCancelled(run.id), what)
        elif run.status != RunStatus.CANCELLING or not run.stay:
            yield RunCancelling(run.id, stay=True)
    for run in list(state.runs.queued.values()):
        if not run.paused:
            yield RunPaused(run.id)
    for question in state.interventions.open_about(*get_args(WhereItStands)):
        yield question.withdraw(f"{by} has reported what stands where")
    for item in [item for item in state.bench.labware.values() if item.maybe]:
        yield from remove_labware(
            state.bench, item.id, "", GONE, f"not found when the bench was checked ({by})"
        )
    yield BenchCompared(by, note)

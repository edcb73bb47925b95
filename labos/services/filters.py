"""Selects the events that concern a run, a module, a piece of labware, a user or an experiment."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator

import msgspec

from labos.core.actions import ActionEvent, ActionRequested
from labos.core.envelope import Envelope, Record
from labos.core.ids import StationName, local, module_of, split_key
from labos.core.interventions import InterventionRequested, InterventionResolved
from labos.core.lab import StationsApplied, WorkcellApplied
from labos.core.labware import LabwareEvent, LabwareUncertain
from labos.core.registry import TYPES, Event
from labos.errors import BadInput, NotFound
from labos.ports import LogQuery
from labos.services.catalogue import Catalogue, read_catalogue
from labos.services.log import Log, decode_event
from labos.spec.findings import suggest_name


class LogFilter(msgspec.Struct, frozen=True):
    """The events to show; empty fields select everything. ``types`` are types or families, ``module`` is a
    name with or without its workcell. Times are UTC nanoseconds: ``since`` is the first that is shown,
    ``until`` the first that is not."""

    types: tuple[str, ...] = ()
    run: str = ""
    module: str = ""
    labware: str = ""
    user: str = ""
    experiment: str = ""
    since_ns: int | None = None
    until_ns: int | None = None
    last: int | None = None

    @property
    def simple(self) -> bool:
        """Whether the store can answer this filter by itself."""
        return not (self.run or self.module or self.labware or self.user or self.experiment)


def check_types(types: Iterable[str]) -> None:
    """Raises BadInput for a name that is neither a type nor a family of events."""
    families = {name.partition(".")[0] for name in TYPES}
    for kind in types:
        if kind.rstrip(".*") not in TYPES and kind.rstrip(".*") not in families:
            raise BadInput(
                f"There are no events of type {kind!r}.", remedy=suggest_name(kind, [*TYPES, *families])
            )


class FilteredLog:
    """A filter applied to one log; it remembers what it needs of earlier events."""

    def __init__(self, log: Log, wanted: LogFilter) -> None:
        self.log, self.wanted = log, wanted
        self.names: Catalogue = read_catalogue(log)
        self._actions: set[str] = set()
        self._check()
        if wanted.labware:
            self._note_actions()
        self._tokens = _make_tokens(wanted)

    def read_matching(self, upto: int | None = None) -> Iterator[tuple[Event, Record]]:
        """The events of the log up to a position, in order. Raises LogTooNew, LogDamaged."""
        wanted = self.wanted
        query = LogQuery(
            upto=upto,
            types=wanted.types,
            since_ns=wanted.since_ns,
            until_ns=wanted.until_ns,
            last=wanted.last if wanted.simple else None,
        )
        records = self.log.select(query)
        pairs = (pair for record in records for pair in self.match(record))
        return iter(deque(pairs, wanted.last)) if wanted.last is not None else pairs

    def read_later(self, after: int, upto: int | None = None) -> Iterator[tuple[Event, Record]]:
        """The events after a position, filtered as by ``read_matching``."""
        for record in self.log.read(after, upto):
            self.names.learn(decode_event(record))
            yield from self.match(record)

    def match(self, record: Record) -> Iterator[tuple[Event, Record]]:
        """The record's event if the filter selects it."""
        if self._may_concern(record):
            event = decode_event(record)
            if self._is_about(event, record.head):
                yield event, record

    # -- internal ------------------------------------------------------------------------------

    def _check(self) -> None:
        wanted, names = self.wanted, self.names
        check_types(wanted.types)
        for kind, name, known, remedy in (
            ("run", wanted.run, names.runs, "List them: labos runs --all"),
            ("experiment", wanted.experiment, names.experiments, "List them: labos experiments --all"),
        ):
            if name and name not in known:
                raise NotFound(f"There is no {kind} {name!r} in this log.", remedy=remedy)
        if wanted.module:
            self._check_module(wanted.module)
        if wanted.labware and not self._knows_labware(wanted.labware):
            remedy = "List it: labos labware"
            raise NotFound(f"There is no labware {wanted.labware!r} in this log.", remedy=remedy)

    def _check_module(self, name: str) -> None:
        """Raises NotFound; accepts a station together with its module."""
        modules, stations = set[str](), set[str]()
        for record in self.log.select(LogQuery(types=(WorkcellApplied.TYPE, StationsApplied.TYPE))):
            event = decode_event(record)
            if isinstance(event, WorkcellApplied):
                modules.update(spec.name for spec in event.modules)
            elif isinstance(event, StationsApplied):
                stations.update(spec.name for spec in event.stations)
        modules.update(module_of(StationName(station)) for station in stations)
        if any(name in (known, local(known)) for known in modules):
            return
        module = module_of(StationName(name))
        if any(name in (known, local(known)) for known in stations):
            raise NotFound(
                f"{name!r} is a station.", remedy=f"Its module has its events: labos log --module {module}"
            )
        raise NotFound(
            f"There is no module {name!r} in this log.",
            remedy=suggest_name(local(name), map(local, modules), "module"),
        )

    def _knows_labware(self, name: str) -> bool:
        records = self.log.select(LogQuery(mentions=name))
        return any(name in _list_labware(decode_event(record)) for record in records)

    def knows_user(self) -> bool:
        """Whether the requested user has ever acted in this log."""
        anything = FilteredLog(self.log, LogFilter(user=self.wanted.user))
        return next(anything.read_matching(), None) is not None

    def _note_actions(self) -> None:
        """Note the actions that touched the labware: the events of their outcomes do not name it again."""
        query = LogQuery(types=(ActionRequested.TYPE,), mentions=self.wanted.labware)
        for record in self.log.select(query):
            self._note_action(decode_event(record))

    def _note_action(self, event: Event) -> None:
        if isinstance(event, ActionRequested) and self.wanted.labware in _list_labware(event):
            self._actions.add(event.action)

    def _may_concern(self, record: Record) -> bool:
        """A fast check of the stored bytes: false only if the record certainly does not match."""
        head, wanted = record.head, self.wanted
        if wanted.types and not any(is_of_type(head.type, kind) for kind in wanted.types):
            return False
        if wanted.since_ns is not None and head.recorded_at < wanted.since_ns:
            return False
        if wanted.until_ns is not None and head.recorded_at >= wanted.until_ns:
            return False
        if not self._tokens or wanted.user or head.type == InterventionResolved.TYPE:
            return True
        if wanted.labware and head.type.startswith("action."):
            return True
        if wanted.module and local(wanted.module) == local(head.actor):
            return True
        if {wanted.run, wanted.experiment} & {head.stream, head.correlation} - {""}:
            return True
        return any(token in record.payload for token in self._tokens)

    def _is_about(self, event: Event, head: Envelope) -> bool:
        wanted = self.wanted
        self._note_action(event)
        about: Event = event
        if isinstance(event, InterventionResolved):
            about = self.names.interventions.get(event.intervention, event)
        if wanted.run and wanted.run not in _list_runs(about):
            return False
        if wanted.module and not _names_module(about, head.actor, wanted.module):
            return False
        if wanted.labware and wanted.labware not in _list_labware(about):
            action = getattr(about, "action", "") or getattr(about, "subject", "")
            if action not in self._actions or not isinstance(about, ActionEvent | InterventionRequested):
                return False
        if wanted.experiment and wanted.experiment not in self._list_experiments(about, head):
            return False
        return not wanted.user or wanted.user in self._list_users(event, about, head)

    def _list_experiments(self, event: Event, head: Envelope) -> set[str]:
        named = {getattr(event, field, "") for field in ("experiment", "by", "subject")}
        named |= {self.names.find_experiment(run) for run in _list_runs(event)}
        return named | {head.correlation, _find_owner(event, "experiment")}

    def _list_users(self, event: Event, about: Event, head: Envelope) -> set[str]:
        named = {getattr(event, "by", ""), getattr(event, "user", "")}
        runs, experiments = self.names.runs, self.names.experiments
        named |= {runs[run].user for run in _list_runs(about) if run in runs}
        named |= {experiments[e].user for e in self._list_experiments(about, head) if e in experiments}
        return named | {head.actor, _find_owner(event, "user")}


def is_of_type(type_: str, wanted: str) -> bool:
    """Whether an event type is ``wanted``, or belongs to the family ``wanted``."""
    family = wanted.rstrip(".*")
    return type_ == family or type_.startswith(f"{family}.")


def _make_tokens(wanted: LogFilter) -> tuple[bytes, ...]:
    """Byte strings of which at least one is in each payload that concerns the filter's most selective
    name."""
    for name, owner in ((wanted.run, "run"), (wanted.labware, ""), (wanted.experiment, "experiment")):
        if name:
            return (msgspec.json.encode(name), msgspec.json.encode(f"{owner}:{name}"))
    return (msgspec.json.encode(local(wanted.module))[1:-1],) if wanted.module else ()


def _find_owner(event: Event, kind: str) -> str:
    """The run, experiment or user that an event names as an owner; empty if it names none."""
    found, name = split_key(str(getattr(event, "owner", "")))
    return name if found == kind else ""


def _list_runs(event: Event) -> set[str]:
    """The runs that an event names."""
    named = {str(getattr(event, field, "")) for field in ("run", "by", "subject")}
    return (named | {_find_owner(event, "run")}) - {""}


def _list_labware(event: Event) -> set[str]:
    """The labware that an event names. Arguments of actions do not count: P7 may be a well there."""
    labware = getattr(event, "labware", ())
    named = {labware} if isinstance(labware, str) else set(labware)
    for effect in (*getattr(event, "effects", ()), *getattr(event, "motions", ())):
        if not isinstance(effect, str):
            named.add(getattr(effect, "labware", ""))
    return named


def _names_module(event: Event, actor: str, wanted: str) -> bool:
    """Whether an event is about a module, changes the content of one of its stations, or states what the
    module did to labware."""
    names = [str(getattr(event, "module", ""))]
    if isinstance(event, WorkcellApplied):
        names += [spec.name for spec in event.modules]
    if not isinstance(event, ActionEvent):
        places = [str(getattr(event, f, "")) for f in ("station", "source", "target", "where", "stack")]
        if isinstance(event, LabwareUncertain):
            places += event.places
        if isinstance(event, LabwareEvent) or hasattr(event, "contents"):
            names += [place[:dot] for place in places for dot, letter in enumerate(place) if letter == "."]
        if isinstance(event, LabwareEvent):
            names.append(actor)
    return any(name and wanted in (name, local(name)) for name in names)

"""The lab itself: its identity, its kernel's epoch, its workcells."""

from __future__ import annotations

import msgspec

from labos.core.experiments import ExperimentEnded
from labos.core.ids import LabId, StationName
from labos.core.model import LabwareSpec, ModuleSpec, StationSpec, TransferWay
from labos.core.registry import Event, event
from labos.core.structs import make_from
from labos.core.words import Words


@event("lab.created")
class LabCreated(Event, frozen=True):
    """The lab was created. ``pace`` is the speed-up factor of its simulated instruments (1 in a real lab)."""

    lab: LabId
    name: str
    pace: float = 1.0


@event("kernel.started")
class KernelStarted(Event, frozen=True):
    """A kernel took the lease. Everything with an older epoch is fenced off."""

    epoch: int
    version: str


class WorkcellEvent(Event, frozen=True):
    STREAM = "name"
    name: str


@event("workcell.applied")
class WorkcellApplied(WorkcellEvent, frozen=True):
    """A workcell file (``digest``) was applied: its modules, the lab's own types of ``labware``, and the
    ``transfers`` for moves that name no module."""

    digest: str
    modules: tuple[ModuleSpec, ...]
    labware: tuple[LabwareSpec, ...] = ()
    transfers: tuple[TransferWay, ...] = ()


@event("workcell.stations_applied")
class StationsApplied(WorkcellEvent, frozen=True):
    """Stations of a workcell were applied. A large workcell needs several of these events. Stations that were
    ``removed`` were empty."""

    stations: tuple[StationSpec, ...]
    removed: tuple[StationName, ...] = ()


@event("workcell.access_requested")
class AccessRequested(WorkcellEvent, frozen=True):
    """A person asks for access to a workcell. Nothing starts there any more, except the runs of the plans
    ``parking``, which move arms out of the way."""

    by: str
    why: Words = ""
    parking: tuple[str, ...] = ()


@event("workcell.access_granted")
class AccessGranted(WorkcellEvent, frozen=True):
    """The person may reach in: nothing moves in the workcell until the access has ended. The exception is a
    module whose action has an unknown outcome: it may still move."""


@event("workcell.access_ended")
class AccessEnded(WorkcellEvent, frozen=True):
    """The access has ended. The changes that the person made follow as further events."""

    by: str
    note: Words = ""


WHOLE_LAB = "*"

LEAP = 16
"""After a restore, the epoch is at least this much above the last one of the log. Kernels that follow one
another increase it by one."""


class StartsEvent(Event, frozen=True):
    STREAM = "target"
    target: str


@event("starts.paused")
class StartsPaused(StartsEvent, frozen=True):
    """Nothing starts any more: of an experiment, on a module, in a workcell, or in the whole lab (``*``)."""

    by: str
    why: Words = ""


@event("starts.resumed")
class StartsResumed(StartsEvent, frozen=True):
    """Starts are allowed there again."""

    by: str


class Pause(StartsPaused, frozen=True):
    """A user who stopped all starts of a target, and when (UTC ns)."""

    since: int = 0


class Access(AccessRequested, frozen=True):
    """A person who has access to a workcell, or waits for it since ``asked_at`` (UTC ns)."""

    asked_at: int = 0
    granted: bool = False


class Lab(msgspec.Struct):
    """``workcells`` maps names to digests of the applied files. ``access`` has the workcells with a person's
    access. ``paused`` has the experiments, modules and workcells whose starts are paused. ``labware`` are the
    labware types that a workcell's files define, by workcell and type. ``transfers`` are the ways for
    transfers without a module, by workcell."""

    id: LabId = LabId("")
    name: str = ""
    pace: float = 1.0
    epoch: int = 0
    workcells: dict[str, str] = {}
    access: dict[str, Access] = {}
    paused: dict[str, Pause] = {}
    labware: dict[str, dict[str, LabwareSpec]] = {}
    transfers: dict[str, tuple[TransferWay, ...]] = {}


def fold_lab_created(lab: Lab, event: LabCreated, at: int) -> None:
    lab.id, lab.name, lab.pace = event.lab, event.name, event.pace


def fold_kernel_started(lab: Lab, event: KernelStarted, at: int) -> None:
    lab.epoch = event.epoch


def fold_workcell_applied(lab: Lab, event: WorkcellApplied, at: int) -> None:
    lab.workcells[event.name] = event.digest
    lab.labware[event.name] = {spec.name: spec for spec in event.labware}
    lab.transfers[event.name] = event.transfers


def fold_access_requested(lab: Lab, event: AccessRequested, at: int) -> None:
    lab.access[event.name] = make_from(Access, event, asked_at=at)


def fold_access_granted(lab: Lab, event: AccessGranted, at: int) -> None:
    lab.access[event.name] = msgspec.structs.replace(lab.access[event.name], granted=True)


def fold_access_ended(lab: Lab, event: AccessEnded, at: int) -> None:
    del lab.access[event.name]


def fold_starts_paused(lab: Lab, event: StartsPaused, at: int) -> None:
    lab.paused[event.target] = make_from(Pause, event, since=at)


def fold_starts_resumed(lab: Lab, event: StartsResumed, at: int) -> None:
    del lab.paused[event.target]


def fold_experiment_ended(lab: Lab, event: ExperimentEnded, at: int) -> None:
    lab.paused.pop(event.experiment, None)

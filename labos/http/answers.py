"""Answers of the operations, where no other type of LabOS has their form."""

from __future__ import annotations

import msgspec

from labos.core.campaigns import Terms
from labos.http.asking import NodeAnswer
from labos.http.campaigns import CampaignView, Estimate
from labos.http.teaching import LocationPose
from labos.ports import EventLine
from labos.services.runs import StepHistory
from labos.services.shares import ShareAccount
from labos.services.signatures import Signature
from labos.spec.findings import Finding


class LogCheckView(msgspec.Struct, frozen=True):
    """The check of the whole log in the background: how many records are ``checked`` of how many, whether it
    is ``done``, and the ``damage`` that it found."""

    checked: int
    of: int
    done: bool
    damage: str


class Health(msgspec.Struct, frozen=True):
    """``status`` is ``ok`` or ``failed``. ``position`` is the position of the last event on disk.
    ``suspended`` is the reason why nothing starts (a fault in planning; empty: planning works).
    ``broken_drivers`` lists drivers that cannot be used, each with the reason."""

    status: str
    lab: str
    name: str
    epoch: int
    position: int
    suspended: str
    simulated: bool
    pace: float
    broken_drivers: dict[str, str]
    log_check: LogCheckView | None


class NodeAnswers(msgspec.Struct, frozen=True):
    modules: list[NodeAnswer]


class EventPage(msgspec.Struct, frozen=True):
    """Committed events in order. For the next page, ask with ``after`` = ``position``."""

    events: list[EventLine]
    position: int


class RunDetail(msgspec.Struct, frozen=True):
    """A run from the log, with its steps. Times are in UTC nanoseconds, 0 if not yet known. ``status``:
    queued, active, paused, cancelling, leaving, completed, failed or cancelled. ``busy`` are the periods
    (from, to) in which one of its actions was in flight. ``due_at`` is the time by which it should end."""

    id: str
    workflow: str
    workcell: str
    user: str
    experiment: str
    submitted_at: int
    steps: list[StepHistory]
    status: str
    started_at: int
    ended_at: int
    why: str
    paused: bool
    closing: bool
    campaign: str
    busy: list[tuple[int, int]]
    due_at: int


class Runs(msgspec.Struct, frozen=True):
    """A page of runs. ``position`` is the position of the last submission on it; ``more``: there are later
    ones. ``ended_position`` is the position of the earliest end on it (0: none)."""

    runs: list[RunDetail]
    position: int
    more: bool
    ended_position: int


class RunSubmission(msgspec.Struct, frozen=True):
    """The id of the run, and the warnings about the workflow's files. ``approval`` is the reason if it waits
    for an approval."""

    run: str
    warnings: tuple[Finding, ...] = ()
    approval: str = ""


class RunsSubmission(msgspec.Struct, frozen=True):
    """The ids of the runs, in the order of their payloads, and the warnings about the workflow's files.
    ``approvals`` has the reason, one sentence for each run that waits for an approval."""

    runs: list[str]
    warnings: tuple[Finding, ...] = ()
    approvals: tuple[str, ...] = ()


class RunReference(msgspec.Struct, frozen=True):
    run: str


class Signatures(msgspec.Struct, frozen=True):
    signatures: list[Signature]


class FileReference(msgspec.Struct, frozen=True):
    sha256: str


class ExperimentReference(msgspec.Struct, frozen=True):
    """``approval`` is the reason if it waits for an approval."""

    experiment: str
    approval: str = ""


class CampaignSubmission(msgspec.Struct, frozen=True):
    """The id of the campaign (empty if it was only checked), and the work and material that all its rows
    need: the number of ``rows`` and of those that were ``checked``, ``module_time_s`` in total and by
    ``modules``, the least time that the ``busiest`` module needs (``bounds_s``), and the amount of each of
    the ``consumables`` that is ``needed`` and ``left``. ``approval`` is the reason if it waits for an
    approval."""

    campaign: str
    estimate: Estimate
    approval: str = ""


class CampaignReference(msgspec.Struct, frozen=True):
    campaign: str


class CampaignTerms(msgspec.Struct, frozen=True):
    """The terms that are now valid. ``approval`` is the reason if a change waits for an approval."""

    campaign: str
    terms: Terms
    approval: str = ""


class Campaigns(msgspec.Struct, frozen=True):
    campaigns: list[CampaignView]


class Shares(msgspec.Struct, frozen=True):
    """An account for each user who is in the shares file or has used the lab: the ``wanted`` share, the share
    that the user ``had``, ``lab_hours`` and ``consumables`` of the last seven days, and the ``quota``.
    """

    accounts: list[ShareAccount]


class SharesReference(msgspec.Struct, frozen=True):
    """The SHA-256 of the file."""

    digest: str


class HeartbeatReply(msgspec.Struct, frozen=True):
    """The lab has recorded the heartbeat."""


class Resolution(msgspec.Struct, frozen=True):
    intervention: str
    choice: str


class ModuleReference(msgspec.Struct, frozen=True):
    module: str


class TraceFile(msgspec.Struct, frozen=True):
    """The transcript: a file on the node's computer. The node chooses its name."""

    module: str
    file: str


class ReplenishResult(msgspec.Struct, frozen=True):
    """The amount that was put in."""

    module: str
    resource: str
    amount: float


class Locations(msgspec.Struct, frozen=True):
    locations: dict[str, LocationPose]


class PoseVersion(msgspec.Struct, frozen=True):
    version: int


class CalibrationRecord(msgspec.Struct, frozen=True):
    """The recorded calibration. ``file`` is the SHA-256 of its report; empty if none was sent."""

    module: str
    what: str
    certificate: str
    file: str
    until: str


class LabwareReference(msgspec.Struct, frozen=True):
    """The id of the labware. It is empty on a stack, where a piece gets its id when it is taken."""

    labware: str


class LoadResult(msgspec.Struct, frozen=True):
    """The ids of the labware; none on a stack."""

    labware: list[str]


class UnloadResult(msgspec.Struct, frozen=True):
    """The ids of the pieces that had one, and the number of pieces without."""

    labware: list[str]
    nameless: int


class DeclareResult(msgspec.Struct, frozen=True):
    """The types of labware by station."""

    declared: dict[str, list[str]]


class LabwareOwner(msgspec.Struct, frozen=True):
    labware: str
    owner: str


class SampleCounts(msgspec.Struct, frozen=True):
    """The number of samples in each plate."""

    plates: dict[str, int]


class AccessResult(msgspec.Struct, frozen=True):
    """``parking`` are the runs that first move arms to their rest positions."""

    workcell: str
    parking: list[str]


class WorkcellReference(msgspec.Struct, frozen=True):
    workcell: str

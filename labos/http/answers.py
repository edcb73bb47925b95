"""What the operations answer, where nothing else in LabOS has the shape of it."""

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
    """``status`` is ``ok`` or ``failed``; ``position`` that of the last event on
    disk; ``suspended`` why nothing is started (a fault in planning; empty while it works);
    ``broken_drivers`` why a driver cannot be used, by name."""

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
    """Committed events in order; ask again with ``after`` = ``position``."""

    events: list[EventLine]
    position: int


class RunDetail(msgspec.Struct, frozen=True):
    """A run as the log tells it, with its steps; times in UTC nanoseconds, 0 if not yet. ``status``: queued,
    active, paused, cancelling, leaving, completed, failed or cancelled. ``busy`` are the times (from, to) in
    which some action of it was in flight. It should be over when it is ``due_at``."""

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
    """A page of runs. ``position`` is that of the last submission shown; ``more``: others are alive behind
    it; ``ended_position`` is the first end shown (0: none)."""

    runs: list[RunDetail]
    position: int
    more: bool
    ended_position: int


class RunSubmission(msgspec.Struct, frozen=True):
    """The id of the run, and what the workflow's files made the lab remark. ``approval`` says why it waits
    for one, if it does."""

    run: str
    warnings: tuple[Finding, ...] = ()
    approval: str = ""


class RunsSubmission(msgspec.Struct, frozen=True):
    """The ids of the runs, in the order of their payloads, and what the workflow's files made the lab remark.
    ``approvals`` say why runs wait for one, one sentence for each that does."""

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
    """``approval`` says why it waits for one, if it does."""

    experiment: str
    approval: str = ""


class CampaignSubmission(msgspec.Struct, frozen=True):
    """The id of the campaign (empty if it was only checked), and what all its rows ask of the lab: how many
    ``rows`` there are and how many of them were ``checked``, ``module_time_s``, by ``modules``, what the
    ``busiest`` of them needs at least (``bounds_s``), and of each of the ``consumables`` what is ``needed``
    and what is ``left``. ``approval`` says why it waits for one, if it does."""

    campaign: str
    estimate: Estimate
    approval: str = ""


class CampaignReference(msgspec.Struct, frozen=True):
    campaign: str


class CampaignTerms(msgspec.Struct, frozen=True):
    """The terms on which it goes on. ``approval`` says why a change waits for one, if it does."""

    campaign: str
    terms: Terms
    approval: str = ""


class Campaigns(msgspec.Struct, frozen=True):
    campaigns: list[CampaignView]


class Shares(msgspec.Struct, frozen=True):
    """An account for each user who stands in the shares file or has used the lab: the part of it that is
    ``wanted`` and was ``had``, ``lab_hours`` and ``consumables`` of the last seven days, and the ``quota``.
    """

    accounts: list[ShareAccount]


class SharesReference(msgspec.Struct, frozen=True):
    """The SHA-256 of the file."""

    digest: str


class HeartbeatReply(msgspec.Struct, frozen=True):
    """The lab has heard of it."""


class Resolution(msgspec.Struct, frozen=True):
    intervention: str
    choice: str


class ModuleReference(msgspec.Struct, frozen=True):
    module: str


class TraceFile(msgspec.Struct, frozen=True):
    """The transcript: a file on the computer of the node, which names it itself."""

    module: str
    file: str


class ReplenishResult(msgspec.Struct, frozen=True):
    """How much was put in."""

    module: str
    resource: str
    amount: float


class Locations(msgspec.Struct, frozen=True):
    locations: dict[str, LocationPose]


class PoseVersion(msgspec.Struct, frozen=True):
    version: int


class CalibrationRecord(msgspec.Struct, frozen=True):
    """A calibration as it was recorded. ``file`` is the SHA-256 of its report; empty if none was sent."""

    module: str
    what: str
    certificate: str
    file: str
    until: str


class LabwareReference(msgspec.Struct, frozen=True):
    """The id of labware; empty on a stack, whose items get theirs when they are taken."""

    labware: str


class LoadResult(msgspec.Struct, frozen=True):
    """The ids that the labware got; none on a stack."""

    labware: list[str]


class UnloadResult(msgspec.Struct, frozen=True):
    """The ids of the pieces that had one, and how many had none."""

    labware: list[str]
    nameless: int


class DeclareResult(msgspec.Struct, frozen=True):
    """The types of labware by station."""

    declared: dict[str, list[str]]


class LabwareOwner(msgspec.Struct, frozen=True):
    labware: str
    owner: str


class SampleCounts(msgspec.Struct, frozen=True):
    """How many samples each plate has."""

    plates: dict[str, int]


class AccessResult(msgspec.Struct, frozen=True):
    """``parking`` are the runs that park arms first."""

    workcell: str
    parking: list[str]


class WorkcellReference(msgspec.Struct, frozen=True):
    workcell: str

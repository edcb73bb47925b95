"""Requests to a person, with concrete choices."""

from __future__ import annotations

import msgspec

from labos.core.effects import AnyEffect
from labos.core.ids import InterventionId, LabwareId
from labos.core.registry import Event, event

UNNUMBERED = InterventionId("")
"""The id of an intervention that ``decide`` has still to number."""


class Choice(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """What a person may answer, and what follows from it."""

    name: str
    consequence: str


@event("intervention.requested")
class InterventionRequested(Event, frozen=True):
    """``kind``: unknown_action, lost_labware, failed_run, discovered_action, contradiction,
    lost_experiment, late_step, failed_step, barcode, planned_work, doubtful_node, outranked_node,
    log_shorter, device_waits, closing_waits. ``subject`` is the id it
    is about, ``labware`` what a choice may remove, ``motions`` the moves and takes of which it is not known
    how far they went, or the reading that contradicts the log. ``due_at`` is until when planned work should
    be done (UTC ns; 0: no time was set)."""

    intervention: InterventionId
    kind: str
    subject: str
    text: str
    choices: tuple[Choice, ...]
    run: str = ""
    module: str = ""
    labware: tuple[LabwareId, ...] = ()
    motions: tuple[AnyEffect, ...] = ()
    due_at: int = 0

    def stream(self) -> str:
        return self.run or f"intervention:{self.intervention}"


@event("intervention.resolved")
class InterventionResolved(Event, frozen=True):
    """A person chose. ``choice`` is ``withdrawn`` when the question answered itself."""

    intervention: InterventionId
    choice: str
    by: str
    note: str = ""

    def stream(self) -> str:
        return f"intervention:{self.intervention}"


@event("intervention.overdue")
class InterventionOverdue(Event, frozen=True):
    """Planned work was not confirmed in time (``due_at``, UTC ns). Nothing fails by that."""

    intervention: InterventionId
    run: str
    due_at: int

    def stream(self) -> str:
        return self.run or f"intervention:{self.intervention}"


PLANNED_WORK = "planned_work"
"""What a workflow asks a person to do; all other kinds ask for help."""

CLOSING_WAITS = "closing_waits"
"""The closing workflow of an experiment does not begin."""


class Intervention(msgspec.Struct):
    id: InterventionId
    kind: str
    subject: str
    text: str
    choices: tuple[Choice, ...]
    run: str
    module: str
    labware: tuple[LabwareId, ...]
    motions: tuple[AnyEffect, ...]
    requested_at: int
    due_at: int = 0
    overdue: bool = False


class Interventions(msgspec.Struct):
    """Those that wait for an answer, oldest first; ``named`` counts the ids given out; ``by_subject`` and
    ``by_run`` are indexes."""

    open: dict[InterventionId, Intervention] = {}
    named: int = 0
    by_subject: dict[str, dict[InterventionId, bool]] = {}
    by_run: dict[str, dict[InterventionId, bool]] = {}

    def about(self, subject: str) -> Intervention | None:
        return next((self.open[name] for name in self.by_subject.get(subject, ())), None)

    def of_run(self, run: str) -> list[Intervention]:
        """The open questions that name a run, oldest first."""
        return [self.open[name] for name in self.by_run.get(run, ())]


def requested(interventions: Interventions, event: InterventionRequested, at: int) -> None:
    interventions.named += 1
    interventions.open[event.intervention] = Intervention(
        id=event.intervention,
        kind=event.kind,
        subject=event.subject,
        text=event.text,
        choices=event.choices,
        run=event.run,
        module=event.module,
        labware=event.labware,
        motions=event.motions,
        requested_at=at,
        due_at=event.due_at,
    )
    interventions.by_subject.setdefault(event.subject, {})[event.intervention] = True
    if event.run:
        interventions.by_run.setdefault(event.run, {})[event.intervention] = True


def resolved(interventions: Interventions, event: InterventionResolved, at: int) -> None:
    question = interventions.open.pop(event.intervention)
    for index, key in ((interventions.by_subject, question.subject), (interventions.by_run, question.run)):
        names = index.get(key, {})
        names.pop(event.intervention, None)
        if not names:
            index.pop(key, None)


def became_overdue(interventions: Interventions, event: InterventionOverdue, at: int) -> None:
    interventions.open[event.intervention].overdue = True


HANDLERS = {
    InterventionRequested: requested,
    InterventionResolved: resolved,
    InterventionOverdue: became_overdue,
}

"""Users, their experiments, and the lab's questions to them, as rows."""

from __future__ import annotations

from labos.audit._rows import Row, RowChanges, convert_to_seconds
from labos.audit._work_tables import EXPERIMENTS, INTERVENTIONS, USERS
from labos.core import experiments as x
from labos.core import interventions as i
from labos.core import runs as r
from labos.core.envelope import Envelope
from labos.core.users import UserErased


def note_actor(rows: RowChanges, head: Envelope, at: float) -> None:
    """Record that a user caused an event; modules and LabOS itself are not users."""
    if head.actor != "labos" and "/" not in head.actor:
        _change_person(rows, head.actor, at)["events"] += 1


def on_submitted(rows: RowChanges, event: r.RunSubmitted, head: Envelope, at: float) -> None:
    _change_person(rows, event.user, at)["runs"] += 1


def _change_person(rows: RowChanges, user: str, at: float) -> Row:
    person = rows.change(USERS, user)
    if not person["user_id"]:
        counts = {"runs": 0, "experiments": 0, "answers": 0, "events": 0}
        person = rows.put(USERS, user_id=user, first_at_s=at, **counts)
    person["last_at_s"] = at
    return person


def on_erased(rows: RowChanges, event: UserErased, head: Envelope, at: float) -> None:
    row = rows.change(USERS, event.user)
    if not row["user_id"]:
        row = _change_person(rows, event.user, at)
    row["erased_at_s"] = at


def on_asked(rows: RowChanges, event: i.InterventionRequested, head: Envelope, at: float) -> None:
    rows.put(
        INTERVENTIONS,
        event,
        labware=list(event.labware),
        choices=[choice.name for choice in event.choices],
        asked_at_s=at,
        due_at_s=convert_to_seconds(event.due_at) if event.due_at else None,
        asked_position=head.position,
    )


def on_resolved(rows: RowChanges, event: i.InterventionResolved, head: Envelope, at: float) -> None:
    answer = {"choice": event.choice, "resolved_by": event.by, "note": event.note}
    rows.update(
        INTERVENTIONS, event.intervention, resolved_at_s=at, resolved_position=head.position, **answer
    )
    if event.by == head.actor and event.by != "labos" and "/" not in event.by:
        _change_person(rows, event.by, at)["answers"] += 1


def on_started(rows: RowChanges, event: x.ExperimentStarted, head: Envelope, at: float) -> None:
    rows.put(
        EXPERIMENTS,
        event,
        user_id=event.user,
        status="open",
        runs=0,
        started_at_s=at,
        started_position=head.position,
    )
    _change_person(rows, event.user, at)["experiments"] += 1


def on_cancelled(
    rows: RowChanges, event: x.ExperimentCancelled | x.ExperimentClosing, head: Envelope, at: float
) -> None:
    row = rows.change(EXPERIMENTS, event.experiment)
    row["status"] = "closing" if isinstance(event, x.ExperimentClosing) else "cancelled"
    row["why"] = row["why"] or event.why


def on_ended(rows: RowChanges, event: x.ExperimentEnded, head: Envelope, at: float) -> None:
    row = rows.update(
        EXPERIMENTS, event.experiment, status="ended", ended_at_s=at, ended_position=head.position
    )
    row["why"] = row["why"] or event.why

"""Requests to a person, with concrete choices."""

from __future__ import annotations

import msgspec

from labos.core.effects import AnyEffect
from labos.core.ids import InterventionId, LabwareId
from labos.core.registry import Event, event
from labos.core.structs import make_from
from labos.core.topics import AnyTopic, Choice, Topic
from labos.core.words import Words


class InterventionEvent(Event, frozen=True):
    intervention: InterventionId

    def stream(self) -> str:
        """The stream of the run that it names, if it names one; otherwise its own."""
        return getattr(self, "run", "") or f"intervention:{self.intervention}"


@event("intervention.requested", schema=2)
class InterventionRequested(InterventionEvent, frozen=True):
    """LabOS asks a person. ``topic`` is the subject with its details (null: of a kind that is no longer
    used). ``kind``, ``subject``, ``labware`` and ``motions`` repeat it in fields that all kinds share.
    ``kind`` is its name, ``subject`` the id of its subject, and ``labware`` the labware that an answer may
    remove. ``motions`` are the moves and takes of unknown outcome, or the reading that contradicts the log.
    ``due_at`` is the time by which planned work should be done (UTC ns; 0: no time)."""

    kind: str
    subject: str
    text: str
    choices: tuple[Choice, ...]
    run: str = ""
    module: str = ""
    labware: tuple[LabwareId, ...] = ()
    motions: tuple[AnyEffect, ...] = ()
    due_at: int = 0
    topic: AnyTopic | None = None


@event("intervention.resolved")
class InterventionResolved(InterventionEvent, frozen=True):
    """A person answered with ``choice``. It is ``withdrawn`` if the question was resolved without an
    answer."""

    choice: str
    by: str
    note: Words = ""


@event("intervention.overdue")
class InterventionOverdue(InterventionEvent, frozen=True):
    """A person did not confirm planned work by the time ``due_at`` (UTC ns). Nothing fails because of
    this."""

    run: str
    due_at: int


class Intervention(InterventionRequested, frozen=True):
    """A question that waits for an answer since ``requested_at`` (UTC ns)."""

    requested_at: int = 0
    overdue: bool = False

    @property
    def id(self) -> InterventionId:
        return self.intervention

    def withdraw(self, why: str) -> InterventionResolved:
        """The question is resolved without an answer."""
        return InterventionResolved(self.id, "withdrawn", "labos", why)


class Interventions(msgspec.Struct):
    """``open`` are the questions that wait for an answer, oldest first. ``named`` counts the ids given out;
    ``by_subject`` and ``by_run`` are indexes."""

    open: dict[InterventionId, Intervention] = {}
    named: int = 0
    by_subject: dict[str, dict[InterventionId, bool]] = {}
    by_run: dict[str, dict[InterventionId, bool]] = {}

    @property
    def next_id(self) -> InterventionId:
        """The id of the next question."""
        return InterventionId(f"I{self.named + 1}")

    def ask(self, topic: AnyTopic, text: str, due_at: int = 0) -> InterventionRequested:
        """The next question. ``text`` is for people."""
        return make_from(
            InterventionRequested,
            topic,
            intervention=self.next_id,
            kind=topic.KIND,
            text=text,
            labware=topic.pieces,
            motions=topic.evidence,
            due_at=due_at,
            topic=topic,
        )

    def open_about(self, *topics: type[Topic]) -> list[Intervention]:
        """The open questions of these types, oldest first."""
        return [question for question in self.open.values() if isinstance(question.topic, topics)]

    def find_about(self, subject: str, *topics: type[Topic]) -> Intervention | None:
        return next(iter(self.list_about(subject, *topics)), None)

    def list_about(self, subject: str, *topics: type[Topic]) -> list[Intervention]:
        """The open questions about a subject, oldest first; only those of these types, if some are given."""
        found = [self.open[name] for name in self.by_subject.get(subject, ())]
        return [q for q in found if isinstance(q.topic, topics)] if topics else found

    def find_by_run(self, run: str, *topics: type[Topic]) -> list[Intervention]:
        """The same for the questions that name a run."""
        found = [self.open[name] for name in self.by_run.get(run, ())]
        return [q for q in found if isinstance(q.topic, topics)] if topics else found


def fold_intervention_requested(interventions: Interventions, event: InterventionRequested, at: int) -> None:
    if event.intervention in interventions.open:
        raise ValueError(f"{event.intervention} is open already")
    interventions.named += 1
    interventions.open[event.intervention] = make_from(Intervention, event, requested_at=at)
    interventions.by_subject.setdefault(event.subject, {})[event.intervention] = True
    if event.run:
        interventions.by_run.setdefault(event.run, {})[event.intervention] = True


def fold_intervention_resolved(interventions: Interventions, event: InterventionResolved, at: int) -> None:
    question = interventions.open.pop(event.intervention)
    for index, key in ((interventions.by_subject, question.subject), (interventions.by_run, question.run)):
        names = index.get(key, {})
        names.pop(event.intervention, None)
        if not names:
            index.pop(key, None)


def fold_intervention_overdue(interventions: Interventions, event: InterventionOverdue, at: int) -> None:
    question = interventions.open[event.intervention]
    interventions.open[event.intervention] = msgspec.structs.replace(question, overdue=True)

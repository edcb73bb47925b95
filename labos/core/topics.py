"""The questions to people: a type for each kind of question, with its fields and its choices.

The consequences of an answer are defined beside the rules (``labos.core.decide.interventions``), in one match
over these types. The text of a question is for people only; no program parses it.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import ClassVar, TypeVar

import msgspec

from labos.core.effects import AnyEffect, Move, Needs, Reads, list_carried
from labos.core.ids import ActionId, ExperimentId, LabwareId, StationName, local

NAMED = 8
"""A text for people names at most this number of things; the others are counted."""

T = TypeVar("T")


class Choice(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A possible answer of a person, and its consequence."""

    name: str
    consequence: str


class Topic(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, tag_field="topic"):
    """The subject of a question with its details. ``run`` and ``module`` are those that it concerns; empty if
    none."""

    KIND: ClassVar[str]
    SUBJECT: ClassVar[str]
    """The name of the field with the subject's id."""
    CHOICES: ClassVar[tuple[Choice, ...]]
    """The possible answers, if they are the same for every question of the type."""
    MOST_PIECES: ClassVar[int] = 1_000
    """The most pieces of labware of one question: an event has at most 64 KB."""
    run: str = ""
    module: str = ""

    @property
    def subject(self) -> str:
        """The id of the subject of the question."""
        subject: str = getattr(self, self.SUBJECT)
        return subject

    @property
    def choices(self) -> tuple[Choice, ...]:
        """The possible answers."""
        return self.CHOICES

    @property
    def pieces(self) -> tuple[LabwareId, ...]:
        """The labware that a choice may remove."""
        return ()

    @property
    def evidence(self) -> tuple[AnyEffect, ...]:
        """Motions with an unknown progress, or the reading that contradicts the log."""
        return ()


def split_into_batches(topic: type[Topic], pieces: Sequence[T]) -> Iterator[Sequence[T]]:
    """The pieces in batches: one question of this type may be about at most one batch."""
    for first in range(0, len(pieces), topic.MOST_PIECES):
        yield pieces[first : first + topic.MOST_PIECES]


def name_some(things: Sequence[str], most: int = NAMED) -> str:
    """The first of several things, and the number of the others, as a part of a sentence."""
    more = f" and {len(things) - most} more" if len(things) > most else ""
    return f"{', '.join(things[:most])}{more}"


class ActionTopic(Topic, frozen=True):
    """A question about an action."""

    SUBJECT: ClassVar[str] = "action"
    action: ActionId


class Contradiction(Topic, frozen=True):
    """A question about a station where something else was observed than the log has."""

    KIND: ClassVar[str] = "contradiction"
    SUBJECT: ClassVar[str] = "station"
    station: StationName


class StepTopic(Topic, frozen=True):
    """A question about a step of a run."""

    step: int

    @property
    def subject(self) -> str:
        return f"{self.run}#{self.step}"


class UnknownAction(ActionTopic, frozen=True, tag="unknown_action"):
    """The outcome of an action is unknown. If the action moves labware, it moves it from ``source`` to
    ``target``."""

    KIND: ClassVar[str] = "unknown_action"
    source: StationName = StationName("")
    target: StationName = StationName("")

    @property
    def choices(self) -> tuple[Choice, ...]:
        if not self.target:
            return (
                Choice("done", "It was done: the run continues."),
                Choice("not_done", "It was not done: the step is done again."),
                Choice("gone", "It was spoilt: the run ends."),
            )
        return (
            Choice("done", f"It stands at {local(self.target)}: the step counts as done."),
            Choice("not_done", f"It stands at {local(self.source)}: the step is done again."),
            Choice("gone", "It was taken off the bench: the run ends."),
        )


class LostLabware(ActionTopic, frozen=True, tag="lost_labware"):
    """A move failed part of the way: a person has to report where the labware is."""

    KIND: ClassVar[str] = "lost_labware"
    motions: tuple[AnyEffect, ...]

    @property
    def choices(self) -> tuple[Choice, ...]:
        choices = [Choice("gone", "It was taken off the bench.")]
        for effect in list_carried(self.motions):
            choices.append(Choice("source", f"It stands at {local(effect.source)}."))
            choices.append(Choice("target", f"It stands at {local(effect.target)}."))
        return tuple(choices)

    @property
    def evidence(self) -> tuple[AnyEffect, ...]:
        return self.motions


class LeftLabware(Topic, frozen=True, tag="left_labware"):
    """A run has ended and left labware where it may block other runs; or its labware, lost by the action
    ``lost_by``, was found after its end."""

    KIND: ClassVar[str] = "failed_run"
    CHOICES: ClassVar[tuple[Choice, ...]] = (
        Choice("removed", "The labware was taken away; its stations are free."),
        Choice("leave", "It stays where it is and belongs to the run's user."),
    )
    labware: tuple[LabwareId, ...]
    lost_by: str = ""

    @property
    def subject(self) -> str:
        return self.lost_by or self.run

    @property
    def pieces(self) -> tuple[LabwareId, ...]:
        return self.labware


class DiscoveredAction(ActionTopic, frozen=True, tag="discovered_action"):
    """A node's journal has an action that the log does not have. No longer used: see ``ShorterLog``."""

    KIND: ClassVar[str] = "discovered_action"
    CHOICES: ClassVar[tuple[Choice, ...]] = (Choice("checked", "The bench was compared with the record."),)


class LateResult(ActionTopic, frozen=True, tag="late_result"):
    """A node reports another outcome of an action than the log has."""

    KIND: ClassVar[str] = "contradiction"
    CHOICES: ClassVar[tuple[Choice, ...]] = (Choice("checked", "The bench was compared with the record."),)


class NotSeen(Contradiction, frozen=True, tag="not_seen"):
    """An observation did not find the recorded labware at a station, but labware of the type ``other_type``
    (empty: nothing)."""

    MOST_PIECES: ClassVar[int] = 200  # each is also stored as a motion, with its station
    labware: tuple[LabwareId, ...]
    other_type: str = ""

    @property
    def choices(self) -> tuple[Choice, ...]:
        away = "The recorded labware is off the bench, and the observed labware was taken away."
        return (
            Choice("there", "The observation was wrong: the record is correct."),
            Choice("gone", away if self.other_type else "It was taken off the bench."),
        )

    @property
    def pieces(self) -> tuple[LabwareId, ...]:
        return self.labware

    @property
    def evidence(self) -> tuple[AnyEffect, ...]:
        return tuple(Needs(self.station, name) for name in self.labware)


class SeenElsewhere(Contradiction, frozen=True, tag="seen_elsewhere"):
    """Labware was recognised at a station where it should not be: by the log it stands at ``recorded``
    (empty: its place is not known), or ``others`` should stand there."""

    labware: LabwareId
    recorded: StationName = StationName("")
    others: tuple[LabwareId, ...] = ()

    @property
    def choices(self) -> tuple[Choice, ...]:
        name, recorded = self.labware, local(self.recorded)
        rest = f"; {', '.join(self.others)} is off the bench" if self.others else ""
        choices = [Choice("seen", f"{name} stands at {local(self.station)}{rest}.")]
        if recorded:
            choices.append(Choice("recorded", f"The observation was wrong: {name} is at {recorded}."))
        choices.append(Choice("gone", f"{name} is off the bench; everything else is as recorded."))
        return tuple(choices)

    @property
    def pieces(self) -> tuple[LabwareId, ...]:
        return (self.labware, *self.others)

    @property
    def evidence(self) -> tuple[AnyEffect, ...]:
        motion = Move(self.recorded or self.station, self.station, labware=self.labware)
        return (motion, *(Needs(self.station, name) for name in self.others))


class Unexpected(Contradiction, frozen=True, tag="unexpected"):
    """Labware stands at a station that is empty by the log. If its type is known, it can get an id."""

    type: str = ""

    @property
    def choices(self) -> tuple[Choice, ...]:
        choices = [Choice("removed", f"It was taken away; {local(self.station)} is as recorded.")]
        if self.type:
            choices.append(Choice("new", f"It is {self.type} for everybody to use, and gets an id."))
        return tuple(choices)

    @property
    def evidence(self) -> tuple[AnyEffect, ...]:
        return (Needs(self.station),)


class LostExperiment(Topic, frozen=True, tag="lost_experiment"):
    """The application of an experiment has stopped sending heartbeats."""

    KIND: ClassVar[str] = "lost_experiment"
    SUBJECT: ClassVar[str] = "experiment"
    CHOICES: ClassVar[tuple[Choice, ...]] = (
        Choice("close", "Its closing workflow clears away its labware."),
        Choice("wait", "Nothing is done: the application will be started again."),
    )
    experiment: ExperimentId


class LateStep(StepTopic, frozen=True, tag="late_step"):
    """A step did not start in time, and its run waits."""

    KIND: ClassVar[str] = "late_step"
    CHOICES: ClassVar[tuple[Choice, ...]] = (
        Choice("go_on", "The step starts late, as soon as it can; the run continues."),
        Choice("fail", "The run ends as failed; its labware stays where it is."),
    )


class FailedStep(StepTopic, frozen=True, tag="failed_step"):
    """A step failed, and its workflow says that a person decides. ``done``: the effect of the step took place
    nevertheless. ``again``: the step had no effect and can be repeated."""

    KIND: ClassVar[str] = "failed_step"
    done: bool = False
    again: bool = False
    may_skip: bool = False

    @property
    def choices(self) -> tuple[Choice, ...]:
        choices = [Choice("retry", "It is done again.")] if self.again else []
        if self.done:
            choices.append(Choice("skip", "It took place in spite of the error: the run continues."))
        elif self.may_skip:
            choices.append(Choice("skip", "The run continues without it."))
        return (*choices, Choice("fail", "The run ends as failed; its labware stays where it is."))


class Barcode(ActionTopic, frozen=True, tag="barcode"):
    """A barcode was read that does not belong to the labware which should stand there. It belongs to
    ``other``, which by the log stands ``elsewhere`` (both empty: no known labware has this barcode and could
    stand there)."""

    KIND: ClassVar[str] = "barcode"
    labware: LabwareId
    station: StationName
    barcode: str
    other: LabwareId = LabwareId("")
    elsewhere: StationName = StationName("")

    @property
    def choices(self) -> tuple[Choice, ...]:
        name, here, there = self.labware, local(self.station), local(self.elsewhere)
        choices = [
            Choice("misread", f"It was read wrongly: it is {name}, and everything is as recorded."),
            Choice("relabelled", f"It is {name}; its barcode is {self.barcode} from now on."),
        ]
        if self.other:
            rest = f" {self.run} is paused." if self.run else ""
            choices += [
                Choice("swapped", f"{self.other} stands at {here}, and {name} at {there}.{rest}"),
                Choice("other", f"{self.other} stands at {here}; {name} is off the bench.{rest}"),
            ]
        choices.append(Choice("gone", f"It is neither: it was taken away, and {name} is off the bench."))
        return tuple(choices)

    @property
    def pieces(self) -> tuple[LabwareId, ...]:
        return (self.labware, self.other) if self.other else (self.labware,)

    @property
    def evidence(self) -> tuple[AnyEffect, ...]:
        return (Reads(self.labware, self.station, self.barcode),)


class PlannedWork(ActionTopic, frozen=True, tag="planned_work"):
    """Work that a workflow assigns to a person. All other kinds ask for help."""

    KIND: ClassVar[str] = "planned_work"
    CHOICES: ClassVar[tuple[Choice, ...]] = (
        Choice("done", "It is done: the run continues."),
        Choice("not_done", "It cannot be done, and nothing was moved: the run ends."),
    )


class DoubtfulNode(Topic, frozen=True, tag="doubtful_node"):
    """The lab refused messages on the bus because they may come from a wrong process."""

    KIND: ClassVar[str] = "doubtful_node"
    SUBJECT: ClassVar[str] = "module"

    @property
    def choices(self) -> tuple[Choice, ...]:
        name = local(self.module)
        return (Choice("checked", f"A person has checked which processes answer as {name}."),)


class OutrankedNode(Topic, frozen=True, tag="outranked_node"):
    """A node has accepted a kernel with a higher epoch than this one."""

    KIND: ClassVar[str] = "outranked_node"
    SUBJECT: ClassVar[str] = "module"

    @property
    def choices(self) -> tuple[Choice, ...]:
        name = local(self.module)
        return (Choice("checked", f"The bench was compared with the record; {name} is used again."),)


class ShorterLog(Topic, frozen=True, tag="log_shorter"):
    """The log has lost its end."""

    KIND: ClassVar[str] = "log_shorter"
    CHOICES: ClassVar[tuple[Choice, ...]] = (
        Choice(
            "checked",
            "All stations were reported. Runs that were under way end; their labware stays at the reported "
            "stations and belongs to their users. Waiting runs are paused.",
        ),
    )

    @property
    def subject(self) -> str:
        return "log"


class DeviceWaits(Topic, frozen=True, tag="device_waits"):
    """A device waits for a person during an action."""

    KIND: ClassVar[str] = "device_waits"
    SUBJECT: ClassVar[str] = "module"
    CHOICES: ClassVar[tuple[Choice, ...]] = (
        Choice("noted", "A person will help; the question is not asked again during this wait."),
    )


class ClosingWaits(Topic, frozen=True, tag="closing_waits"):
    """The closing workflow of an experiment does not start."""

    KIND: ClassVar[str] = "closing_waits"
    SUBJECT: ClassVar[str] = "run"
    user: str

    @property
    def choices(self) -> tuple[Choice, ...]:
        return (
            Choice("wait", "The run continues to wait; the question is not asked again."),
            Choice("end", f"The experiment ends; its labware stays where it is and is {self.user}'s."),
        )


class SecondPerson(Topic, frozen=True, tag="second_person"):
    """A run has a dangerous step. It waits until a person other than its user has checked it."""

    KIND: ClassVar[str] = "second_person"
    SUBJECT: ClassVar[str] = "run"
    CHOICES: ClassVar[tuple[Choice, ...]] = (
        Choice("approve", "It may start. Only a person other than its user can approve it."),
        Choice("refuse", "It is cancelled."),
    )


class Approval(Topic, frozen=True, tag="approval"):
    """A submission, or a change of a campaign, waits for an approval. ``about`` is its id, ``digest`` is the
    digest of its content, and ``what`` is its kind."""

    KIND: ClassVar[str] = "approval"
    SUBJECT: ClassVar[str] = "about"
    about: str
    digest: str
    what: str

    @property
    def choices(self) -> tuple[Choice, ...]:
        refused = "The campaign continues as before." if self.what == "amendment" else "It is cancelled."
        return (
            Choice("approve", "It is approved without changes."),
            Choice("refuse", refused),
        )


class BookedPlace(Topic, frozen=True, tag="booked_place"):
    """At a booked place, there is labware of another user, or an ``action`` of another user is under way."""

    KIND: ClassVar[str] = "booked_place"
    CHOICES: ClassVar[tuple[Choice, ...]] = (
        Choice(
            "noted", "A person will take care of it. The question is asked again when the booking begins."
        ),
    )
    booking: str
    labware: tuple[LabwareId, ...] = ()
    action: ActionId = ActionId("")

    @property
    def subject(self) -> str:
        return f"booking:{self.booking}"


AnyTopic = (
    UnknownAction
    | LostLabware
    | LeftLabware
    | DiscoveredAction
    | LateResult
    | NotSeen
    | SeenElsewhere
    | Unexpected
    | LostExperiment
    | LateStep
    | FailedStep
    | Barcode
    | PlannedWork
    | DoubtfulNode
    | OutrankedNode
    | ShorterLog
    | DeviceWaits
    | ClosingWaits
    | SecondPerson
    | Approval
    | BookedPlace
)

WhereItStands = LostLabware | LateResult | NotSeen | SeenElsewhere | Unexpected
"""Questions that are answered when a person has reported the contents of all their stations."""

LabwareInDoubt = LostLabware | Barcode | NotSeen | SeenElsewhere
"""Questions that are answered when the labware was observed."""

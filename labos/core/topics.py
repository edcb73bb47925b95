"""What a person can be asked about: a type for each kind of question, with its fields and its choices.

What follows from an answer is written beside the rules (``labos.core.decide.interventions``), in one match
over these types. The text of a question is for people, and nothing is ever read out of it.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import ClassVar, TypeVar

import msgspec

from labos.core.effects import AnyEffect, Move, Needs, Reads, list_carried
from labos.core.ids import ActionId, ExperimentId, LabwareId, StationName, local

NAMED = 8
"""So many pieces of labware are named in the text of a question; the others are counted."""

T = TypeVar("T")


class Choice(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A possible answer of a person, and its consequence."""

    name: str
    consequence: str


class Topic(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True, tag_field="topic"):
    """What a question is about. ``run`` and ``module`` are those it concerns, empty if none."""

    KIND: ClassVar[str]
    SUBJECT: ClassVar[str]
    """The field with the id that the question is about."""
    CHOICES: ClassVar[tuple[Choice, ...]]
    """What may be answered, where it is the same for every question of the type."""
    MOST_PIECES: ClassVar[int] = 1_000
    """So many pieces of labware one question is about at the most: an event has 64 KB."""
    run: str = ""
    module: str = ""

    @property
    def subject(self) -> str:
        """The id that the question is about."""
        subject: str = getattr(self, self.SUBJECT)
        return subject

    @property
    def choices(self) -> tuple[Choice, ...]:
        """What may be answered."""
        return self.CHOICES

    @property
    def pieces(self) -> tuple[LabwareId, ...]:
        """The labware that a choice may remove."""
        return ()

    @property
    def evidence(self) -> tuple[AnyEffect, ...]:
        """Motions for which it is not known how far they went, or the reading that contradicts the log."""
        return ()


def in_batches(topic: type[Topic], pieces: Sequence[T]) -> Iterator[Sequence[T]]:
    """The pieces, as many at a time as one question of this type may be about."""
    for first in range(0, len(pieces), topic.MOST_PIECES):
        yield pieces[first : first + topic.MOST_PIECES]


def name_some(pieces: Sequence[str]) -> str:
    """The first of several pieces, as one piece of a sentence, and how many more there are."""
    more = f" and {len(pieces) - NAMED} more" if len(pieces) > NAMED else ""
    return f"{', '.join(pieces[:NAMED])}{more}"


class UnknownAction(Topic, frozen=True, tag="unknown_action"):
    """Nobody knows how an action ended. If it moves labware, it goes from ``source`` to ``target``."""

    KIND: ClassVar[str] = "unknown_action"
    SUBJECT: ClassVar[str] = "action"
    action: ActionId
    source: StationName = StationName("")
    target: StationName = StationName("")

    @property
    def choices(self) -> tuple[Choice, ...]:
        if not self.target:
            return (
                Choice("done", "It was done: the run goes on."),
                Choice("not_done", "It was not done: the step is done again."),
                Choice("gone", "It was spoilt: the run ends."),
            )
        return (
            Choice("done", f"It stands at {local(self.target)}: the step counts as done."),
            Choice("not_done", f"It stands at {local(self.source)}: the step is done again."),
            Choice("gone", "It was taken off the bench: the run ends."),
        )


class LostLabware(Topic, frozen=True, tag="lost_labware"):
    """A motion failed half-way: somebody has to say where the labware is."""

    KIND: ClassVar[str] = "lost_labware"
    SUBJECT: ClassVar[str] = "action"
    action: ActionId
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
    """A run has ended and left labware in others' way; or its labware was found (``lost_by`` the action)
    after it had ended."""

    KIND: ClassVar[str] = "failed_run"
    CHOICES: ClassVar[tuple[Choice, ...]] = (
        Choice("removed", "The labware was carried away; its stations are free."),
        Choice("leave", "It stays where it is, as its user's labware."),
    )
    labware: tuple[LabwareId, ...]
    lost_by: str = ""

    @property
    def subject(self) -> str:
        return self.lost_by or self.run

    @property
    def pieces(self) -> tuple[LabwareId, ...]:
        return self.labware


class DiscoveredAction(Topic, frozen=True, tag="discovered_action"):
    """A node's journal knows an action that the log does not. Not asked any more: see ``LogShorter``."""

    KIND: ClassVar[str] = "discovered_action"
    SUBJECT: ClassVar[str] = "action"
    CHOICES: ClassVar[tuple[Choice, ...]] = (Choice("checked", "The bench was compared with the record."),)
    action: ActionId


class LateResult(Topic, frozen=True, tag="late_result"):
    """A node says something else of an action than what it was settled as."""

    KIND: ClassVar[str] = "contradiction"
    SUBJECT: ClassVar[str] = "action"
    CHOICES: ClassVar[tuple[Choice, ...]] = (Choice("checked", "The bench was compared with the record."),)
    action: ActionId


class NotSeen(Topic, frozen=True, tag="not_seen"):
    """Somebody looked, and what should stand at a station was not there; instead of it something of
    ``other_type`` (empty: nothing)."""

    KIND: ClassVar[str] = "contradiction"
    SUBJECT: ClassVar[str] = "station"
    MOST_PIECES: ClassVar[int] = 200  # each is also told as a motion, with its station
    station: StationName
    labware: tuple[LabwareId, ...]
    other_type: str = ""

    @property
    def choices(self) -> tuple[Choice, ...]:
        away = "What was recorded is off the bench, and what was seen was carried away."
        return (
            Choice("there", "It was not seen properly: all stands as recorded."),
            Choice("gone", away if self.other_type else "It was taken off the bench."),
        )

    @property
    def pieces(self) -> tuple[LabwareId, ...]:
        return self.labware

    @property
    def evidence(self) -> tuple[AnyEffect, ...]:
        return tuple(Needs(self.station, name) for name in self.labware)


class SeenElsewhere(Topic, frozen=True, tag="seen_elsewhere"):
    """Labware was recognised at a station where it should not be: it is ``recorded`` at another one (empty:
    its place is not known), or ``others`` should stand there."""

    KIND: ClassVar[str] = "contradiction"
    SUBJECT: ClassVar[str] = "station"
    station: StationName
    labware: LabwareId
    recorded: StationName = StationName("")
    others: tuple[LabwareId, ...] = ()

    @property
    def choices(self) -> tuple[Choice, ...]:
        name, recorded = self.labware, local(self.recorded)
        rest = f"; {', '.join(self.others)} is off the bench" if self.others else ""
        choices = [Choice("seen", f"{name} stands at {local(self.station)}{rest}.")]
        if recorded:
            choices.append(Choice("recorded", f"It was not seen properly: {name} is at {recorded}."))
        choices.append(Choice("gone", f"{name} is off the bench; all else stands as recorded."))
        return tuple(choices)

    @property
    def pieces(self) -> tuple[LabwareId, ...]:
        return (self.labware, *self.others)

    @property
    def evidence(self) -> tuple[AnyEffect, ...]:
        motion = Move(self.recorded or self.station, self.station, labware=self.labware)
        return (motion, *(Needs(self.station, name) for name in self.others))


class Unexpected(Topic, frozen=True, tag="unexpected"):
    """Something stands at a station where the log knows of nothing. If it is of a type that is known, it can
    get a name."""

    KIND: ClassVar[str] = "contradiction"
    SUBJECT: ClassVar[str] = "station"
    station: StationName
    type: str = ""

    @property
    def choices(self) -> tuple[Choice, ...]:
        choices = [Choice("removed", f"It was carried away; {local(self.station)} is as recorded.")]
        if self.type:
            choices.append(Choice("new", f"It is {self.type} for everybody, and gets a name."))
        return tuple(choices)

    @property
    def evidence(self) -> tuple[AnyEffect, ...]:
        return (Needs(self.station),)


class LostExperiment(Topic, frozen=True, tag="lost_experiment"):
    """The application of an experiment is silent."""

    KIND: ClassVar[str] = "lost_experiment"
    SUBJECT: ClassVar[str] = "experiment"
    CHOICES: ClassVar[tuple[Choice, ...]] = (
        Choice("close", "Its closing workflow clears away its labware."),
        Choice("wait", "It is left as it is: the application will come back."),
    )
    experiment: ExperimentId


class LateStep(Topic, frozen=True, tag="late_step"):
    """A step did not start in time: its run stands still."""

    KIND: ClassVar[str] = "late_step"
    CHOICES: ClassVar[tuple[Choice, ...]] = (
        Choice("go_on", "The step starts late, as soon as it can; the run goes on."),
        Choice("fail", "The run ends as failed; its labware stays where it is."),
    )
    step: int

    @property
    def subject(self) -> str:
        return f"{self.run}#{self.step}"


class FailedStep(Topic, frozen=True, tag="failed_step"):
    """A step failed, and its workflow has a person asked. ``done``: what it should do was done all the same;
    it can be done ``again`` if it did nothing."""

    KIND: ClassVar[str] = "failed_step"
    step: int
    done: bool = False
    again: bool = False
    may_skip: bool = False

    @property
    def subject(self) -> str:
        return f"{self.run}#{self.step}"

    @property
    def choices(self) -> tuple[Choice, ...]:
        choices = [Choice("retry", "It is done again.")] if self.again else []
        if self.done:
            choices.append(Choice("skip", "What it should do was done all the same: the run goes on."))
        elif self.may_skip:
            choices.append(Choice("skip", "The run goes on without it."))
        return (*choices, Choice("fail", "The run ends as failed; its labware stays where it is."))


class Barcode(Topic, frozen=True, tag="barcode"):
    """A barcode was read that is not that of the labware which should stand there. ``other`` bears it, and
    stands ``elsewhere`` (both empty: nothing known does that could stand there)."""

    KIND: ClassVar[str] = "barcode"
    SUBJECT: ClassVar[str] = "action"
    action: ActionId
    labware: LabwareId
    station: StationName
    barcode: str
    other: LabwareId = LabwareId("")
    elsewhere: StationName = StationName("")

    @property
    def choices(self) -> tuple[Choice, ...]:
        name, here, there = self.labware, local(self.station), local(self.elsewhere)
        choices = [
            Choice("misread", f"It was read wrongly: it is {name}, and all is as recorded."),
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


class PlannedWork(Topic, frozen=True, tag="planned_work"):
    """What a workflow asks a person to do; all other kinds ask for help."""

    KIND: ClassVar[str] = "planned_work"
    SUBJECT: ClassVar[str] = "action"
    CHOICES: ClassVar[tuple[Choice, ...]] = (
        Choice("done", "It is done: the run goes on."),
        Choice("not_done", "It cannot be done, and nothing was moved: the run ends."),
    )
    action: ActionId


class DoubtfulNode(Topic, frozen=True, tag="doubtful_node"):
    """Words on the bus that the lab did not believe."""

    KIND: ClassVar[str] = "doubtful_node"
    SUBJECT: ClassVar[str] = "module"

    @property
    def choices(self) -> tuple[Choice, ...]:
        name = local(self.module)
        return (Choice("checked", f"Somebody has looked at which processes speak for {name}."),)


class OutrankedNode(Topic, frozen=True, tag="outranked_node"):
    """A node that obeys a later kernel than this one."""

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
            "All stations were said on the round. Runs that were under way end, their labware stays "
            "where it was said to stand and belongs to their users; runs that wait are paused.",
        ),
    )

    @property
    def subject(self) -> str:
        return "log"


class DeviceWaits(Topic, frozen=True, tag="device_waits"):
    """A device waits for somebody in the midst of an action."""

    KIND: ClassVar[str] = "device_waits"
    SUBJECT: ClassVar[str] = "module"
    CHOICES: ClassVar[tuple[Choice, ...]] = (
        Choice("noted", "Somebody sees to it; this is not asked again while it lasts."),
    )


class ClosingWaits(Topic, frozen=True, tag="closing_waits"):
    """The closing workflow of an experiment does not begin."""

    KIND: ClassVar[str] = "closing_waits"
    SUBJECT: ClassVar[str] = "run"
    user: str

    @property
    def choices(self) -> tuple[Choice, ...]:
        return (
            Choice("wait", "It goes on waiting; this is not asked again."),
            Choice("end", f"The experiment ends; its labware stays where it is and is {self.user}'s."),
        )


class SecondPerson(Topic, frozen=True, tag="second_person"):
    """A run has a dangerous step, and waits until somebody other than its user has checked it."""

    KIND: ClassVar[str] = "second_person"
    SUBJECT: ClassVar[str] = "run"
    CHOICES: ClassVar[tuple[Choice, ...]] = (
        Choice("approve", "It may start. Only somebody else than its user can say so."),
        Choice("refuse", "It is cancelled."),
    )


class Approval(Topic, frozen=True, tag="approval"):
    """A submission, or a change of a campaign, waits for an approval: ``about`` it, as it is with this
    ``digest``. ``what`` is its kind."""

    KIND: ClassVar[str] = "approval"
    SUBJECT: ClassVar[str] = "about"
    about: str
    digest: str
    what: str

    @property
    def choices(self) -> tuple[Choice, ...]:
        refused = "The campaign goes on as before." if self.what == "amendment" else "It is cancelled."
        return (
            Choice("approve", "It goes on as it is."),
            Choice("refuse", refused),
        )


class BookedPlace(Topic, frozen=True, tag="booked_place"):
    """Where somebody has booked, labware of others stands, or an ``action`` of others is under way."""

    KIND: ClassVar[str] = "booked_place"
    CHOICES: ClassVar[tuple[Choice, ...]] = (
        Choice("noted", "Somebody sees to it. When the booking begins this is asked once more."),
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
"""Questions that are answered when somebody has said of all stations what stands there."""

LabwareInDoubt = LostLabware | Barcode | NotSeen | SeenElsewhere
"""Questions that are answered when the labware is seen."""

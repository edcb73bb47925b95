"""Reasons that concern the run itself."""

from __future__ import annotations

from labos.core.reasons._base import PERSON, Reason


class Paused(Reason, frozen=True):
    SENTENCE = "run {run} is paused"
    REMEDY = "Let it go on: labos resume {run}"
    WAKES = ("run",)
    URGENCY = PERSON
    run: str


class Unapproved(Reason, frozen=True):
    SENTENCE = "it has a dangerous step, and nobody but {user} has checked it yet"
    REMEDY = "Ask another operator to check it and to answer: labos resolve"
    WAKES = ("run",)
    URGENCY = PERSON
    user: str


class NotApproved(Reason, frozen=True):
    SENTENCE = "run {run} waits for approval, because {why}"
    REMEDY = "An operator looks at it (labos approvals {run}) and says: labos approve {run}"
    WAKES = ("run",)
    URGENCY = PERSON
    run: str
    why: str


class Halted(Reason, frozen=True):
    SENTENCE = "{by} has paused {target}"
    REMEDY = "Let it go on: labos resume {target}"
    URGENCY = PERSON
    target: str
    by: str


class LogShorter(Reason, frozen=True):
    SENTENCE = (
        "this log ends at {ended} and {evidence} knows more: nothing starts before the bench was compared"
    )
    REMEDY = "Go round the bench and say what stands where: labos bench round"
    URGENCY = PERSON
    evidence: str
    ended: str


class Cancelling(Reason, frozen=True):
    SENTENCE = "run {run} is being cancelled"
    WAKES = ("run",)
    run: str


class Gone(Reason, frozen=True):
    SENTENCE = "the run has ended"


class NotPending(Reason, frozen=True):
    SENTENCE = "step {step!r} is already under way"
    WAKES = ("run",)
    step: str


class After(Reason, frozen=True):
    SENTENCE = "an earlier step has not ended"
    WAKES = ("run",)
    step: str = ""


class RetryLater(Reason, frozen=True):
    SENTENCE = "step {step!r} failed and is tried again in a while"
    step: str


class Asked(Reason, frozen=True):
    SENTENCE = "step {step!r} failed, and a person has to say what follows"
    REMEDY = "Answer what is asked: labos resolve {question}"
    URGENCY = PERSON
    step: str
    question: str


class TooEarly(Reason, frozen=True):
    SENTENCE = "step {step!r} has to wait a set time"
    step: str


class Outcome(Reason, frozen=True):
    SENTENCE = "it is not known how step {step!r} ended"
    REMEDY = "Look there and answer what is asked: labos resolve"
    WAKES = ("run",)
    URGENCY = PERSON
    step: str


class Quota(Reason, frozen=True):
    SENTENCE = "the quota of {whose} is {limit}"
    WAKES = ("quota",)
    URGENCY = PERSON
    whose: str
    limit: str


RunReason = (
    Paused
    | Unapproved
    | NotApproved
    | Halted
    | LogShorter
    | Cancelling
    | Gone
    | NotPending
    | After
    | RetryLater
    | Asked
    | TooEarly
    | Outcome
    | Quota
)

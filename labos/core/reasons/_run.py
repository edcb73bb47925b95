"""Reasons that concern the run itself."""

from __future__ import annotations

from labos.core.reasons._base import PERSON, Reason


class OfRun(Reason, frozen=True):
    """A reason that may end when the run changes."""

    WAKES = ("run",)


class Paused(OfRun, frozen=True):
    SENTENCE = "run {run} is paused"
    REMEDY = "Continue it: labos resume {run}"
    URGENCY = PERSON
    run: str


class Unapproved(OfRun, frozen=True):
    SENTENCE = "it has a dangerous step, and nobody except {user} has checked it yet"
    REMEDY = "Ask another operator to check it and to answer the question: labos resolve"
    URGENCY = PERSON
    user: str


class NotApproved(OfRun, frozen=True):
    SENTENCE = "run {run} waits for approval, because {why}"
    REMEDY = "An operator checks it (labos approvals {run}) and approves it: labos approve {run}"
    URGENCY = PERSON
    run: str
    why: str


class Halted(Reason, frozen=True):
    SENTENCE = "{by} has paused {target}"
    REMEDY = "Continue it: labos resume {target}"
    URGENCY = PERSON
    target: str
    by: str


class LogShorter(Reason, frozen=True):
    SENTENCE = (
        "this log ends at {ended} and {evidence} knows more: nothing starts until the whole bench "
        "has been checked"
    )
    REMEDY = "Check the whole bench and report what stands where: labos bench round"
    URGENCY = PERSON
    evidence: str
    ended: str


class Cancelling(OfRun, frozen=True):
    SENTENCE = "run {run} is being cancelled"
    run: str


class Gone(Reason, frozen=True):
    SENTENCE = "the run has ended"


class NotPending(OfRun, frozen=True):
    SENTENCE = "step {step!r} is already in progress"
    step: str


class After(OfRun, frozen=True):
    SENTENCE = "an earlier step has not ended"
    step: str = ""


class RetryLater(Reason, frozen=True):
    SENTENCE = "step {step!r} failed and will be tried again"
    step: str


class Asked(Reason, frozen=True):
    SENTENCE = "step {step!r} failed, and a person has to decide how to continue"
    REMEDY = "Answer the open question: labos resolve {question}"
    URGENCY = PERSON
    step: str
    question: str


class TooEarly(Reason, frozen=True):
    SENTENCE = "step {step!r} has to wait a set time"
    step: str


class Outcome(OfRun, frozen=True):
    SENTENCE = "it is not known how step {step!r} ended"
    REMEDY = "Look there and answer the open question: labos resolve"
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

"""Reasons that concern the run itself."""

from __future__ import annotations

from labos.core.reasons._base import NeedsPerson, Reason


class Paused(NeedsPerson, frozen=True):
    SENTENCE = "run {run} is paused"
    REMEDY = "Continue it: labos resume {run}"
    WAKES = ("run",)
    run: str


class Unapproved(NeedsPerson, frozen=True):
    SENTENCE = "it has a dangerous step, and nobody except {user} has checked it yet"
    REMEDY = "Ask another operator to check it and to answer the question: labos resolve"
    WAKES = ("run",)
    user: str


class NotApproved(NeedsPerson, frozen=True):
    SENTENCE = "run {run} waits for approval, because {why}"
    REMEDY = "An operator checks it (labos approvals {run}) and approves it: labos approve {run}"
    WAKES = ("run",)
    run: str
    why: str


class Halted(NeedsPerson, frozen=True):
    SENTENCE = "{by} has paused {target}"
    REMEDY = "Continue it: labos resume {target}"
    target: str
    by: str


class LogShorter(NeedsPerson, frozen=True):
    SENTENCE = (
        "this log ends at {ended} and {evidence} knows more: nothing starts until the whole bench "
        "has been checked"
    )
    REMEDY = "Check the whole bench and report what stands where: labos bench round"
    evidence: str
    ended: str


class Cancelling(Reason, frozen=True):
    SENTENCE = "run {run} is being cancelled"
    WAKES = ("run",)
    run: str


class Gone(Reason, frozen=True):
    SENTENCE = "the run has ended"


class NotPending(Reason, frozen=True):
    SENTENCE = "step {step!r} is already in progress"
    WAKES = ("run",)
    step: str


class After(Reason, frozen=True):
    SENTENCE = "an earlier step has not ended"
    WAKES = ("run",)
    step: str = ""


class RetryLater(Reason, frozen=True):
    SENTENCE = "step {step!r} failed and will be tried again"
    step: str


class Asked(NeedsPerson, frozen=True):
    SENTENCE = "step {step!r} failed, and a person has to decide how to continue"
    REMEDY = "Answer the open question: labos resolve {question}"
    step: str
    question: str


class TooEarly(Reason, frozen=True):
    SENTENCE = "step {step!r} has to wait a set time"
    step: str


class Outcome(NeedsPerson, frozen=True):
    SENTENCE = "it is not known how step {step!r} ended"
    REMEDY = "Look there and answer the open question: labos resolve"
    WAKES = ("run",)
    step: str


class Quota(NeedsPerson, frozen=True):
    SENTENCE = "the quota of {whose} is {limit}"
    WAKES = ("quota",)
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

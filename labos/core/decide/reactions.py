"""The events that follow from an event, in order.

A reaction reads the state after the event and all events that were decided with it. It yields further events;
each is folded before the reaction continues. Reactions run while a command is carried out, never while a log
is folded: their results are in the log.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

from labos.core.actions import (
    ActionAccepted,
    ActionFailed,
    ActionReconciled,
    ActionRejected,
    ActionReported,
    ActionSucceeded,
    ActionUnknown,
)
from labos.core.approvals import ApprovalGiven, ApprovalRequested
from labos.core.bookings import (
    BookingBegan,
    BookingCancelled,
    BookingChanged,
    BookingEnded,
    BookingNeared,
    BookingSkipped,
)
from labos.core.campaigns import (
    CampaignAmended,
    CampaignCancelled,
    CampaignCompleted,
    CampaignRowRefused,
    CampaignStopped,
)
from labos.core.decide.bookings import (
    ask_about_overrun,
    ask_to_clear_booking,
    withdraw_booking_questions,
    withdraw_cleared_booking_question,
)
from labos.core.decide.campaigns import conclude_campaigns, pause_campaigns
from labos.core.decide.endings import end_recovery, end_run, skip_steps
from labos.core.decide.experiments import end_experiments, withdraw_experiment_question
from labos.core.decide.proposals import ask_for_approval, ask_second_person, withdraw_approval_question
from labos.core.decide.steps import check_result, fail_spoilt, handle_failure, retry_step
from labos.core.decide.waiting import withdraw_action_questions, withdraw_waiting
from labos.core.decide.windows import withdraw_late_questions, withdraw_run_questions
from labos.core.experiments import ExperimentCancelled, ExperimentClosing, ExperimentEnded, ExperimentResumed
from labos.core.lab import KernelStarted
from labos.core.labware import LabwareMoved, LabwareRemoved
from labos.core.modules import NodeLeft, NodeStateChanged
from labos.core.registry import Event
from labos.core.runs import RunCancelled, RunCompleted, RunFailed, RunResumed, RunStarted, RunSubmitted
from labos.core.state import LabState
from labos.core.steps import StepSkipped, StepUnexpected
from labos.core.users import UserDisabled

Reaction = Callable[[LabState, Any], Iterator[Event]]

REACTIONS: dict[type[Event], tuple[Reaction, ...]] = {
    # In logs of earlier versions, a later command should have done these, but it was never sent.
    KernelStarted: (end_experiments, conclude_campaigns),
    NodeLeft: (withdraw_waiting,),
    NodeStateChanged: (withdraw_waiting,),
    ActionAccepted: (withdraw_action_questions,),
    ActionReported: (withdraw_action_questions, withdraw_waiting),
    ActionRejected: (withdraw_action_questions, withdraw_waiting, handle_failure, end_run),
    ActionSucceeded: (
        withdraw_action_questions,
        withdraw_waiting,
        check_result,
        end_recovery,
        skip_steps,
        end_run,
        withdraw_cleared_booking_question,
    ),
    ActionFailed: (
        withdraw_action_questions,
        withdraw_waiting,
        retry_step,
        handle_failure,
        withdraw_cleared_booking_question,
    ),
    ActionUnknown: (withdraw_waiting,),
    ActionReconciled: (fail_spoilt, end_recovery, skip_steps, end_run),
    StepSkipped: (skip_steps, end_run),
    StepUnexpected: (handle_failure,),
    RunSubmitted: (ask_second_person,),
    RunStarted: (withdraw_run_questions,),
    RunResumed: (withdraw_late_questions,),
    RunCompleted: (withdraw_run_questions, end_experiments, conclude_campaigns),
    RunFailed: (withdraw_run_questions, end_experiments, conclude_campaigns),
    RunCancelled: (withdraw_run_questions, end_experiments, conclude_campaigns),
    ExperimentResumed: (withdraw_experiment_question,),
    ExperimentClosing: (withdraw_experiment_question, withdraw_approval_question),
    ExperimentEnded: (withdraw_experiment_question, withdraw_approval_question),
    CampaignAmended: (conclude_campaigns,),
    CampaignRowRefused: (conclude_campaigns,),
    UserDisabled: (pause_campaigns,),
    ApprovalRequested: (ask_for_approval,),
    ApprovalGiven: (ask_second_person,),
    CampaignCancelled: (withdraw_approval_question, conclude_campaigns),
    CampaignStopped: (withdraw_approval_question, conclude_campaigns),
    CampaignCompleted: (withdraw_approval_question,),
    ExperimentCancelled: (withdraw_approval_question, end_experiments),
    BookingNeared: (ask_to_clear_booking,),
    BookingBegan: (ask_about_overrun,),
    BookingChanged: (withdraw_booking_questions,),
    BookingCancelled: (withdraw_booking_questions,),
    BookingSkipped: (withdraw_booking_questions,),
    BookingEnded: (withdraw_booking_questions,),
    LabwareMoved: (withdraw_cleared_booking_question,),
    LabwareRemoved: (withdraw_cleared_booking_question,),
}

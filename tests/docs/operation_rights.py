"""Which commands each operation gives, and which command of ``labos`` asks for it: what an operation needs
follows from the rights of its commands.

Operations that only look give none, and need a viewer. Those that change something without a command say in
``BY_ITSELF`` what they need.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal

from labos.core.decide import Command
from labos.core.decide.access import EndAccess, RequestAccess
from labos.core.decide.bookings import CancelBooking, ChangeBooking, MakeBooking
from labos.core.decide.calibrations import CalibrateModule
from labos.core.decide.campaigns import (
    AmendCampaign,
    ArchiveCampaign,
    CancelCampaign,
    PauseCampaign,
    ResumeCampaign,
    SubmitCampaign,
)
from labos.core.decide.cancelling import CancelRun
from labos.core.decide.composites import DeclareStations, ReportRound, SubmitRuns, SubmitWithLabware
from labos.core.decide.control import CancelExperiment, CancelRuns, PauseStarts, ResumeStarts
from labos.core.decide.erasure import EraseWords, RefuseErasure
from labos.core.decide.experiments import EndExperiment, NoteExperiment, ResumeExperiment, StartExperiment
from labos.core.decide.handover import HandOver
from labos.core.decide.interventions import ResolveIntervention
from labos.core.decide.lab import ApplyWorkcell, DeclareStation
from labos.core.decide.labware import NameBarcode, RegisterSamples
from labos.core.decide.nodes import PutBack, TakeOut
from labos.core.decide.observation import ObserveStation
from labos.core.decide.proposals import ApproveProposal, RefuseProposal
from labos.core.decide.rights import RIGHTS
from labos.core.decide.runs import PauseRun, ResumeRun, SubmitRun
from labos.core.decide.shares import ApplyShares
from labos.core.decide.shorter import ConfirmStations, SayContents
from labos.core.decide.signatures import SignRecords, SignRun
from labos.core.decide.stock import LoadStation, Replenish, UnloadStation
from labos.core.decide.submissions import ApplyPolicy
from labos.core.decide.suggestions import SuggestOrder
from labos.core.decide.teach import TeachLocation
from labos.core.decide.users import (
    AddGroup,
    AddMember,
    AddUser,
    DisableUser,
    EnableUser,
    EraseUser,
    GrantRole,
    RemoveGroup,
    RemoveMember,
    RevokeRole,
)
from labos.core.users import ROLES, Role

GIVES: Mapping[str, tuple[type[Command], ...]] = {
    "pause": (PauseStarts, PauseRun),
    "resume": (ResumeStarts, ResumeRun),
    "cancel": (CancelRuns, CancelRun, CancelExperiment),
    "submit_run": (SubmitRun, SubmitWithLabware, LoadStation),
    "submit_runs": (SubmitRuns, SubmitRun, LoadStation),
    "cancel_run": (CancelRun,),
    "pause_run": (PauseRun,),
    "resume_run": (ResumeRun,),
    "sign_run": (SignRun,),
    "sign_experiment": (SignRecords,),
    "sign_campaign": (SignRecords,),
    "start_experiment": (StartExperiment,),
    "resume_experiment": (ResumeExperiment,),
    "end_experiment": (EndExperiment,),
    "note_experiment": (NoteExperiment,),
    "submit_campaign_file": (SubmitCampaign,),
    "pause_campaign": (PauseCampaign,),
    "resume_campaign": (ResumeCampaign,),
    "cancel_campaign": (CancelCampaign,),
    "amend_campaign": (AmendCampaign,),
    "clone_a_campaign": (SubmitCampaign,),
    "archive_campaign": (ArchiveCampaign,),
    "apply_shares": (ApplyShares,),
    "approve_proposal": (ApproveProposal,),
    "refuse_proposal": (RefuseProposal,),
    "apply_policy": (ApplyPolicy,),
    "erase_words": (EraseWords,),
    "approve_erasure": (EraseWords,),
    "refuse_erasure": (RefuseErasure,),
    "take_out_of_service": (TakeOut,),
    "put_in_service": (PutBack,),
    "replenish_resource": (Replenish,),
    "teach_location": (TeachLocation,),
    "calibrate_module": (CalibrateModule,),
    "change_workcell": (ApplyWorkcell, DeclareStation),
    "suggest_order": (SuggestOrder,),
    "request_workcell_access": (RequestAccess, SubmitRun),
    "end_workcell_access": (EndAccess,),
    "make_booking": (MakeBooking,),
    "change_booking": (ChangeBooking,),
    "cancel_booking": (CancelBooking,),
    "answer_intervention": (ResolveIntervention,),
    "place_labware": (LoadStation,),
    "load_station": (LoadStation,),
    "unload_station": (UnloadStation,),
    "observe_station": (ObserveStation,),
    "declare_stations": (DeclareStations, DeclareStation),
    "report_round": (ReportRound, SayContents, ConfirmStations),
    "label_labware": (NameBarcode,),
    "hand_over_labware": (HandOver,),
    "register_sheet": (RegisterSamples,),
    "add_user": (AddUser, GrantRole),
    "disable_user": (DisableUser,),
    "enable_user": (EnableUser,),
    "erase_person": (EraseUser,),
    "add_group": (AddGroup,),
    "remove_group": (RemoveGroup,),
    "add_member": (AddMember,),
    "remove_member": (RemoveMember,),
    "grant_role": (GrantRole,),
    "revoke_role": (RevokeRole,),
}
"""The commands of an operation, by its id. The first is what it is for; others it gives along with that, or
in its place, and they may be refused by themselves."""

ALL_OF = frozenset({"change_workcell", "request_workcell_access", "end_workcell_access"})
"""Operations that need what each of their commands needs; of the others the least is enough."""

BY_ITSELF: Mapping[str, Role | Literal["nobody"]] = {
    "sign_in": "nobody",
    "begin_sign_in": "nobody",
    "finish_sign_in": "nobody",
    "sign_out": "viewer",
    "make_token": "viewer",
    "revoke_token": "viewer",
    "change_password": "viewer",
    "change_person": "viewer",
    "link_identity": "admin",
    "record_heartbeat": "submitter",
    "keep_file": "submitter",
    "stop_modules": "submitter",
    "trace_wires": "operator",
    "check_run": "submitter",
    "forecast_run": "submitter",
    "forecast_campaign_file": "submitter",
}
"""What operations need that change something without a command. A viewer does it with passwords, tokens and
names of their own; an admin with those of others."""

ASKED_BY: Mapping[str, tuple[str, ...]] = {
    "pause": ("labos pause",),
    "resume": ("labos resume",),
    "cancel": ("labos cancel",),
    "stop_modules": ("labos estop",),
    "submit_run": ("labos run", "labos submit", "labos do", "labos reset", "labos home"),
    "sign_run": ("labos sign",),
    "sign_experiment": ("labos sign",),
    "sign_campaign": ("labos sign",),
    "submit_campaign_file": ("labos campaign submit",),
    "forecast_campaign_file": ("labos campaign plan",),
    "pause_campaign": ("labos campaign pause",),
    "resume_campaign": ("labos campaign resume",),
    "cancel_campaign": ("labos campaign cancel",),
    "amend_campaign": ("labos campaign amend",),
    "clone_a_campaign": ("labos campaign clone",),
    "archive_campaign": ("labos campaign archive",),
    "apply_shares": ("labos shares",),
    "approve_proposal": ("labos approve",),
    "refuse_proposal": ("labos refuse",),
    "apply_policy": ("labos policy",),
    "erase_words": ("labos erase",),
    "approve_erasure": ("labos erase",),
    "refuse_erasure": ("labos erase",),
    "take_out_of_service": ("labos out-of-service",),
    "put_in_service": ("labos in-service",),
    "replenish_resource": ("labos replenish",),
    "teach_location": ("labos teach",),
    "calibrate_module": ("labos calibrate",),
    "change_workcell": ("labos workcell apply",),
    "suggest_order": ("labos planner",),
    "request_workcell_access": ("labos access",),
    "end_workcell_access": ("labos access",),
    "make_booking": ("labos book add",),
    "change_booking": ("labos book change",),
    "cancel_booking": ("labos book cancel",),
    "answer_intervention": ("labos resolve", "labos confirm"),
    "place_labware": ("labos place",),
    "load_station": ("labos load",),
    "unload_station": ("labos unload",),
    "observe_station": ("labos observe",),
    "declare_stations": ("labos bench declare",),
    "report_round": ("labos bench round",),
    "label_labware": ("labos barcode",),
    "hand_over_labware": ("labos give",),
    "register_sheet": ("labos samples load",),
    "trace_wires": ("labos node trace",),
    "sign_in": ("labos login",),
    "begin_sign_in": ("labos login",),
    "finish_sign_in": ("labos login",),
    "sign_out": ("labos logout",),
    "make_token": ("labos token create",),
    "revoke_token": ("labos token revoke",),
    "change_password": ("labos user password",),
    "change_person": ("labos user add", "labos user name"),
    "erase_person": ("labos user erase",),
    "link_identity": ("labos user link",),
    "add_user": ("labos user add",),
    "disable_user": ("labos user disable",),
    "enable_user": ("labos user enable",),
    "add_group": ("labos group add",),
    "remove_group": ("labos group remove",),
    "add_member": ("labos group member add",),
    "remove_member": ("labos group member remove",),
    "grant_role": ("labos role grant",),
    "revoke_role": ("labos role revoke",),
}
"""The commands of ``labos`` that ask for an operation, by its id. Those that are not here are asked for by
programs (``labos.client``)."""


def find_least_role(operation: str) -> Role | Literal["nobody"]:
    """The least role with which an operation may succeed."""
    if operation in BY_ITSELF:
        return BY_ITSELF[operation]
    roles = [role for command in GIVES.get(operation, ()) if (role := RIGHTS[command].role) is not None]
    choose = max if operation in ALL_OF else min
    return choose(roles, key=ROLES.index) if roles else "viewer"

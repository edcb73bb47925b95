"""Ways around: everything that is ada's, tried by bo, who submits, and by olga, who operates the workcell."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from labos.core.campaigns import CampaignStopped, Terms
from labos.core.decide import Command, Denied, Rejection
from labos.core.decide.access import EndAccess, RequestAccess
from labos.core.decide.calibrations import CalibrateModule
from labos.core.decide.campaigns import (
    AmendCampaign,
    ArchiveCampaign,
    CancelCampaign,
    PauseCampaign,
    ResumeCampaign,
    SubmitCampaign,
    SubmitRow,
)
from labos.core.decide.cancelling import CancelRun
from labos.core.decide.control import CancelExperiment, CancelRuns, PauseStarts, ResumeStarts
from labos.core.decide.experiments import EndExperiment, NoteExperiment, ResumeExperiment, StartExperiment
from labos.core.decide.handover import HandOver
from labos.core.decide.interventions import ResolveIntervention
from labos.core.decide.lab import ApplyWorkcell, DeclareStation
from labos.core.decide.labware import NameBarcode, PlateSamples, RegisterSamples
from labos.core.decide.nodes import PutBack, TakeOut
from labos.core.decide.observation import ObserveStation
from labos.core.decide.runs import PauseRun, ResumeRun, SubmitRun
from labos.core.decide.shares import ApplyShares
from labos.core.decide.stock import LoadStation, Replenish, UnloadStation
from labos.core.decide.teach import TeachLocation
from labos.core.decide.users import AddUser, DisableUser, EnableUser, GrantRole, RevokeRole
from labos.core.ids import (
    CampaignId,
    ExperimentId,
    InterventionId,
    LabwareId,
    ModuleName,
    Owner,
    RunId,
    StationName,
)
from labos.core.lab import WHOLE_LAB
from labos.core.model import ON_CANCEL, Window
from tests.support.bench import Driver, full, plan, route, small_cell, step
from tests.unit.core.test_rights import make_peopled

ARM, A = ModuleName(full("arm")), StationName(full("a"))
E, C, P, R = ExperimentId("E1"), CampaignId("C1"), LabwareId("P1"), RunId("R3")


def make_crowded() -> Driver:
    """Of ada: the plate P1 at a; the experiment E1 with the run R2, the campaign C1, and the run R3."""
    lab = make_peopled()
    lab.do(SubmitRun(route("stack", "a"), "ada"), "ada")
    lab.step("R1")
    lab.do(StartExperiment("app", "ada"), "ada")
    lab.do(SubmitRun(route("stack", "b"), "ada", experiment=E), "ada")
    lab.do(SubmitCampaign("screen", "ada", "flow", "cell", 3, "d", "e"), "ada")
    lab.do(SubmitRun(route("stack", "c"), "ada"), "ada")
    assert lab.owner("P1") == "user:ada"
    return lab


HERS: dict[str, Callable[[str], Command]] = {
    "her run is paused": lambda by: PauseRun(R),
    "her run goes on": lambda by: ResumeRun(R),
    "her run is cancelled": lambda by: CancelRun(R),
    "the run of her experiment is cancelled": lambda by: CancelRun(RunId("R2")),
    "her experiment is cancelled": lambda by: CancelExperiment(E, by),
    "her experiment starts nothing": lambda by: PauseStarts("E1", by),
    "her experiment goes on": lambda by: ResumeStarts("E1", by),
    "her experiment is resumed": lambda by: ResumeExperiment(E, "app"),
    "her experiment notes something": lambda by: NoteExperiment(E, "decision", "mine"),
    "her campaign is paused": lambda by: PauseCampaign(C),
    "her campaign goes on": lambda by: ResumeCampaign(C),
    "her campaign has other terms": lambda by: AmendCampaign(C, Terms(priority=9)),
    "her campaign is cancelled": lambda by: CancelCampaign(C),
    "her plate has another barcode": lambda by: NameBarcode(P, "X1", by),
    "her plate has other samples": lambda by: RegisterSamples("d", (PlateSamples(P, 0),)),
}
"""What its owner may do, and an operator of the workcell."""


@pytest.mark.parametrize("way", HERS)
def test_what_is_somebodys_is_touched_by_the_owner_and_by_operators_only(way: str) -> None:
    lab = make_crowded()
    found = lab.reject(HERS[way]("bo"), "bo")
    assert isinstance(found, Denied)
    assert found.code == "not_yours"
    assert "olga" in found.remedy
    assert lab.reject(HERS[way]("vic"), "vic").code == "not_yours"
    lab.do(HERS[way]("ada"), "ada")
    make_crowded().do(HERS[way]("olga"), "olga")


OPERATORS: dict[str, Callable[[str], Command]] = {
    "labware is declared": lambda by: DeclareStation(A, ("plate",)),
    "labware is loaded": lambda by: LoadStation(StationName(full("b")), "plate", 1),
    "labware is taken away": lambda by: UnloadStation(A, by),
    "a station is seen empty": lambda by: ObserveStation(A, by, 0),
    "a module is taken out": lambda by: TakeOut(ARM, "oil", 0, 1),
    "a module is put back": lambda by: PutBack(ARM),
    "an arm is taught": lambda by: TeachLocation(ARM, A, (1.0,), by),
    "a module is calibrated": lambda by: CalibrateModule(ARM, by, "volume", until="2027-01-01"),
    "a resource is filled": lambda by: Replenish(ARM, "tips", 1.0, "", "", False, "2026-11-24"),
    "a module starts nothing": lambda by: PauseStarts(str(ARM), by),
    "a workcell starts nothing": lambda by: PauseStarts("cell", by),
    "all runs of a workcell are cancelled": lambda by: CancelRuns("cell"),
    "somebody reaches in": lambda by: RequestAccess("cell", by),
    "somebody is out again": lambda by: EndAccess("cell", by),
}


@pytest.mark.parametrize("way", OPERATORS)
def test_the_bench_and_its_modules_are_operators(way: str) -> None:
    lab = make_crowded()
    assert lab.reject(OPERATORS[way]("ada"), "ada").code == "no_right"
    assert not isinstance(lab.ask(OPERATORS[way]("olga"), "olga"), Denied)


ADMINS: dict[str, Command] = {
    "the whole lab starts nothing": PauseStarts(WHOLE_LAB, "olga"),
    "all runs are cancelled": CancelRuns(WHOLE_LAB),
    "a workcell is changed": ApplyWorkcell(small_cell()),
    "shares are others": ApplyShares("d"),
    "a user is added": AddUser("eve"),
    "a user is disabled": DisableUser("ada"),
    "a user is enabled": EnableUser("ada"),
    "a role is granted": GrantRole("user:olga", "admin", "cell"),
    "a role is taken away": RevokeRole("user:root-1"),
}


@pytest.mark.parametrize("way", ADMINS)
def test_the_lab_as_a_whole_is_not_an_operators_of_one_workcell(way: str) -> None:
    assert make_crowded().reject(ADMINS[way], "olga").code == "no_right"


def test_a_run_in_anothers_experiment_is_refused_to_everybody() -> None:
    lab = make_crowded()
    for user in ("bo", "olga", "root-1"):
        asked = SubmitRun(route("stack", "b"), user, experiment=E)
        assert lab.reject(asked, user).code == "not_yours"


def test_a_window_that_waits_for_anothers_run_is_refused() -> None:
    """Clocks are started by runs of the same experiment only, and that is its owner's."""
    lab = make_crowded()
    waiting = plan(step("arm", windows=()), name="waits")
    asked = SubmitRun(waiting, "bo", experiment=E)
    assert lab.reject(asked, "bo").code == "not_yours"


@pytest.mark.parametrize("of", ["R1", "R2", "route", "flow"])
def test_nobodys_run_but_ones_own_starts_a_clock(of: str) -> None:
    """Bo has an experiment of his own, and names ada's run in it, by its id or by its workflow."""
    lab = make_crowded()
    lab.step("R2")
    lab.do(StartExperiment("app", "bo"), "bo")
    window = Window(None, wait_s=1.0, within_s=2.0, of=of, of_step="move")
    timed = plan(step("arm", windows=(window,)), name="waits")
    asked = SubmitRun(timed, "bo", experiment=ExperimentId("E2"))
    assert lab.reject(asked, "bo").code == "no_anchor"
    assert lab.reject(SubmitRun(timed, "bo", experiment=E), "bo").code == "not_yours"
    assert lab.reject(SubmitRun(timed, "bo"), "bo").code == "no_anchor"


def test_nothing_is_given_to_anothers_run_nor_taken_out_of_it() -> None:
    lab = make_crowded()
    run = lab.submit(route("stack", "b", "c"), "ada")
    lab.step(run, 0)
    (hers,) = [item.id for item in lab.state.bench.labware.values() if item.owner == f"run:{run}"]
    lab.do(SubmitRun(route("stack", "b"), "bo"), "bo")
    for to in ("user:bo", "run:R5", "shared"):
        taken = HandOver(hers, Owner(to), "bo")
        assert lab.reject(taken, "bo").code == "not_yours", to
    assert lab.reject(HandOver(P, Owner("run:R5"), "bo"), "bo").code == "not_yours"
    before = lab.owner("P1")
    for to in ("run:R5", str(f"run:{run}"), "experiment:E1"):
        assert isinstance(lab.ask(HandOver(P, Owner(to), "bo"), "bo"), Rejection), to
    assert lab.owner("P1") == before
    assert lab.owner(str(hers)) == f"run:{run}"


def test_a_campaign_is_archived_by_its_owner_and_by_operators_only() -> None:
    lab = make_crowded()
    lab.do(CancelCampaign(C), "ada")
    assert C in lab.state.campaigns.ended
    found = lab.reject(ArchiveCampaign(C), "bo")
    assert (found.code, "olga" in found.remedy) == ("not_yours", True)
    assert lab.reject(ArchiveCampaign(C), "vic").code == "not_yours"
    lab.do(ArchiveCampaign(C), "ada")
    assert lab.reject(ArchiveCampaign(C, undo=True), "bo").code == "not_yours"
    lab.do(ArchiveCampaign(C, undo=True), "olga")


def test_anothers_plate_is_not_used_whatever_the_workflow_names() -> None:
    """The stations may come out of a payload or another file: what stands there is not his."""
    lab = make_crowded()
    lab.do(SubmitRun(route("a", "c"), "bo"), "bo")
    assert lab.code("R4") == "not_yours"
    lab.do(SubmitRun(route("a", "c"), "ada"), "ada")
    assert lab.code("R5") == ""


def test_labware_is_given_by_its_owner_to_users_and_to_nobodys_experiment() -> None:
    lab = make_crowded()

    def give(to: str, by: str, force: bool = False) -> HandOver:
        return HandOver(P, Owner(to), by, force, "because")

    assert lab.reject(give("user:bo", "bo"), "bo").code == "not_yours"
    assert lab.reject(give("shared", "bo"), "bo").code == "not_yours"
    assert lab.reject(give("user:bo", "bo", force=True), "bo").code == "not_yours"
    assert lab.reject(give("user:bo", "ada", force=True), "ada").code == "no_right"
    assert lab.reject(give("user:eve", "ada"), "ada").code == "no_user"
    assert lab.reject(give("user:bo", "ada"), "bo").code == "not_you"
    lab.do(give("user:bo", "ada"), "ada")
    # To put it into her experiment is to touch her experiment.
    assert lab.reject(give("experiment:E1", "bo"), "bo").code == "not_yours"
    lab.do(give("shared", "olga", force=True), "olga")


def test_what_an_experiment_has_parked_is_its_owners() -> None:
    lab = make_crowded()
    lab.step("R2")
    parked = lab.state.bench.stations[StationName(full("b"))].labware[0]
    assert lab.owner(parked) == "experiment:E1"
    taken = HandOver(parked, Owner("user:bo"), "bo")
    assert lab.reject(taken, "bo").code == "not_yours"
    assert lab.reject(NameBarcode(parked, "X", "bo"), "bo").code == "not_yours"
    lab.do(SubmitRun(route("b", "c"), "bo"), "bo")
    assert lab.code(f"R{lab.state.runs.named}") == "not_yours"
    assert lab.reject(EndExperiment(E), "bo").code == "not_yours"
    lab.do(EndExperiment(E), "ada")


def test_questions_about_a_run_are_its_owners_too_and_what_was_seen_is_operators() -> None:
    lab = make_crowded()
    action = lab.start("R3")
    lab.doubt(action)
    question = next(iter(lab.state.interventions.open))
    assert lab.reject(ResolveIntervention(question, "done", "ada"), "ada").code == "no_right"
    assert lab.reject(ResolveIntervention(question, "done", "bo"), "bo").code == "no_right"
    assert not isinstance(lab.ask(ResolveIntervention(question, "done", "olga"), "olga"), Denied)


def test_a_silent_application_is_closed_by_its_owner_or_an_operator() -> None:
    from labos.core.decide.experiments import LoseExperiment

    lab = make_crowded()
    lab.do(CancelRun(RunId("R2")), "ada")
    lab.do(LoseExperiment(E, "no heartbeat"))
    question = InterventionId(f"I{lab.state.interventions.named}")
    assert lab.reject(ResolveIntervention(question, "close", "bo"), "bo").code == "not_yours"
    lab.do(ResolveIntervention(question, "close", "ada"), "ada")


def test_the_feeder_goes_on_for_the_campaigns_owner() -> None:
    lab = make_crowded()
    row = SubmitRow(C, 0, route("stack", "b"))
    assert lab.reject(row, "ada").code == "inside"
    lab.do(row)
    assert lab.state.runs.queued[RunId("R4")].user == "ada"


def test_a_module_is_not_reset_by_whoever_submits() -> None:
    lab = make_crowded()
    reset = plan(step("dev", recovers=True), name="reset")
    assert lab.reject(SubmitRun(reset, "bo"), "bo").code == "no_right"
    lab.do(SubmitRun(reset, "olga"), "olga")
    stopped, *_ = lab.do(SubmitRow(C, 0, reset))
    assert isinstance(stopped, CampaignStopped)
    assert "needs the role operator in cell; ada is submitter" in stopped.why


def test_nor_by_way_of_a_recovery_a_way_out_or_a_closing_workflow() -> None:
    lab = make_crowded()
    own = plan(step("dev"), step("dev", recovers=True, part=0, after=()))
    others = plan(step("arm"), step("dev", recovers=True, part=0, after=()))
    leaving = plan(step("dev"), step("dev", recovers=True, part=ON_CANCEL, after=()))
    lab.do(SubmitRun(own, "bo"), "bo")
    for asked in (SubmitRun(others, "bo"), SubmitRun(leaving, "bo"), StartExperiment("app", "bo", others)):
        assert lab.reject(asked, "bo").code == "no_right"


def test_a_campaign_stops_when_its_user_may_not_submit_any_more() -> None:
    lab = make_crowded()
    lab.do(SubmitRow(C, 0, route("stack", "b")))
    lab.do(RevokeRole("user:ada"), "root-1")
    lab.do(SubmitRow(C, 1, route("stack", "b")))
    campaign = lab.state.campaigns.open[C]
    assert (campaign.status, campaign.next_row) == ("stopped", 1)
    lab.check_log()


def test_the_campaigns_of_a_user_who_is_disabled_are_paused() -> None:
    lab = make_crowded()
    lab.do(SubmitRow(C, 0, route("stack", "b")))
    lab.do(DisableUser("ada"), "root-1")
    assert lab.state.campaigns.open[C].status == "paused"
    assert lab.state.runs.queued[RunId("R4")].paused
    assert not lab.state.runs.queued[R].paused, "what she has submitted goes on"
    lab.do(EnableUser("ada"), "root-1")
    lab.do(ResumeCampaign(C), "olga")
    lab.check_log()


def test_an_idempotency_key_of_another_gives_nothing_away() -> None:
    lab = make_peopled()
    lab.do(SubmitRun(route("stack", "a"), "ada", request="key"), "ada")
    assert lab.do(SubmitRun(route("stack", "a"), "bo", request="key"), "bo") == []
    assert lab.reject(SubmitRun(route("stack", "a"), "ada", request="key"), "bo").code == "not_you"

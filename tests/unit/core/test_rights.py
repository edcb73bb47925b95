"""Who may ask for what: the table, and the guard at the door of ``decide``."""

from __future__ import annotations

import pytest

from labos.core.decide import Command, Denied
from labos.core.decide._base import DECIDERS
from labos.core.decide.cancelling import CancelRun
from labos.core.decide.lab import DeclareStation
from labos.core.decide.nodes import TakeOut
from labos.core.decide.rights import RIGHTS
from labos.core.decide.runs import PauseRun, SubmitRun
from labos.core.decide.users import AddUser, DisableUser, GrantRole
from labos.core.ids import ModuleName, RunId, StationName
from labos.core.users import Role, on_behalf
from tests.support.bench import Driver, full, route, small
from tests.unit.core.test_users import make_staffed


def make_peopled() -> Driver:
    """ada and bo submit, olga operates the workcell, vic looks on, robot is a service account."""
    lab = make_staffed("ada", "bo", "olga", "vic")
    lab.do(AddUser("robot", "service"))
    people: dict[str, Role] = {"ada": "submitter", "bo": "submitter", "vic": "viewer", "robot": "submitter"}
    for name, role in people.items():
        lab.do(GrantRole(f"user:{name}", role))
    lab.do(GrantRole("user:olga", "operator", "cell"))
    lab.stock("stack", 3)
    return lab


def submit(user: str) -> SubmitRun:
    return SubmitRun(route("stack", "a"), user)


def test_each_command_stands_in_the_table_once() -> None:
    assert set(RIGHTS) == set(DECIDERS)


def test_whoever_asks_is_named_by_a_field_that_there_is() -> None:
    for command, right in RIGHTS.items():
        assert not right.asker or right.asker in command.__struct_fields__, command
        assert right.asker == "by" or "by" not in command.__struct_fields__ or right.role in (None, "viewer")


def test_a_lab_without_users_is_open() -> None:
    lab = small()
    lab.stock("stack", 1)
    lab.do(submit("ada"), "whoever")
    lab.do(PauseRun(RunId("R1")), "somebody else")


def test_strangers_and_disabled_users_may_nothing() -> None:
    lab = make_peopled()
    assert lab.reject(submit("eve"), "eve").code == "unknown_user"
    lab.do(DisableUser("ada"))
    found = lab.reject(submit("ada"), "ada")
    assert isinstance(found, Denied)
    assert found.code == "disabled"
    assert "root-1" in found.remedy


def test_viewers_may_nothing_and_are_told_who_may() -> None:
    found = make_peopled().reject(submit("vic"), "vic")
    assert found.code == "no_right"
    assert "ada, bo, olga, root-1" in found.remedy


def test_runs_are_touched_by_their_owner_and_by_operators() -> None:
    lab = make_peopled()
    lab.do(submit("ada"), "ada")
    run = RunId("R1")
    found = lab.reject(PauseRun(run), "bo")
    assert (found.code, found.message) == ("not_yours", "The run R1 is ada's; bo is no operator in cell.")
    assert "ada" in found.remedy
    assert "olga" in found.remedy
    lab.do(PauseRun(run), "ada")
    lab.do(CancelRun(run), "olga")


def test_roles_count_where_they_were_granted() -> None:
    lab = make_peopled()
    lab.do(GrantRole("user:olga", "viewer", "cell"))
    taken = TakeOut(ModuleName(full("arm")), "new belt", 0, lab.now)
    assert lab.reject(taken, "olga").code == "no_right"
    lab.do(GrantRole("user:olga", "operator"))
    lab.do(taken, "olga")


def test_nobody_asks_in_the_name_of_another() -> None:
    lab = make_peopled()
    assert lab.reject(submit("ada"), "bo").code == "not_you"
    assert lab.reject(submit("ada"), "root-1").code == "not_you"


def test_a_service_account_acts_for_a_person_with_the_rights_of_both() -> None:
    lab = make_peopled()
    lab.do(submit("ada"), on_behalf("robot", "ada"))
    assert lab.state.runs.queued[RunId("R1")].user == "ada"
    assert lab.reject(submit("ada"), on_behalf("bo", "ada")).code == "no_service"
    assert lab.reject(submit("vic"), on_behalf("robot", "vic")).code == "no_right"
    declared = DeclareStation(StationName(full("b")), ("plate",))
    assert lab.reject(declared, on_behalf("robot", "olga")).code == "no_right"
    lab.do(GrantRole("user:robot", "operator"))
    lab.do(declared, on_behalf("robot", "olga"))
    assert lab.reject(submit("eve"), on_behalf("robot", "eve")).code == "unknown_user"


@pytest.mark.parametrize("command", [c for c, right in RIGHTS.items() if right.role is None])
def test_what_labos_asks_of_itself_is_nobody_elses(command: type[Command]) -> None:
    lab = make_peopled()
    asked = command(*([None] * len(command.__struct_fields__)))
    assert lab.reject(asked, "root-1").code == "inside"

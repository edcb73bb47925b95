"""Users, groups and roles as events of the log."""

from __future__ import annotations

import pytest

from labos.core.decide.rights import check_rights
from labos.core.decide.shares import ApplyShares
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
from labos.core.shares import Group, Member
from tests.support.bench import Driver, small


def make_staffed(*users: str) -> Driver:
    """A lab whose admin is ``root-1``, with further users."""
    lab = small()
    for name in ("root-1", *users):
        lab.do(AddUser(name))
    return lab


def roles(lab: Driver, subject: str) -> dict[str, str]:
    return dict(lab.state.users.roles.get(subject, {}))


def test_the_first_user_is_admin_and_must_be_a_person() -> None:
    lab = small()
    assert lab.state.users.is_open
    assert lab.reject(AddUser("robot", "service")).code == "first_user"
    lab.do(AddUser("ada"))
    assert roles(lab, "user:ada") == {"*": "admin"}
    lab.do(AddUser("bo"))
    lab.do(AddUser("robot", "service"))
    assert roles(lab, "user:bo") == {}
    assert (lab.state.users.known["robot"].kind, lab.state.users.is_open) == ("service", False)
    lab.check_log()


@pytest.mark.parametrize("name", ["", "labos", "Somebody", "a/b", "a:b", "a b", "a@b.org", "-a", "x" * 65])
def test_ids_that_would_read_as_somebody_else_are_refused(name: str) -> None:
    assert make_staffed().reject(AddUser(name)).code == "bad_id"
    assert make_staffed().reject(AddGroup(name)).code == "bad_id"


def test_an_erasure_is_noted_by_the_user_or_an_admin() -> None:
    lab = make_staffed("ada", "bo")
    for by, user in (("ada", "ada"), ("root-1", "bo"), ("labos", "bo")):
        assert check_rights(lab.state, EraseUser(user, by), by) is None
    for by, actor in (("ada", "ada"), ("bo", "ada")):
        assert check_rights(lab.state, EraseUser("bo", by), actor) is not None
    before = dict(lab.state.users.known)
    lab.do(EraseUser("bo", "root-1"))
    assert lab.state.users.known == before, "the log speaks of them"
    assert lab.reject(EraseUser("eve", "root-1")).code == lab.reject(DisableUser("eve")).code
    lab.check_log()


def test_ids_that_differ_in_case_only_are_one() -> None:
    assert make_staffed("Ada").reject(AddUser("ada")).code == "known"


def test_one_admin_stays() -> None:
    lab = make_staffed("ada")
    for command in (
        DisableUser("root-1"),
        RevokeRole("user:root-1"),
        GrantRole("user:root-1", "viewer"),
    ):
        assert lab.reject(command).code == "last_admin"
    lab.do(GrantRole("user:ada", "admin"))
    lab.do(DisableUser("root-1"))
    assert lab.reject(DisableUser("ada")).code == "last_admin"
    lab.do(EnableUser("root-1"))
    lab.do(RevokeRole("user:ada"))
    lab.check_log()


def test_roles_are_by_workcell_and_replace_each_other() -> None:
    lab = make_staffed("ada")
    lab.do(GrantRole("user:ada", "operator", "cell"))
    lab.do(GrantRole("user:ada", "viewer"))
    lab.do(GrantRole("user:ada", "submitter"))
    assert lab.do(GrantRole("user:ada", "submitter")) == []
    assert roles(lab, "user:ada") == {"cell": "operator", "*": "submitter"}
    lab.do(RevokeRole("user:ada", "cell"))
    assert lab.do(RevokeRole("user:ada", "cell")) == []
    assert roles(lab, "user:ada") == {"*": "submitter"}
    assert lab.reject(GrantRole("user:ada", "viewer", "mars")).code == "no_workcell"
    assert lab.reject(GrantRole("user:eve", "viewer")).code == "no_user"
    assert lab.reject(GrantRole("ada", "viewer")).code == "no_subject"
    lab.check_log()


def test_a_group_of_the_shares_file_is_the_group_that_has_roles() -> None:
    lab = make_staffed("ada", "bo")
    lab.do(ApplyShares("d1", (Group("chemistry", 2.0, {"ada": Member(3.0)}),)))
    lab.do(GrantRole("group:chemistry", "operator", "cell"))
    lab.do(AddMember("chemistry", "bo"))
    shares = lab.state.shares
    assert shares.group_of == {"ada": "chemistry", "bo": "chemistry"}
    assert (shares.groups["chemistry"].weight, shares.find_member("ada").weight) == (2.0, 3.0)
    assert lab.state.users.rank_role("bo", "chemistry", "cell") == 2
    assert lab.state.users.rank_role("bo", "chemistry", "*") == 0
    lab.do(RemoveMember("chemistry", "ada"))
    assert shares.group_of == {"bo": "chemistry"}
    lab.check_log()


def test_nobody_is_in_two_groups() -> None:
    lab = make_staffed("ada")
    lab.do(AddGroup("chemistry"))
    lab.do(AddGroup("physics"))
    lab.do(AddMember("chemistry", "ada"))
    assert lab.reject(AddMember("physics", "ada")).code == "two_groups"
    file = ApplyShares("d1", (Group("physics", members={"ada": Member()}),))
    assert lab.reject(file).code == "two_groups"
    assert lab.reject(AddMember("physics", "eve")).code == "no_user"
    assert lab.reject(AddMember("biology", "ada")).code == "no_group"


def test_a_shares_file_leaves_groups_that_were_added_and_says_all_of_those_that_it_names() -> None:
    lab = make_staffed("ada", "bo")
    lab.do(AddGroup("chemistry"))
    lab.do(AddMember("chemistry", "ada"))
    lab.do(ApplyShares("d1", (Group("physics", members={"bo": Member()}),), {"ada": Member(4.0)}))
    shares = lab.state.shares
    assert list(shares.groups) == ["chemistry", "physics"]
    assert (shares.group_of, shares.find_member("ada").weight) == ({"ada": "chemistry", "bo": "physics"}, 4.0)
    lab.do(ApplyShares("d2"))
    assert list(shares.groups) == ["chemistry"]
    lab.do(ApplyShares("d3", (Group("chemistry", 5.0),)))
    assert (shares.groups["chemistry"].weight, shares.group_of) == (5.0, {})
    assert lab.do(ApplyShares("d3", (Group("chemistry", 5.0),))) == []
    lab.check_log()


def test_a_group_that_is_removed_takes_its_roles_along() -> None:
    lab = make_staffed("ada")
    lab.do(AddGroup("chemistry"))
    lab.do(AddMember("chemistry", "ada"))
    lab.do(GrantRole("group:chemistry", "admin"))
    lab.do(RemoveGroup("chemistry"))
    assert roles(lab, "group:chemistry") == {}
    assert (lab.state.shares.group_of, lab.state.shares.groups) == ({}, {})
    lab.do(AddGroup("chemistry"))
    assert lab.state.users.rank_role("ada", "", "*") == 0
    lab.check_log()

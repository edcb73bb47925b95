"""Poses have versions, and the first move to a new one is slow where the driver can be slow."""

from __future__ import annotations

from labos.core.decide.teach import TeachLocation
from labos.core.ids import ModuleName, StationName
from labos.core.modules import LocationTaught
from tests.support.bench import Driver, full, move, plan, small, step, take


def teach(*pose: float) -> TeachLocation:
    return TeachLocation(ModuleName(full("arm")), StationName(full("a")), pose, "ada", "moved")


def moved_there(lab: Driver, **args: object) -> dict[str, object]:
    """The arguments with which a plate is brought to the station."""
    run = lab.submit(plan(step("arm", take("stack", "a"), args=args), step("arm", move("a", "trash"))))
    action = lab.start(run)
    told = dict(lab.state.actions.open[action].args)
    lab.finish(action)
    lab.step(run, 1)
    return told


def test_each_pose_is_a_version() -> None:
    lab = small()
    assert [e.version for e in lab.do(teach(1, 2)) if isinstance(e, LocationTaught)] == [1]
    assert lab.do(teach(1, 2)) == []
    assert [e.version for e in lab.do(teach(1, 3)) if isinstance(e, LocationTaught)] == [2]
    assert lab.refused(teach(1, 2, 3)).code == "bad_pose"
    assert lab.refused(teach()).code == "bad_pose"
    lab.check_log()


def test_the_first_move_is_slow_where_the_driver_can_be() -> None:
    lab = small()
    assert moved_there(lab, slow=False) == {"slow": False}
    lab.do(teach(1, 2))
    assert moved_there(lab) == {}
    assert moved_there(lab, slow=False) == {"slow": True}
    assert moved_there(lab, slow=False) == {"slow": False}
    lab.check_log()


def test_poses_are_not_changed_under_a_moving_arm() -> None:
    lab = small()
    lab.start(lab.submit(plan(step("arm", take("stack", "a")))))
    assert lab.refused(teach(1, 2)).code == "module_in_use"

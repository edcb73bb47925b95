"""Calibrations: the last one of each kind is in the state; who may record one; nothing waits for them."""

from __future__ import annotations

import pytest

from labos.core.calibrations import MOST_CALIBRATIONS, Calibration, find_first_expiry
from labos.core.decide.calibrations import CalibrateModule
from labos.core.ids import ModuleName
from labos.core.modules import ModuleCalibrated
from labos.core.words import find_fields_of_words
from tests.support.bench import Driver, full, move, plan, small, step, take

ARM = ModuleName(full("arm"))
DAY_NS = 86_400 * 10**9
NEW_YEAR_NS = 1_798_761_600 * 10**9
"""2027-01-01T00:00:00Z."""


def calibrate(what: str = "", until: str = "", **told: str) -> CalibrateModule:
    return CalibrateModule(ARM, "ada", what, until=until, **told)


def find_calibrations(lab: Driver) -> dict[str, Calibration]:
    return lab.state.modules.by_name[ARM].calibrations


def test_the_last_one_of_each_kind_counts() -> None:
    lab = small()
    lab.do(calibrate("force", "2027-01-01", certificate="K-1"))
    lab.do(calibrate("reach", "2027-02-01"))
    recorded = lab.do(calibrate("force", "2027-03-01", certificate="K-2", file="d" * 64, why="a wrong date"))
    told = ("ada", "force", "K-2", "d" * 64, "2027-03-01", "a wrong date")
    assert recorded == [ModuleCalibrated(ARM, *told)]
    assert {name: (one.certificate, one.until) for name, one in find_calibrations(lab).items()} == {
        "force": ("K-2", "2027-03-01"),
        "reach": ("", "2027-02-01"),
    }
    assert find_first_expiry(find_calibrations(lab)) == "2027-02-01"
    lab.check_log()


def test_the_same_once_more_is_another_calibration() -> None:
    lab = small()
    assert len(lab.do(calibrate())) == len(lab.do(calibrate())) == 1


@pytest.mark.parametrize("until", ["2027-02-30", "01.01.2027", "20270101", "2027-W01-1", "tomorrow"])
def test_a_day_is_a_day_of_the_calendar(until: str) -> None:
    refusal = small().reject(calibrate(until=until))
    assert (refusal.code, refusal.remedy) == ("bad_date", "Write it like 2027-05-31.")


def test_there_is_no_such_module() -> None:
    assert small().reject(CalibrateModule(ModuleName(full("nix")), "ada")).code == "no_module"


def test_the_state_does_not_grow_without_end() -> None:
    lab = small()
    for number in range(MOST_CALIBRATIONS):
        lab.do(calibrate(f"axis {number}"))
    assert lab.reject(calibrate("one more")).code == "too_many"
    assert lab.do(calibrate("axis 7"))


def test_the_last_day_is_a_whole_day() -> None:
    calibration = Calibration(0, "ada", until="2027-01-01")
    assert not calibration.has_expired(NEW_YEAR_NS + DAY_NS - 1)
    assert calibration.has_expired(NEW_YEAR_NS + DAY_NS)
    assert not calibration.expires_soon(NEW_YEAR_NS - 14 * DAY_NS - 1)
    assert calibration.expires_soon(NEW_YEAR_NS - 14 * DAY_NS)
    assert calibration.expires_soon(NEW_YEAR_NS + 5 * DAY_NS)
    assert not Calibration(0, "ada").expires_soon(NEW_YEAR_NS)


def test_an_action_starts_whatever_has_expired() -> None:
    lab = small()
    lab.do(calibrate("force", "1999-12-31"))
    run = lab.submit(plan(step("arm", take("stack", "a")), step("arm", move("a", "trash"))))
    lab.finish(lab.start(run))
    lab.check_log()


def test_a_reason_can_be_erased_and_a_certificate_cannot() -> None:
    assert find_fields_of_words(ModuleCalibrated) == find_fields_of_words(CalibrateModule) == ("why",)

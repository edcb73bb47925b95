"""Barcodes: what a reading says, and what is asked when it contradicts the log."""

from __future__ import annotations

import pytest

from labos.core.decide.barcodes import find_barcode
from labos.core.decide.interventions import ResolveIntervention
from labos.core.decide.lab import DeclareStation
from labos.core.decide.labware import NameBarcode
from labos.core.effects import Reads
from labos.core.ids import LabwareId, RunId, StationName
from labos.core.interventions import Intervention
from labos.core.labware import BarcodeRead
from tests.support.bench import Driver, full, module, move, needs, plan, station, step, workcell

READ = step("eye", needs("eye.nest"), Reads(), key="read")
CARRY = step("arm", move("eye.nest", "hotel"), key="carry")
P1, P2 = LabwareId("P1"), LabwareId("P2")


def lab() -> Driver:
    """P1 stands under a reader, P2 elsewhere; two arms, so that others can go on."""
    made = Driver(
        workcell(
            [module("eye"), module("arm"), module("arm2")],
            [
                station("eye.nest"),
                station("far"),
                station("hotel", "hotel", 4),
                station("arm.gripper", "gripper"),
            ],
        )
    )
    for place in ("eye.nest", "far"):
        made.do(DeclareStation(StationName(full(place)), ("plate",)))
    return made


def codes(driver: Driver) -> dict[str, str]:
    return {name: item.barcode for name, item in driver.state.bench.labware.items()}


def name(driver: Driver, labware: LabwareId, code: str) -> None:
    driver.do(NameBarcode(labware, code, "ada"))


def read(driver: Driver, code: str, *, then: bool = True) -> tuple[RunId, Intervention | None]:
    """A run whose first step reads ``code`` from what stands in P1's place."""
    run = driver.submit(plan(READ, CARRY) if then else plan(READ))
    driver.step(run, 0, {"barcode": code})
    questions = driver.questions("barcode")
    return run, questions[0] if questions else None


@pytest.mark.parametrize(
    ("result", "code"),
    [
        ({"barcode": " LB01 "}, "LB01"),
        ("LB01", "LB01"),
        ({"barcode": ""}, ""),
        ({"barcode": None}, ""),
        ({"code": "LB01"}, ""),
        (17, ""),
        ("a\nb", ""),
        ("x" * 129, ""),
        (None, ""),
    ],
)
def test_where_a_result_holds_the_barcode(result: object, code: str) -> None:
    assert find_barcode(result) == code


def test_the_first_reading_names_and_later_ones_agree() -> None:
    driver = lab()
    run, question = read(driver, "LB1")
    assert question is None
    assert codes(driver) == {"P1": "LB1", "P2": ""}
    assert driver.state.bench.barcodes == {"LB1": "P1"}
    driver.step(run, 1)
    _, question = lab_again(driver, "LB1")
    assert question is None
    driver.check_log()


def lab_again(driver: Driver, code: str) -> tuple[RunId, Intervention | None]:
    """P1 comes back under the reader, and is read once more."""
    back = plan(step("arm", move("hotel", "eye.nest"), key="back"), READ)
    run = driver.submit(back)
    driver.step(run, 0)
    driver.step(run, 1, code)
    questions = driver.questions("barcode")
    return run, questions[0] if questions else None


def test_nothing_legible_is_no_reading() -> None:
    driver = lab()
    name(driver, P1, "LB1")
    run, question = read(driver, "")
    assert question is None
    assert driver.code(run, 1) == ""


def test_a_strange_barcode_holds_the_plate_and_nothing_else() -> None:
    driver = lab()
    name(driver, P1, "LB1")
    run, question = read(driver, "LB9")
    assert question is not None
    assert "read the barcode LB9 at eye.nest, where P1 should stand. P1 bears LB1." in question.text
    assert [c.name for c in question.choices] == ["misread", "relabelled", "gone"]
    assert driver.code(run, 1) == "uncertain"
    other = driver.submit(plan(step("arm2", move("far", "hotel"))))
    driver.step(other)
    assert driver.where("P2") == "hotel"
    driver.check_log()


@pytest.mark.parametrize(
    ("choice", "here", "barcode"),
    [("misread", ["P1"], "LB1"), ("relabelled", ["P1"], "LB9"), ("gone", [], None)],
)
def test_answers_about_a_strange_barcode(choice: str, here: list[str], barcode: str | None) -> None:
    driver = lab()
    name(driver, P1, "LB1")
    run, question = read(driver, "LB9")
    assert question is not None
    driver.answer(question, choice)
    assert driver.at("eye.nest") == here
    assert codes(driver).get("P1") == barcode
    assert driver.code(run, 1) == ("" if here else "nothing_there")
    driver.check_log()


def test_the_barcode_of_another_plate_holds_both() -> None:
    driver = lab()
    name(driver, P2, "LB2")
    run, question = read(driver, "LB2")
    assert question is not None
    assert "LB2 is the barcode of P2, recorded at far." in question.text
    assert [c.name for c in question.choices] == ["misread", "relabelled", "swapped", "other", "gone"]
    other = driver.submit(plan(step("arm2", move("far", "hotel"))))
    assert driver.code(run, 1) == driver.code(other) == "uncertain"
    driver.check_log()


@pytest.mark.parametrize(
    ("choice", "here", "far", "barcodes"),
    [
        ("misread", ["P1"], ["P2"], {"P1": "", "P2": "LB2"}),
        ("relabelled", ["P1"], ["P2"], {"P1": "LB2", "P2": ""}),
        ("swapped", ["P2"], ["P1"], {"P1": "", "P2": "LB2"}),
        ("other", ["P2"], [], {"P2": "LB2"}),
        ("gone", [], ["P2"], {"P2": "LB2"}),
    ],
)
def test_answers_about_another_plates_barcode(
    choice: str, here: list[str], far: list[str], barcodes: dict[str, str]
) -> None:
    driver = lab()
    name(driver, P2, "LB2")
    run, question = read(driver, "LB2")
    assert question is not None
    driver.answer(question, choice)
    assert (driver.at("eye.nest"), driver.at("far")) == (here, far)
    # It must not go on with a plate that is not its own, though it might.
    assert driver.run(run).paused == (choice in ("swapped", "other"))
    assert codes(driver) == barcodes
    assert driver.state.bench.uncertain_at == {}
    driver.check_log()


def test_a_plate_in_motion_is_left_alone() -> None:
    driver = lab()
    name(driver, P2, "LB2")
    flying = driver.start(driver.submit(plan(step("arm2", move("far", "hotel")))))
    _, question = read(driver, "LB2")
    assert question is not None
    assert [c.name for c in question.choices] == ["misread", "relabelled", "gone"]
    driver.finish(flying)
    driver.answer(question, "misread")
    assert driver.where("P2") == "hotel"
    assert driver.at("eye.nest") == ["P1"]
    driver.check_log()


def test_a_run_that_ends_by_the_reading_gives_the_plate_back() -> None:
    driver = lab()
    name(driver, P2, "LB2")
    run, question = read(driver, "LB2", then=False)
    assert driver.state.runs.get(run) is None
    assert question is not None
    driver.answer(question, "swapped")
    assert driver.owner("P1") == "shared"
    driver.check_log()


def test_a_barcode_is_free_again_when_its_labware_is_gone() -> None:
    driver = lab()
    name(driver, P1, "LB1")
    _, question = read(driver, "LB9")
    assert question is not None
    driver.answer(question, "gone")
    name(driver, P2, "LB1")
    assert driver.state.bench.barcodes == {"LB1": "P2"}
    driver.check_log()


def test_what_a_person_says_of_a_barcode() -> None:
    driver = lab()
    assert driver.do(NameBarcode(P1, " LB1 ", "ada")) == [BarcodeRead(P1, "", "LB1", "ada")]
    assert driver.do(NameBarcode(P1, "LB1", "ada")) == []
    assert driver.reject(NameBarcode(P2, "LB1", "ada")).code == "barcode_taken"
    assert driver.reject(NameBarcode(P1, "LB2", "ada")).code == "barcode_known"
    assert driver.reject(NameBarcode(P1, "", "ada")).code == "bad_barcode"
    assert driver.reject(NameBarcode(LabwareId("P9"), "LB9", "ada")).code == "no_labware"
    driver.do(NameBarcode(P1, "LB2", "ada", replace=True))
    assert driver.state.bench.barcodes == {"LB2": "P1"}


def test_a_person_says_what_was_read() -> None:
    driver = lab()
    action = driver.start(driver.submit(plan(READ, CARRY)))
    driver.doubt(action)
    question = driver.question("unknown_action")
    driver.do(ResolveIntervention(question.id, "done", "person-1", result={"barcode": "LB1"}))
    assert codes(driver)["P1"] == "LB1"
    driver.check_log()

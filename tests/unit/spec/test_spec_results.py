"""A result of one kind is not given to an argument of another."""

from __future__ import annotations

from pathlib import Path

import pytest

from labos.bootstrap import descriptions
from labos.spec import Finding, find_spec, load_workcell, parse_workflow, validate_workflow

TAKE = "  - {name: take, module: peeler, action: sealcheck}\n"


def errors(steps: str) -> list[Finding]:
    known = descriptions()
    cell = load_workcell(Path(find_spec("workcells", "rpl")), known)
    text = f"labos: 1\nname: w\nsteps:\n{steps}"
    found = validate_workflow(parse_workflow(text), {}, cell.workcell, known, simulate=True)
    return [finding for finding in found if finding.severity == "error" and "result of" in finding.message]


def test_a_file_name_is_no_time() -> None:
    (found,) = errors(TAKE + "  - {name: s, module: sealer, action: seal, args: {time: steps.take.result}}\n")
    assert found.message == (
        "Step 's': the result of 'take' (sealcheck) is text, and the argument takes a number."
    )
    assert (found.line, found.field) == (5, "steps[1].args.time")


def test_text_has_no_fields() -> None:
    again = (
        "  - {name: b, module: camera_module, action: take_picture, args: {file_name: steps.take.result.x}}\n"
    )
    (found,) = errors(TAKE + again)
    assert "is text, and has no fields" in found.message


@pytest.mark.parametrize("reference", ["steps.take.result"])
def test_what_fits_may_be_given(reference: str) -> None:
    again = (
        f"  - {{name: b, module: camera_module, action: take_picture, args: {{file_name: {reference}}}}}\n"
    )
    assert not errors(TAKE + again)

"""Sample sheets: what is read, and where faults are said to be."""

from __future__ import annotations

import pytest

from labos.core.labware import Sample
from labos.core.wells import normalise_well, parse_well
from labos.spec.findings import FindingList
from labos.spec.labware import load_packaged_labware
from labos.spec.sheet import COLUMNS, SheetLine, check_wells, read_sheet
from tests.docs.markdown import REFERENCE, blocks, first_codes, section

PLATE = load_packaged_labware()["plate96"].wells


def lines(text: str) -> list[SheetLine]:
    report = FindingList("sheet.csv")
    found = read_sheet(text, report)
    assert report.findings == []
    return found


def faults(text: str) -> list[str]:
    report = FindingList("sheet.csv")
    check_wells(read_sheet(text, report), "plate96", PLATE, report)
    return [str(finding.as_error()) for finding in report.sort_findings()]


@pytest.mark.parametrize(
    "text",
    [
        "plate,well,sample,volume,unit\nP7,A1,s-1,0.05,mL\nP7,b02,water,,\n",
        "\ufeffsample;well;Plate;volume;unit\r\ns-1;A01;P7;0,05;ml\r\nwater; B2 ;P7;;uL\r\n",
        'plate\twell\tsample\tvolume\nP7\tA1\t"s-1"\t50\n\n\nP7\tB2\twater\t\n',
    ],
)
def test_a_sheet_is_read_however_it_is_written(text: str) -> None:
    first, second = lines(text)
    assert (first.plate, first.sample) == ("P7", Sample("A1", "s-1", 50.0))
    assert second.sample == Sample("B2", "water", None)


def test_quotes() -> None:
    (line,) = lines('well,sample\nA1,"a ""b"", c"\n')
    assert line.sample.sample == 'a "b", c'


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("well,sampel\nA1,x\n", "sheet.csv:1:6: The column 'sampel' is not known. Did you mean 'sample'?"),
        ("well\nA1\n", "sheet.csv:1:1: The column 'sample' is missing."),
        ("well,sample,well\nA1,x,A1\n", "sheet.csv:1:13: The column 'well' is there twice."),
        (
            "well,sample\nA1,x\nB1,y\na01,z\n",
            "sheet.csv:4:1: well: The well A1 is listed twice; the first is in line 2.",
        ),
        (
            "well,sample\nI1,x\n",
            "sheet.csv:2:1: well: There is no well I1 on a plate96. Its wells are A1 to H12.",
        ),
        ("sample,well\nx,H13\n", "sheet.csv:2:3: well: There is no well H13 on a plate96."),
        ("well,sample\n12,x\n", "sheet.csv:2:1: well: '12' is not a well. Write A1, B12 …"),
        ("well,sample\nA1,\n", "sheet.csv:2:4: sample: The sample is missing."),
        ("well,sample,volume\nA1,x,-3\n", "sheet.csv:2:6: volume: '-3' is not a volume."),
        ("well,sample,volume\nA1,x,400\n", "sheet.csv:2:1: volume: A1 cannot hold 400 µL."),
        ("well,sample,volume,unit\nA1,x,3,gal\n", "sheet.csv:2:8: unit: The unit 'gal' is not known."),
        ("well,sample,unit\nA1,x,uL\n", "sheet.csv:1:1: There is a unit, but no volume."),
        ("well,sample\nA1,x,y\n", "sheet.csv:2:1: This row has 3 columns, the first one 2."),
        ('well,sample\nA1,"x\n', "sheet.csv:2:4: A quote is not closed."),
        ("\n \n", "sheet.csv:1:1: The sheet is empty."),
    ],
)
def test_faults_are_found_where_they_are(text: str, told: str) -> None:
    found = faults(text)
    assert any(fault.startswith(told) for fault in found), found


def test_one_well_of_two_plates_is_no_fault() -> None:
    assert len(lines("plate,well,sample\nP1,A1,x\nP2,A1,x\n")) == 2


def test_wells_of_large_plates() -> None:
    assert normalise_well("af48") == "AF48"
    assert parse_well("AF48") == (31, 47)
    assert parse_well("A1") == (0, 0)
    with pytest.raises(ValueError, match="not a well"):
        normalise_well("A0")


def test_what_has_no_wells() -> None:
    report = FindingList("sheet.csv")
    check_wells(read_sheet("well,sample\nA1,x\n", report), "lid", None, report)
    assert report.errors == 1


def test_the_reference_is_right() -> None:
    page = (REFERENCE / "samples.md").read_text()
    (example,) = (block for block in blocks(page) if block.language == "csv")
    assert [line.sample.volume_ul for line in lines(example.text)] == [50, 50]
    assert first_codes(section(page, "The sample sheet")) == list(COLUMNS)

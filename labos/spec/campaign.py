"""Campaign files: a workflow, the table with the values of its runs, and the terms."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec
from pydantic import BeforeValidator, Field

from labos.core.campaigns import Budget, Terms
from labos.core.conditions import fill_in, make_condition
from labos.core.expressions import ExpressionError, list_names, parse_expression
from labos.core.model import Condition
from labos.core.viewer import Visibility
from labos.errors import SpecError
from labos.spec.findings import FindingList, Remarks
from labos.spec.parts import Label, Part, Seconds, Version
from labos.spec.rows import TableLine, expand
from labos.spec.source import Source, parse
from labos.spec.validation import expect_valid

MOST_ROWS = 100_000


class Span(Part):
    """A range of numbers from which a Latin hypercube takes values; with ``whole``, only whole numbers."""

    from_: float = Field(alias="from")
    """the least value"""
    to: float
    """the greatest value"""
    whole: bool = False
    """whole numbers only"""


class LatinHypercube(Part):
    """Rows that fill a space of parameters evenly: each parameter's span is divided into as many slices as
    there are rows, and each slice is used once. The same seed gives the same rows."""

    samples: int = Field(ge=1, le=MOST_ROWS)
    """how many rows"""
    seed: int
    """the same seed gives the same rows"""
    spans: dict[Label, Span] = Field(min_length=1)
    """keys, and the spans of their values"""


Values = Annotated[list[Any], Field(min_length=1)]


class RowsEntry(Part):
    """The source of the rows: exactly one of these. Keys may refer to nested tables: ``seal.time``."""

    table: str = ""
    """a CSV, YAML or JSON file beside this one; the columns are keys of the payload"""
    list_: list[dict[str, Any]] = Field(default=[], alias="list")
    """the rows themselves"""
    grid: dict[Label, Values] = {}
    """keys and their values: all combinations"""
    zip_: dict[Label, Values] = Field(default={}, alias="zip")
    """keys and their values: the first with the first, and so on"""
    latin_hypercube: LatinHypercube | None = None
    """rows that fill a space evenly"""


class BudgetEntry(Part):
    """The most that the campaign may use: runs, module time, and consumables by kind in their own units."""

    runs: int = Field(default=0, ge=0)
    """the largest number of runs; 0 for no limit"""
    lab_time: Seconds = Field(default=0.0, ge=0)
    """module time: seconds, or text as ``20 h``; 0 for no limit"""
    consumables: dict[Label, Annotated[float, Field(ge=0, strict=False)]] = {}
    """amounts by kind, in the unit of each"""


class StopAfter(Part):
    """After this number of failed rows, no further row is submitted."""

    stop_after: int = Field(ge=1)
    """the number of failed rows after which no further row is submitted"""


def _show_time(value: Any) -> Any:
    return str(value) if value is not None else ""


class CampaignFile(Part):
    """A campaign file. Each row's values are added to ``payload``."""

    labos: Version
    campaign: Label
    """the campaign's name"""
    workflow: str = Field(min_length=1)
    """a workflow file beside this one, or a packaged workflow"""
    workcell: str = ""
    """the workcell, if the lab has several"""
    payload: dict[str, Any] = {}
    """values that all rows have"""
    rows: RowsEntry
    """the source of the rows; each row is one run"""
    priority: int = Field(default=0, ge=-100_000, le=100_000)
    """higher goes first"""
    deadline: Annotated[str, BeforeValidator(_show_time)] = ""
    """the time by which it should end: 2026-05-04T10:30, in the lab's time unless it names a zone, or 12h
    from now; its runs go first when time is short"""
    due: str = ""
    """the key with the due date of a row's run: 2026-05-04T10:30, in the lab's time"""
    budget: BudgetEntry = BudgetEntry()
    """the most that it may use"""
    tags: list[Label] = []
    """keywords for finding it"""
    until: str = ""
    """no further row is submitted after this is true for a run: steps.Read.result.od > 0.5"""
    on_failure: Literal["go_on", "stop"] | StopAfter = "go_on"
    """go_on, stop at the first failure, or stop_after a number of failures"""
    visibility: Visibility = "lab"
    """who sees it besides operators: lab (all), group (its user's), private (only its user)"""


class CampaignSource(msgspec.Struct, frozen=True):
    """A campaign as in its file. ``lines`` are its rows; ``terms`` are its terms without the deadline."""

    file: CampaignFile
    source: Source
    lines: list[TableLine]
    terms: Terms


def parse_campaign(text: str, name: str = "", files: Mapping[str, bytes] | None = None) -> CampaignSource:
    """Read a campaign given as text; ``files`` holds the table that it names. Raises SpecError, SpecErrors
    with all faults of file and table."""
    source = parse(text, name)
    report = FindingList(name)
    remarks = Remarks(source, report)
    file = expect_valid(CampaignFile, source, report)
    terms = Terms(
        priority=file.priority,
        budget=Budget(file.budget.runs, file.budget.lab_time, dict(file.budget.consumables)),
        tags=tuple(file.tags),
        until=_read_stop_rule(file.until, remarks),
        stop_after={"go_on": 0, "stop": 1}[file.on_failure]
        if isinstance(file.on_failure, str)
        else file.on_failure.stop_after,
    )
    lines = expand(file, remarks, files or {})
    if not lines and not report.errors:
        remarks.error("The campaign has no rows.", ("rows",), "Add one.")
    report.raise_if_failed()
    return CampaignSource(file, source, lines, terms)


def find_table_of_campaign(text: str) -> str:
    """The name of the file with a campaign's table; empty if there is none, or if the text cannot be read."""
    try:
        rows = parse(text).data.get("rows")
    except SpecError:
        return ""
    table = rows.get("table") if isinstance(rows, Mapping) else ""
    return table if isinstance(table, str) else ""


def find_workflow_of_campaign(text: str) -> str:
    """The workflow that a campaign's text names. Raises SpecError."""
    source = parse(text)
    workflow = source.data.get("workflow")
    if not isinstance(workflow, str) or not workflow:
        raise source.error("The key 'workflow' is missing.", remedy="Add `workflow:`.")
    return workflow


def find_beside(campaign: str | Path, name: str) -> Path:
    """The path of a file that a campaign file names."""
    return Path(campaign).parent / name


def stop_rule(text: str) -> Condition:
    """A condition on the results of a run's steps. Raises ExpressionError."""
    tree = parse_expression(text)
    values = {}
    for found in list_names(tree):
        if len(found) < 3 or found[0] != "steps" or found[2] != "result":
            raise ExpressionError(
                f"{'.'.join(map(str, found))!r} is not a result of a step.",
                remedy='Write `steps.Read.result.od`, or `steps["Read it"].result.od`.',
            )
        values[found] = ("name", (found[0], found[1], *found[3:]))
    if not values:
        raise ExpressionError(
            f"{text!r} uses no result.", remedy="Name a step's result: `steps.Read.result.od > 0.5`."
        )
    return make_condition(text, fill_in(tree, values))


def _read_stop_rule(text: str, remarks: Remarks) -> Condition | None:
    if not text:
        return None
    try:
        return stop_rule(text)
    except ExpressionError as error:
        remarks.error(error.message, ("until",), error.remedy)
        return None

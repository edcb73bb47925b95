"""The search index: finds entries by words."""

from __future__ import annotations

from typing import Annotated

import msgspec

from labos.audit.find import MOST_FOUND, SearchQuery, SearchResult
from labos.core.structs import make_from
from labos.errors import Refused
from labos.http.limits import Line, Time, says
from labos.http.operation import Call, Method, read
from labos.http.queries import Several


class FindQuery(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    words: Annotated[
        Line,
        says("words that an entry must all contain (`colo*`: words with this beginning); empty: everything"),
    ] = ""
    kind: Annotated[
        Several,
        says("experiment, run, sample, image, file, result or publication; may be repeated"),
    ] = []
    user: Annotated[Several, says("the owner, by id; may be repeated")] = []
    workcell: Annotated[Several, says("the workcell; may be repeated")] = []
    workflow: Annotated[Several, says("a workflow's or application's name; may be repeated")] = []
    experiment: Annotated[Several, says("the experiment that it belongs to; may be repeated")] = []
    run: Annotated[Several, says("the run that it belongs to; may be repeated")] = []
    status: Annotated[Several, says("the status of runs and experiments; may be repeated")] = []
    keyword: Annotated[
        Several, says("a keyword of a publication, or the quantity of a result; may be repeated")
    ] = []
    since: Annotated[Time, says("only entries from this time or later (UTC nanoseconds); 0: everything")] = 0
    until: Annotated[Time, says("only entries from before this time (UTC nanoseconds); 0: everything")] = 0
    limit: Annotated[
        int,
        msgspec.Meta(ge=0, le=MOST_FOUND),
        says("the largest number of entries in the answer; 20 if left out"),
    ] = 20
    offset: Annotated[int, msgspec.Meta(ge=0, le=1_000_000), says("the number of entries to skip")] = 0
    facets: Annotated[bool, says("whether to count how many there are of each user, workcell and so on")] = (
        False
    )


@read(
    route="GET /find",
    client=Method("find", "words", timeout_s=90.0),
    summary="Search experiments, runs, samples, files and results by words",
    problems=("refused",),
)
async def find_entries(call: Call, query: FindQuery) -> SearchResult:
    """Finds experiments, runs, samples, images, files, results and publications by words and filters. Entries
    whose name holds the words come first, then the newest. A separate process keeps the search index;
    `behind` is the number of recent events that are not in the index yet."""
    finder = call.service.finder
    if finder is None:
        raise Refused("This lab has no search index.", remedy="Ask in its folder: labos find")
    return await finder.find(make_from(SearchQuery, query, hidden=tuple(sorted(call.hidden))))

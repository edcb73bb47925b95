"""The search index: what can be found by words."""

from __future__ import annotations

from typing import Annotated

import msgspec

from labos.audit.find import MOST_FOUND, SearchQuery, SearchResult
from labos.core.structs import make_from
from labos.errors import Refused
from labos.http.limits import Line, Time, says
from labos.http.method import Method
from labos.http.operation import Call, Operation, declare
from labos.http.queries import Several


class FindQuery(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    words: Annotated[
        Line, says("words that must all be there; `colo*` stands for all that begin so; none: everything")
    ] = ""
    kind: Annotated[
        Several,
        says("experiment, run, sample, image, file, result or publication; may be repeated"),
    ] = []
    user: Annotated[Several, says("whose it is, by their id; may be repeated")] = []
    workcell: Annotated[Several, says("where it was made; may be repeated")] = []
    workflow: Annotated[Several, says("a workflow's or application's name; may be repeated")] = []
    experiment: Annotated[Several, says("the experiment that it belongs to; may be repeated")] = []
    run: Annotated[Several, says("the run that it belongs to; may be repeated")] = []
    status: Annotated[Several, says("the status of runs and experiments; may be repeated")] = []
    keyword: Annotated[
        Several, says("a keyword of a publication, or what a result measured; may be repeated")
    ] = []
    since: Annotated[Time, says("only what is of this time or later (UTC nanoseconds); 0: everything")] = 0
    until: Annotated[Time, says("only what is from before this time (UTC nanoseconds); 0: everything")] = 0
    limit: Annotated[int, msgspec.Meta(ge=0, le=MOST_FOUND), says("so many are told; 20 if left out")] = 20
    offset: Annotated[int, msgspec.Meta(ge=0, le=1_000_000), says("so many are passed over")] = 0
    facets: Annotated[bool, says("whether to count how many there are of each user, workcell and so on")] = (
        False
    )


async def find_entries(call: Call, query: FindQuery) -> SearchResult:
    """Experiments, runs, samples, images, files, results and publications, by words and filters: first what
    bears the words as its name, then what is newest. A process of its own keeps the search index and answers
    from it; `behind` says how many of the last events it does not know yet."""
    finder = call.service.finder
    if finder is None:
        raise Refused("This lab has no search index.", remedy="Ask in its folder: labos find")
    return await finder.find(
        make_from(
            SearchQuery,
            query,
            kinds=tuple(query.kind),
            users=tuple(query.user),
            workcells=tuple(query.workcell),
            workflows=tuple(query.workflow),
            experiments=tuple(query.experiment),
            runs=tuple(query.run),
            statuses=tuple(query.status),
            keywords=tuple(query.keyword),
            hidden=tuple(sorted(call.hidden)),
        )
    )


OPERATIONS = declare(
    "log",
    Operation(
        route="GET /find",
        handler=find_entries,
        client=Method("find", "words", timeout_s=90.0),
        summary="What can be found by words",
        needs="viewer",
        problems=("refused",),
    ),
)

"""The operations of labos/http/routes/finding.py; written by tests/docs/client_code.py."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from labos.client._calls import Calls


class GeneratedFinding(Calls):
    """One method for each operation."""

    def find(
        self,
        words: str = "",
        *,
        kind: Sequence[str] = (),
        user: Sequence[str] = (),
        workcell: Sequence[str] = (),
        workflow: Sequence[str] = (),
        experiment: Sequence[str] = (),
        run: Sequence[str] = (),
        status: Sequence[str] = (),
        keyword: Sequence[str] = (),
        since: int = 0,
        until: int = 0,
        limit: int = 20,
        offset: int = 0,
        facets: bool = False,
    ) -> dict[str, Any]:
        """Search experiments, runs, samples, files and results by words. Finds experiments, runs, samples,
        images, files, results and publications by words and filters. Entries whose name holds the words come
        first, then the newest. A separate process keeps the search index; ``behind`` is the number of recent
        events that are not in the index yet. ``words``: words that an entry must all contain (``colo*``:
        words with this beginning); empty: everything. ``kind``: experiment, run, sample, image, file, result
        or publication; may be repeated. ``user``: the owner, by id; may be repeated. ``workcell``: the
        workcell; may be repeated. ``workflow``: a workflow's or application's name; may be repeated.
        ``experiment``: the experiment that it belongs to; may be repeated. ``run``: the run that it belongs
        to; may be repeated. ``status``: the status of runs and experiments; may be repeated. ``keyword``: a
        keyword of a publication, or the quantity of a result; may be repeated. ``since``: only entries from
        this time or later (UTC nanoseconds); 0: everything. ``until``: only entries from before this time
        (UTC nanoseconds); 0: everything. ``limit``: the largest number of entries in the answer; 20 if left
        out. ``offset``: the number of entries to skip. ``facets``: whether to count how many there are of
        each user, workcell and so on. Returns ``entries``, ``total``, ``facets``, ``position``, ``behind``.
        Raises Refused."""
        return self._get(
            "/find",
            words=words,
            kind=kind,
            user=user,
            workcell=workcell,
            workflow=workflow,
            experiment=experiment,
            run=run,
            status=status,
            keyword=keyword,
            since=since,
            until=until,
            limit=limit,
            offset=offset,
            facets=int(facets),
        )

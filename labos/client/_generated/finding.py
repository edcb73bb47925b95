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
        """What can be found by words. Experiments, runs, samples, images, files, results and publications, by
        words and filters: first what bears the words as its name, then what is newest. A process of its own
        keeps the search index and answers from it; ``behind`` says how many of the last events it does not
        know yet. ``words``: words that must all be there; ``colo*`` stands for all that begin so; none:
        everything. ``kind``: experiment, run, sample, image, file, result or publication; may be repeated.
        ``user``: whose it is, by their id; may be repeated. ``workcell``: where it was made; may be repeated.
        ``workflow``: a workflow's or application's name; may be repeated. ``experiment``: the experiment that
        it belongs to; may be repeated. ``run``: the run that it belongs to; may be repeated. ``status``: the
        status of runs and experiments; may be repeated. ``keyword``: a keyword of a publication, or what a
        result measured; may be repeated. ``since``: only what is of this time or later (UTC nanoseconds); 0:
        everything. ``until``: only what is from before this time (UTC nanoseconds); 0: everything. ``limit``:
        so many are told; 20 if left out. ``offset``: so many are passed over. ``facets``: whether to count
        how many there are of each user, workcell and so on. Returns ``entries``, ``total``, ``facets``,
        ``position``, ``behind``. Raises Refused."""
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

"""The calls of a client about runs: submitting, waiting, reading results."""

from __future__ import annotations

import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import msgspec

from labos import errors
from labos.client._batches import BatchRun, cut_into_batches, list_runs, merge_files
from labos.client._calls import LONG_POLL_S
from labos.client._files import step_text, workflow_text
from labos.client._generated.lab_operations import LabOperations
from labos.client._generated.work_operations import WorkOperations
from labos.client._progress import SHOWN_S, Progress, can_show, show_progress
from labos.client._results import RunResult
from labos.errors import BadInput

RUN_ENDS = ("run.completed", "run.failed", "run.cancelled")
"""The types of the events with which a run ends; a test compares them with those of the core."""

VERBS = ("pause", "resume", "cancel")

MOST_STREAMS = 40
"""At most so many runs can be named in a query for events; for more, the ends of all runs are read."""


Put = tuple[str, str] | tuple[str, str, Mapping[str, bool]]
"""A station, the type of labware that is placed there, and its variables: ``{"sealed": True}``."""


class RunCalls(LabOperations, WorkOperations):
    """Calls about one run, and about many."""

    def status(self, run: str, *, wait_s: float = 0.0) -> RunResult:
        """A run as it is now, or at its end if that comes within ``wait_s``."""
        result = msgspec.convert(self._get("/runs/{run}", {"run": run, "wait": wait_s}), RunResult)
        vars(result)["_lab"] = self
        return result

    def submit(
        self,
        workflow: str | Path | Mapping[str, Any],
        payload: Mapping[str, Any] | None = None,
        *,
        user: str,
        workcell: str = "",
        priority: int = 0,
        experiment: str = "",
        place: Sequence[Put] = (),
        request: str = "",
        propose: bool = False,
        due: str = "",
    ) -> str:
        """Queue a run of a workflow file, of a packaged workflow, or of a result of ``workflow_text`` or
        ``step_text``; returns its id. ``place`` are stations and the type of labware that was put there for
        it, with its state (``{"sealed": True}``); it is recorded together with the run, or not at all. The
        same ``request`` twice is one run. With ``propose`` it waits for an approval, independent of the
        policy. ``due`` is the time by which it should end: a time (``2026-11-27T08:00``, in the lab's zone if
        it has none), or a duration from now (``12h``)."""
        asked = locals() | {
            "workflow": workflow_text(workflow, payload),
            "payload": payload or {},
            "place": puts_of(place),
        }
        answer = self._post("/runs", asked, once=True)
        self.warnings = [_make_remark(finding) for finding in answer.get("warnings", ())]
        self._note_approval(answer)
        return str(answer["run"])

    def check(self, workflow: str | Path | Mapping[str, Any], **options: Any) -> dict[str, Any]:
        """A description of a run of a workflow: its ``steps``, its ``demand``, and why it would wait for an
        ``approval`` or be refused (``refusal``). Nothing is submitted. Options are those of ``submit``, and
        ``payload``. Raises as ``submit``."""
        payload = options.pop("payload", None) or {}
        place = puts_of(options.pop("place", ()))
        return self._check_run(workflow_text(workflow, payload), payload=payload, place=place, **options)

    def forecast_run(self, workflow: str | Path | Mapping[str, Any], **options: Any) -> dict[str, Any]:
        """When a run of a workflow would start and end, and which runs it would delay, as ``forecast``.
        Nothing is submitted. Options are those of ``check``."""
        payload = options.pop("payload", None) or {}
        place = puts_of(options.pop("place", ()))
        return self._forecast_run(workflow_text(workflow, payload), payload=payload, place=place, **options)

    def _note_approval(self, answer: Mapping[str, Any]) -> None:
        self.approval = str(answer.get("approval", ""))
        self.warnings += [self.approval] if self.approval else []

    def do(self, module: str, action: str, args: Mapping[str, Any] | None = None, **options: Any) -> str:
        """Queue one action on one module, as a separate run; returns the run's id. Options are those of
        ``submit``."""
        workcell = options.pop("workcell", "") or module.rpartition("/")[0]
        return self.submit(step_text(module, action, args or {}), workcell=workcell, **options)

    def submit_all(
        self,
        workflow: str | Path | Mapping[str, Any],
        payloads: Iterable[Mapping[str, Any]],
        *,
        user: str,
        request: str = "",
        **options: Any,
    ) -> list[str]:
        """Queue one run of a workflow for each payload, in order; returns their ids. All of them are queued
        before the first one starts, or none is, and the error names the payload: ``payloads[2]: …``. More
        than 50 runs are sent in requests of 50. Options are those of ``submit``; the labware in ``place`` was
        put there once, for all runs. The same ``request`` twice are the same runs, so an interrupted call can
        be repeated. ``warnings`` of the client are those of all runs."""
        asked = list_runs(workflow, payloads, request or self._ids.new())
        return self._submit_batches(asked, user=user, **options)

    def _submit_batches(self, asked: Sequence[BatchRun], *, user: str, **options: Any) -> list[str]:
        """Queue runs, as many in each request as possible; returns their ids. The labware that was placed for
        them is recorded with the first request."""
        place = puts_of(options.pop("place", ()))
        warnings: list[str] = []
        found: list[str] = []
        self.approval = ""
        for batch in cut_into_batches(asked):
            files, names = merge_files(batch)
            answer = self._submit_runs(
                {**batch[0].workflow, "files": files},
                [run.payload for run in batch],
                user,
                keys=[run.key for run in batch],
                files=names,
                first=batch[0].number,
                place=place,
                request=self._ids.new(),
                **options,
            )
            place = []
            found += answer["runs"]
            warnings += map(_make_remark, answer.get("warnings", ()))
            approvals = list(map(str, answer.get("approvals", ())))
            warnings += approvals
            self.approval = approvals[-1] if approvals else self.approval
        self.warnings = list(dict.fromkeys(warnings))
        return found

    def as_completed(self, runs: Iterable[str], *, timeout_s: float | None = None) -> Iterator[RunResult]:
        """Runs in the order in which they end; those that have already ended come first. One request waits
        for all of them. Raises NotFound, and TimeoutError if some have not ended in time."""
        waiting = set(runs)
        deadline = None if timeout_s is None else time.monotonic() + timeout_s
        after, is_known = 0, False
        while waiting:
            left_s = LONG_POLL_S if deadline is None else min(deadline - time.monotonic(), LONG_POLL_S)
            if left_s <= 0 and is_known:
                raise TimeoutError(f"{len(waiting)} runs have not ended.")
            asked = {
                "after": after,
                "wait": left_s if is_known else 0.0,
                "type": list(RUN_ENDS),
                "stream": sorted(waiting) if len(waiting) <= MOST_STREAMS else [],
            }
            page = self._get("/events", asked)
            ended = [event["stream"] for event in page["events"] if event["stream"] in waiting]
            if not page["events"] and not is_known:
                is_known = True  # the ended ones were found: all others have not ended, or do not exist
                ended = [run for run in sorted(waiting - self._list_alive()) if self.status(run).over]
            after = max(page["position"], after)
            waiting -= set(ended)
            for run in ended:
                yield self.status(run)

    def _list_alive(self) -> set[str]:
        """The runs that have not ended."""
        found: set[str] = set()
        page: dict[str, Any] = {"more": True, "position": 0}
        while page["more"]:
            page = self.runs(page["position"])
            found |= {str(run["id"]) for run in page["runs"]}
        return found

    def wait(self, run: str, *, timeout_s: float | None = None, progress: Progress = False) -> RunResult:
        """The run at its end, or its present state when the time is over. With ``progress``, a bar on
        standard error or in the notebook shows its progress and its expected end; nothing is shown if there
        is neither a terminal nor a notebook. ``"auto"`` removes the bar at the end."""
        return self._wait(run, timeout_s, progress, {})

    def _wait(
        self, run: str, timeout_s: float | None, progress: Progress, planned_s: Mapping[str, float]
    ) -> RunResult:
        deadline = None if timeout_s is None else time.monotonic() + timeout_s
        with show_progress(progress, planned_s) as show:
            while True:
                left_s = LONG_POLL_S if deadline is None else max(deadline - time.monotonic(), 0.0)
                result = self.status(run, wait_s=min(left_s, SHOWN_S if show else LONG_POLL_S))
                if show is not None:
                    show(result)
                if result.over or left_s <= 0:
                    return result

    def run(
        self,
        workflow: str | Path | Mapping[str, Any],
        payload: Mapping[str, Any] | None = None,
        *,
        progress: Progress = False,
        **options: Any,
    ) -> RunResult:
        """``submit``, then ``wait``."""
        planned_s: dict[str, float] = {}
        if can_show(progress):
            asked = {name: value for name, value in options.items() if name != "request"}
            plan = self.check(workflow, payload=payload, **asked)
            planned_s = {step["key"]: step["duration_s"] for step in plan["steps"]}
        return self._wait(self.submit(workflow, payload, **options), None, progress, planned_s)

    def control(
        self, verb: str, target: str, by: str, *, why: str = "", stay: bool = False
    ) -> dict[str, Any]:
        """``pause``, ``resume`` or ``cancel`` a run, an experiment, a module, a workcell or the ``lab``.
        Returns the target (``kind``, ``target``) and the cancelled ``runs``."""
        if verb not in VERBS:
            raise BadInput(f"{verb!r} is not one of {', '.join(VERBS)}.")
        asked = {"target": target, "by": by, "why": why, "stay": stay}
        return self._post(f"/control/{verb}", asked, repeat=True)

    def reset(self, module: str, by: str = "somebody") -> RunResult:
        """Reset a module that is in error, and wait for the end of the reset."""
        return self.wait(self.do(module, "reset", user=by))


def puts_of(place: Sequence[Put | Mapping[str, Any]]) -> list[dict[str, Any]]:
    """The placed labware, in the form of a request."""
    names = ("station", "labware", "variables")
    return [dict(p) if isinstance(p, Mapping) else dict(zip(names, p, strict=False)) for p in place]


def _make_remark(finding: Mapping[str, Any]) -> str:
    fields = ("message", "file", "line", "column", "field", "remedy")
    message, *place = (finding[name] for name in fields)
    return str(errors.SpecError(message, **dict(zip(fields[1:], place, strict=True))))

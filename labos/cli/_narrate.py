"""Shows events line by line, as they are committed."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from typing import Any

import click
import msgspec

from labos.client import LabClient, RunResult
from labos.core import fold  # noqa: F401 - registers the event types
from labos.core.envelope import Envelope
from labos.core.ids import ExperimentId, ModuleName, RunId
from labos.core.interventions import InterventionRequested
from labos.core.model import PlanStep
from labos.core.registry import Event, decode
from labos.core.runs import RunCancelled, RunCompleted, RunFailed, RunSubmitted
from labos.core.topics import PlannedWork
from labos.errors import LabosError
from labos.services.catalogue import Catalogue, PlanEntry
from labos.services.describe import describe
from labos.services.times import show_span, show_time

QUIET = ("action.accepted", "plan.", "labware.handed_over", "labware.changed", "resource.consumed")
"""Events that are of little interest to a person who watches."""

LOOK_S = 0.2

SILENCE_S = 5.0
"""After so many seconds without an event, the present action or wait of a run is shown."""

_END = (RunCompleted, RunFailed, RunCancelled)


class Narrator:
    """Follows a lab's events from a position on."""

    def __init__(self, client: LabClient, after: int) -> None:
        self.client, self.after = client, after
        self.names = Catalogue()

    def events(self, *, wait_s: float = 0.0) -> Iterator[tuple[Event, Envelope]]:
        """Committed events up to now; if there are none, those that come within ``wait_s``. Raises
        LabUnreachable if the lab has gone."""
        for data in self.client.events(self.after, wait_s=wait_s):
            head = _decode_envelope(data)
            self.after = head.position
            event = decode(head.type, head.schema, msgspec.json.encode(data["payload"]))
            self.names.learn(event)
            yield event, head

    def say(self, event: Event, head: Envelope) -> None:
        """Show one line, unless the event is of no interest."""
        if event.TYPE.startswith(QUIET):
            return
        run = str(getattr(event, "run", ""))
        if run:
            self._learn(run)
        click.echo(f"{show_time(head.recorded_at)}  {describe(event, head, self.names)}")
        if isinstance(event, InterventionRequested) and event.kind == PlannedWork.KIND:
            click.echo(f"            labos confirm {event.intervention}   (or --not-done)")
        elif isinstance(event, InterventionRequested):
            for choice in event.choices:
                answer = f"labos resolve {event.intervention} {choice.name}"
                click.echo(f"            {answer}   {choice.consequence}")

    def follow_run(self, run: str, *, quiet: bool = False) -> RunResult:
        """Show the events of one run up to its end, and its present action or wait when there are none."""
        shown_before: list[str] = []
        while True:
            is_silent = True
            for event, head in self.events(wait_s=SILENCE_S):
                is_silent = False
                if run in (head.stream, getattr(event, "run", "")) or isinstance(
                    event, InterventionRequested
                ):
                    if not quiet:
                        self.say(event, head)
                    if isinstance(event, _END) and event.run == run:
                        return self.client.status(run)
            if is_silent and not quiet:
                shown_before = self._say_how_it_is(run, shown_before)

    def _say_how_it_is(self, run: str, shown_before: list[str]) -> list[str]:
        """Show the present action or wait of a run, unless it is the same as ``shown_before``; returns it."""
        view = next((view for view in self.client.state()["runs"] if view["id"] == run), None)
        if view is None:
            return shown_before
        does = [describe_step(step) for step in view["doing"]]
        waits = list(dict.fromkeys(f"waits: {wait['why']}" for wait in view["waits"]))
        lines = does or waits
        if lines != shown_before:
            for line in lines:
                click.echo(f"            {run} {line}")
            if not does and lines:
                click.echo(f"            See what to do: labos explain {run}")
        return lines

    def follow(self, over: threading.Event) -> None:
        """Show all events, up to the last one that is committed when it is ``over``; when there are none, the
        steps in progress, once."""
        last, quiet_s = False, 0.0
        shown_before: set[tuple[str, int]] = set()
        while not last:
            last = over.wait(LOOK_S)
            quiet_s += LOOK_S
            for event, head in self.events():
                quiet_s = 0.0
                self.say(event, head)
            if quiet_s >= SILENCE_S and not last:
                quiet_s = 0.0
                shown_before = self._say_what_lasts(shown_before)

    def _say_what_lasts(self, shown_before: set[tuple[str, int]]) -> set[tuple[str, int]]:
        """Show the steps in progress that are not in ``shown_before``; returns all steps in progress."""
        runs = self.client.state(waits=False)["runs"]
        steps = {(run["id"], step["step"]): describe_step(step) for run in runs for step in run["doing"]}
        for (run, step), words in steps.items():
            if (run, step) not in shown_before:
                click.echo(f"            {run} {words}")
        return set(steps)

    def _learn(self, run: str) -> None:
        """The names of a run's steps, if its plan was recorded before we began to follow."""
        if self.names.plan_of(run) is not None:
            return
        try:
            result = self.client.status(run)
        except LabosError:
            return
        submitted = RunSubmitted(RunId(run), run, result.workflow, result.user, ExperimentId(""), 0, {}, {})
        self.names.runs[run] = submitted
        steps = [PlanStep(step.key, ModuleName(step.module), step.action) for step in result.steps]
        self.names.plans[run] = PlanEntry(result.workflow, "", steps)


def describe_step(step: dict[str, Any]) -> str:
    """A step in progress, and how long it will still take; or that its outcome is unknown."""
    if step.get("state") == "unknown":
        return f"{step['key']!r}: it is unknown how {step['action']} on {step['module']} ended"
    left = step.get("left_s")
    words = f"{step['key']!r}: {step['module']} is at {step['action']}"
    return f"{words}, about {show_span(left)} left" if left else words


def _decode_envelope(data: dict[str, Any]) -> Envelope:
    known = {name: data[name] for name in Envelope.__struct_fields__ if name in data}
    return Envelope(**{"lab": "", "digest": "", **known})

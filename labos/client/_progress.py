"""Shows the progress of a run while a program waits for it."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import TYPE_CHECKING, Literal

from labos.client._results import RunResult

if TYPE_CHECKING:
    from rich.console import Console

Progress = bool | Literal["auto"]

SHOWN_S = 1.0
"""The pause between two queries for the progress of a run."""

ENDED = ("done", "failed", "skipped")


def can_show(progress: Progress) -> bool:
    """Whether there is a terminal, or a notebook, in which the progress can be shown."""
    if not progress:
        return False
    console = _console()
    return console.is_terminal or console.is_jupyter


def _console() -> Console:
    from rich.console import Console

    return Console(stderr=True)


@contextmanager
def show_progress(
    progress: Progress, planned_s: Mapping[str, float]
) -> Iterator[Callable[[RunResult], None] | None]:
    """A function that shows the progress of a run each time it is called; None if nothing can be shown.
    ``planned_s`` are the nominal durations of steps by key, with which they are weighted."""
    if not can_show(progress):
        yield None
        return
    from rich import progress as bars

    with bars.Progress(
        bars.TextColumn("{task.description}"),
        bars.BarColumn(),
        bars.TextColumn("{task.fields[steps]}"),
        bars.TimeElapsedColumn(),
        bars.TextColumn("left:"),
        bars.TimeRemainingColumn(elapsed_when_finished=False),
        console=_console(),
        transient=progress == "auto",
    ) as bar:
        task = bar.add_task("", total=None, steps="")

        def show(result: RunResult) -> None:
            steps = [step for step in result.steps if step.state != "asleep"]
            weights = [max(planned_s.get(step.key, 1.0), 1.0) for step in steps]
            ended = [step.state in ENDED for step in steps]
            bar.update(
                task,
                description=f"{result.id} {result.workflow} {result.status}",
                total=sum(weights) or None,
                completed=sum(w for w, over in zip(weights, ended, strict=True) if over),
                steps=f"{sum(ended)} of {len(steps)} steps",
            )

        yield show

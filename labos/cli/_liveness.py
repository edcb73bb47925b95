"""What is known of a lab, and what time it is there, by whether a kernel lives there."""

from __future__ import annotations

from typing import Any

import click
import msgspec

from labos.cli._query import Where, now_ns, open_log
from labos.cli._remote import lab_of
from labos.core.ids import local
from labos.core.modules import Module
from labos.core.state import LabState
from labos.errors import NotFound, StoreUnavailable
from labos.ports import Head
from labos.services.history import fold_state_at
from labos.services.times import show_time
from labos.settings import Settings, find_kernel
from labos.store import find_lease_holder


def find_lab_now(url: str, head: Head) -> int:
    """The present (UTC ns) where a kernel lives; else the last event, for nothing went on since."""
    return max(now_ns(), head.recorded_at) if has_kernel(url) else head.recorded_at


def has_kernel(url: str) -> bool:
    """Whether a kernel runs the lab of a database; one that answers over HTTP does."""
    return url.startswith(("http://", "https://")) or bool(find_lease_holder(url))


def say_if_dead(url: str, head: Head, *, last_known: bool = True) -> None:
    """Say on stderr, where no kernel runs the lab, how old what is shown is. ``last_known``: it is the
    state, not the story."""
    if head.position and not has_kernel(url):
        when = show_time(head.recorded_at)
        ends = "; last known:" if last_known else "."
        click.echo(f"labos: No kernel runs this lab. Its last event was at {when}{ends}", err=True)


def open_questions(home: str | None) -> list[dict[str, Any]]:
    """The questions that the running lab asks; where none runs, those that its log last knew. Raises NotFound
    where there is no log either."""
    settings = Settings.make(home)
    if lab_of(home) or find_kernel(settings.home) is not None:
        from labos.cli._lab import need_lab

        with need_lab(home) as client:
            return list(client.state(waits=False)["interventions"])
    from labos.http.views import make_question_view

    state = read_last_state(settings)
    return [
        msgspec.to_builtins(make_question_view(state, asked)) for asked in state.interventions.open.values()
    ]


def read_last_state(settings: Settings) -> LabState:
    """The state that the log of a lab without a kernel ends with, said to be that. Raises NotFound where
    there is no log."""
    try:
        with open_log(Where(settings.home, settings.database)) as store:
            say_if_dead(settings.database, store.head())
            return fold_state_at(store)
    except StoreUnavailable as error:
        raise NotFound(
            f"No lab runs in {settings.home}, and its log cannot be read ({error.message.rstrip('.')}).",
            remedy="Start one with `labos up`, or name its --home.",
        ) from error


def module_of(state: LabState, name: str) -> Module:
    """A module by its name, with or without its workcell. Raises NotFound."""
    for known, module in state.modules.by_name.items():
        if name in (known, local(known)):
            return module
    raise NotFound(f"There is no module {name!r}.", remedy="List them: labos nodes")

"""The last known state of a lab, and its present time: they depend on whether a kernel runs."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import click
import msgspec

from labos.cli._lab import find_lab
from labos.cli._query import Where, now_ns, open_log
from labos.core.ids import local
from labos.core.modules import Module
from labos.core.state import LabState
from labos.errors import NotFound, StoreUnavailable
from labos.ports import Head
from labos.services.history import fold_state_at
from labos.services.log import Log
from labos.services.times import Moment, show_time
from labos.settings import Settings
from labos.store import find_lease_holder

NOW = Moment()


def find_lab_now(url: str, head: Head) -> int:
    """The present time (UTC ns) if a kernel runs; else the time of the last event, because nothing has
    happened since."""
    return max(now_ns(), head.recorded_at) if has_kernel(url) else head.recorded_at


def has_kernel(url: str) -> bool:
    """Whether a kernel runs the lab of a database; a lab that answers over HTTP has one."""
    return url.startswith(("http://", "https://")) or bool(find_lease_holder(url))


def say_if_dead(url: str, head: Head, *, last_known: bool = True) -> None:
    """If no kernel runs the lab, report on stderr how old the shown data is. ``last_known``: the data is a
    state, not a history."""
    if head.position and not has_kernel(url):
        when = show_time(head.recorded_at)
        ends = "; last known:" if last_known else "."
        click.echo(f"labos: No kernel runs this lab. Its last event was at {when}{ends}", err=True)


@contextmanager
def open_current_log(
    where: Where, moment: Moment = NOW, *, stored: bool = False, last_known: bool = True
) -> Iterator[Log]:
    """As ``open_log``. If no kernel runs the lab, this is reported first (``say_if_dead``), unless a past
    ``moment`` is shown."""
    with open_log(where, stored=stored) as store:
        if moment == NOW:
            say_if_dead(where.url, store.head(), last_known=last_known)
        yield store


def open_questions(home: str | None) -> list[dict[str, Any]]:
    """The open questions of the running lab; if none runs, those in its log. Raises NotFound if there is no
    log either."""
    if (lab := find_lab(home)) is not None:
        with lab as client:
            return list(client.state(waits=False)["interventions"])
    from labos.http.views import make_question_view

    state = read_last_state(Settings.make(home))
    return [
        msgspec.to_builtins(make_question_view(state, asked)) for asked in state.interventions.open.values()
    ]


def read_last_state(settings: Settings) -> LabState:
    """The state at the end of the log of a lab without a kernel; it is announced as the last known state.
    Raises NotFound if there is no log."""
    try:
        with open_current_log(Where(settings.home, settings.database)) as store:
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

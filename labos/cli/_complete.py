"""Completion in the shell with Tab: names that this lab, or this installation, knows.

If the lab cannot be asked, nothing is offered and no error is shown, so that the user can continue to type.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

from labos.core.ids import local
from labos.errors import LabosError

if TYPE_CHECKING:
    from click.shell_completion import CompletionItem

    from labos.cli._query import Where

RUNS_OFFERED = 200
"""Only so many of the newest runs are offered."""

PATIENCE_S = 0.5
"""How long a running lab may take to answer before its log is read instead."""

F = TypeVar("F", bound=Callable[..., Any])

Completer = Callable[[click.Context, click.Parameter, str], "list[CompletionItem]"]


def make_completer(*kinds: str) -> Completer:
    """Offers names of these kinds: ``run``, ``experiment``, ``module``, ``station``, ``labware``,
    ``intervention``, ``workcell``, ``driver``, ``lab`` (the word); ``workflow`` and ``workcell file``:
    packaged ones and files."""

    def complete(context: click.Context, option: click.Parameter, begun: str) -> list[CompletionItem]:
        from click.shell_completion import CompletionItem

        try:
            names = list(dict.fromkeys(_iterate_names(kinds, context)))
        except Exception:
            names = []
        found = [CompletionItem(name) for name in names if name.startswith(begun)]
        if {"workflow", "workcell file"} & set(kinds):
            found.append(CompletionItem(begun, type="file"))
        return found

    return complete


def name_option(kind: str, metavar: str, help: str) -> Callable[[F], F]:
    """The option ``--KIND``, which takes a name of this kind; empty if it is not given."""
    return click.option(
        f"--{kind}", shell_complete=make_completer(kind), default="", metavar=metavar, help=help
    )


def _iterate_names(kinds: Iterable[str], context: click.Context) -> Iterator[str]:
    from labos.spec.library import list_specs

    lab = _Lab(context)
    for kind in kinds:
        match kind:
            case "lab":
                yield "lab"
            case "workflow":
                yield from list_specs("workflows")
            case "workcell file":
                yield from list_specs("workcells")
            case "driver":
                from labos.bootstrap import descriptions

                yield from sorted(descriptions())
            case "run" | "experiment":
                yield from lab.list_begun(kind)
            case _:
                yield from lab.list_known(kind)


class _Lab:
    """The lab that the typed command line names; it is asked at most once."""

    def __init__(self, context: click.Context) -> None:
        self._context = context
        self._known: dict[str, list[str]] | None = None

    @property
    def where(self) -> Where:
        from labos.cli._query import Where
        from labos.settings import Settings, lab_url

        given = self._context.params
        settings = Settings.make(given.get("home"), given.get("database"))
        lab = "" if given.get("home") or given.get("database") else lab_url()
        return Where(Path(settings.home), settings.database, lab)

    def list_begun(self, kind: str) -> list[str]:
        """Runs or experiments, the newest first."""
        from labos.cli._query import open_log
        from labos.core.experiments import ExperimentStarted
        from labos.core.runs import RunSubmitted
        from labos.ports import LogQuery
        from labos.services.log import decode_events

        type_ = RunSubmitted.TYPE if kind == "run" else ExperimentStarted.TYPE
        with open_log(self.where) as store:
            found = list(decode_events(store.select(LogQuery(types=(type_,), last=RUNS_OFFERED))))
        return [str(getattr(event, kind)) for event, _ in reversed(found)]

    def list_known(self, kind: str) -> list[str]:
        if self._known is None:
            self._known = self._ask_kernel() or self._read()
        return self._known[kind]

    def _ask_kernel(self) -> dict[str, list[str]] | None:
        """From the kernel of the running lab."""
        from labos.settings import find_kernel

        if not self.where.lab and find_kernel(self.where.home) is None:
            return None
        from labos.client import LabClient

        try:
            with LabClient(self.where.lab, home=self.where.home, patience_s=PATIENCE_S) as client:
                state = client.state(waits=False)
        except LabosError:
            return None
        kinds = {"module": "modules", "station": "stations"}
        found = {kind: _shorten_names([item["name"] for item in state[many]]) for kind, many in kinds.items()}
        found |= {
            kind: [str(item["id"]) for item in state[many]]
            for kind, many in (("labware",) * 2, ("intervention", "interventions"))
        }
        return {**found, "workcell": list(state["lab"]["workcells"])}

    def _read(self) -> dict[str, list[str]]:
        """From the log of a lab without a kernel."""
        from labos.cli._query import open_log
        from labos.services.history import fold_state_at

        with open_log(self.where) as store:
            state = fold_state_at(store)
        return {
            "module": _shorten_names(list(map(str, state.modules.by_name))),
            "station": _shorten_names(list(map(str, state.bench.stations))),
            "labware": list(map(str, state.bench.labware)),
            "intervention": list(map(str, state.interventions.open)),
            "workcell": list(map(str, state.lab.workcells)),
        }


def _shorten_names(names: list[str]) -> list[str]:
    """Names without their workcells, where they stay unique."""
    many = Counter(map(local, names))
    return [local(name) if many[local(name)] == 1 else name for name in names]

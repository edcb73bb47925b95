"""``labos demo``: two users share a workcell."""

from __future__ import annotations

import contextlib
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from labos.cli._options import SPEED_HELP, database_option
from labos.cli._out import show_table
from labos.core.ids import local
from labos.errors import BadInput, LabosError
from labos.private import make_folder
from labos.services.summary import RunSummary, Summary, summarise
from labos.services.times import show_span
from labos.settings import Settings, keep_private

if TYPE_CHECKING:
    from labos.bootstrap import LabThread
    from labos.client import RunResult

APPLICATION_END_S = 10.0
"""How long the application may take to end after a Ctrl-C (seconds)."""

SPEED = 400.0
"""Two PCRs take four hours of lab time, one after the other in the same thermocycler."""

WAITS_SHOWN = 2


@click.command("demo")
@click.option("--speed", type=click.FloatRange(min=1), default=SPEED, show_default=True, help=SPEED_HELP)
@click.option("--keep", is_flag=True, help="Leave the lab running at the end, until Ctrl-C.")
@database_option
@click.option(
    "--seed",
    type=int,
    default=0,
    show_default=True,
    help="The seed of the simulated instruments and of the solver.",
)
@click.option("--home", metavar="DIR", help="A new folder (lab/demo, lab/demo-2, …).")
def command(speed: float, keep: bool, database: str | None, seed: int, home: str | None) -> None:
    """Run the demonstration on simulated instruments; takes about 40 seconds.

    It runs the RPL workcell of Vescovi et al. with its fourteen modules, one process for each. The user
    Ada submits two PCR workflows. Bo's application picks a colour: it takes a new plate, mixes three
    times, and throws the plate away. Both share the arm and the stacks. Every step is an event in the
    log, which you can read afterwards.

    \b
    labos demo
    labos demo --speed 1000 --home /tmp/demo
    """
    from labos.bootstrap import LabThread, descriptions
    from labos.cli._lab import CLOSING, end_in_order, read_workcell

    folder = Path(home) if home else _find_fresh_folder()
    keep_private()
    settings = Settings.make(folder, database, name="demo", speed=speed, simulate=True, seed=seed)
    _expect_new(settings, given=database is not None)
    cell = read_workcell("rpl")
    what = {name: _cut_first_sentence(known.description) for name, known in descriptions().items()}
    click.echo(
        f"The RPL workcell, {len(cell.workcell.modules)} simulated modules, {speed:g} times real time:"
    )
    for module in cell.workcell.modules:
        click.echo(f"  {local(module.name):<16}{what[module.driver]}")
    click.echo(
        "The modules start. Ada submits two PCR runs, Bo an application that picks a colour. Please wait …"
    )
    lab = LabThread(settings, [cell])
    with end_in_order(lab.hurry):
        try:
            with lab:
                try:
                    results, code = _show(lab, settings, seed)
                    _show_account(settings, results)
                    if keep:
                        click.echo(f"\nThe lab continues at {lab.url} until Ctrl-C.")
                        while not lab.failed.wait(0.5):
                            pass
                except KeyboardInterrupt:
                    click.echo(f"\n{CLOSING}")
                    raise
        except KeyboardInterrupt:
            click.echo(f"\nInterrupted. Continue with: labos up --home {_cut_path(settings.home)}")
            raise click.exceptions.Exit(130) from None
    if lab.failure is not None:
        raise lab.failure
    if code or not all(result.succeeded for result in results):
        raise click.exceptions.Exit(1)


def _cut_first_sentence(text: str) -> str:
    first = " ".join(text.split()).partition(". ")[0]
    return f"{first.rstrip('.')}."


def _show(lab: LabThread, settings: Settings, seed: int) -> tuple[list[RunResult], int]:
    """Submit everything and follow it to its end."""
    from labos.client import LabClient

    with LabClient(lab.url) as client, _show_progress(lab.url):
        runs = [client.submit("pcr", user="ada") for _ in range(2)]
        application = _start_application(settings, seed)
        try:
            results = [client.wait(run) for run in runs]
            code = application.wait()
        finally:
            if application.poll() is None:
                application.terminate()
                try:
                    application.wait(APPLICATION_END_S)
                except subprocess.TimeoutExpired:
                    application.kill()
                    application.wait()
        return results, code


def _start_application(settings: Settings, seed: int) -> subprocess.Popen[bytes]:
    from labos.spec.library import find_specs_folder

    script = find_specs_folder() / "apps" / "first_color_picker.py"
    make_folder(settings.logs)
    with (settings.logs / "color_picker.log").open("ab") as log:
        return subprocess.Popen(
            [
                *(sys.executable, str(script)),
                *("--home", str(settings.home), "--user", "bo", "--seed", str(seed)),
            ],
            stdin=subprocess.DEVNULL,
            stdout=log,
            stderr=log,
        )


@contextlib.contextmanager
def _show_progress(url: str) -> Iterator[None]:
    """Show the progress as long as the block lasts: an overview in a terminal, else lines."""
    over = threading.Event()
    watch = _show_live if sys.stdout.isatty() else _show_events
    watcher = threading.Thread(target=watch, args=(url, over), name="watcher", daemon=True)
    watcher.start()
    try:
        yield
    finally:
        over.set()
        watcher.join(5.0)


def _show_events(url: str, over: threading.Event) -> None:
    from labos.cli._narrate import Narrator
    from labos.client import LabClient

    with contextlib.suppress(LabosError), LabClient(url, patience_s=0.0) as client:
        Narrator(client, client.health()["position"]).follow(over)


def _show_live(url: str, over: threading.Event) -> None:
    from rich.live import Live

    from labos.cli._live import draw_picture
    from labos.client import LabClient

    alive: dict[str, dict[str, Any]] = {}
    ended: dict[str, str] = {}
    with contextlib.suppress(LabosError), LabClient(url, patience_s=0.0) as client, Live() as live:
        while not over.wait(0.25):
            state = client.state()
            now = {run["id"]: run for run in state["runs"]}
            for run in alive.keys() - now.keys():
                ended[run] = f"{alive[run]['workflow']} of {alive[run]['user']} {client.status(run).status}"
            alive = now
            live.update(draw_picture(state, ended))


def _show_account(settings: Settings, results: list[RunResult]) -> None:
    """The statistics of the lab, computed from its log alone; and commands to try next."""
    from labos.store import open_store

    with closing(open_store(settings.database, create=False, read_only=True)) as store:
        summary = summarise(store.read())
    click.echo()
    show_summary(summary)
    home = _cut_path(settings.home)
    click.echo("\nThe log is kept. Query it:")
    for ask in (
        f"labos runs --home {home}",
        f"labos explain {results[-1].id} --home {home}",
        f"labos stations --home {home}",
        f"labos log --run {results[0].id} --home {home}",
        f"labos twh --home {home}",
        f"labos verify --home {home}",
        f"labos up --home {home}",
    ):
        click.echo(f"  {ask}")


def show_summary(summary: Summary) -> None:
    """Print runs, modules, users and the time without human intervention."""
    fast = summary.pace != 1
    columns = [
        "run",
        "workflow",
        "user",
        "status",
        "steps",
        "wall",
        "working",
        "waiting",
        "queued",
        "waited for",
    ]
    if fast:
        columns.insert(6, "lab time")
    show_table(columns, [_list_run_cells(run, fast) for run in summary.runs], title="Runs")
    rows = [
        (
            local(m.name),
            f"{m.utilisation:.0%}",
            str(m.actions),
            str(m.failed),
            str(m.unknown),
            show_span(m.busy_s),
        )
        for m in summary.modules
    ]
    show_table(("module", "in use", "actions", "failed", "unknown", "busy"), rows, title="Modules", gap=True)
    users = [
        (u.name, f"{u.completed} of {u.runs}", str(u.actions), show_span(u.lab_s if fast else u.module_s))
        for u in summary.users
    ]
    show_table(("user", "runs completed", "actions", "module time"), users, title="Users", gap=True)
    click.echo(f"\n{describe_summary(summary)}")


def describe_summary(summary: Summary) -> str:
    """Time without human intervention in one sentence."""
    twh = summary.twh.lab
    longest = twh.longest.worked_ns / 1e9
    lab_time = f" ({show_span(longest * summary.pace)} of lab time)" if summary.pace != 1 else ""
    times = "no intervention" if not twh.interventions else f"{twh.interventions} interventions"
    if twh.interventions == 1:
        times = "one intervention"
    return (
        f"Longest time without human intervention: {show_span(longest)}{lab_time}, "
        f"{twh.longest.commands} actions completed in it; {times} in all."
    )


def _list_run_cells(run: RunSummary, fast: bool) -> list[str]:
    waited = "; ".join(f"{wait.why} ({show_span(wait.seconds)})" for wait in run.waits[:WAITS_SHOWN])
    row = [run.id, run.workflow, run.user, run.status, f"{run.done}/{run.steps}", show_span(run.wall_s)]
    if fast:
        row.append(show_span(run.lab_s))
    spans = [show_span(seconds) for seconds in (run.working_s, run.waiting_s, run.queued_s)]
    return [*row, *spans, run.why or waited]


def _cut_path(folder: Path) -> str:
    """The folder as a user would type it here."""
    here = Path.cwd()
    return str(folder.relative_to(here) if folder.is_relative_to(here) else folder)


def _find_fresh_folder() -> Path:
    base = Settings.make().home
    number = 1
    while (folder := base / ("demo" if number == 1 else f"demo-{number}")).exists():
        number += 1
    return folder


def _expect_new(settings: Settings, *, given: bool) -> None:
    """Raises BadInput if there is already a lab."""
    if (settings.home / "kernel.json").exists() or (settings.home / "labos.db").exists():
        raise BadInput(
            f"{settings.home} already holds a lab.",
            remedy=f"Continue it with `labos up --home {_cut_path(settings.home)}`, or name a new folder.",
        )
    if given:
        from labos.store import open_store

        with closing(open_store(settings.database, home=settings.home)) as store:
            if store.head().position:
                raise BadInput(
                    "The database already holds a lab.", remedy="Use an empty database for the demonstration."
                )

"""What a scrape costs, and what counting costs, in a lab of 1,000 modules that has seen 10⁶ runs.

The lab is the folded state of a large factory; its events are told to the metrics as the kernel tells them.
"""

from __future__ import annotations

import time
from collections.abc import Iterator

from prometheus_client import CollectorRegistry, generate_latest

from labos.core.actions import ActionRequested, ActionSucceeded
from labos.core.bench import StationState
from labos.core.envelope import Envelope, Record
from labos.core.ids import ActionId, ExperimentId, ModuleName, RunId, StationName
from labos.core.model import ModuleSpec, Plan, PlanStep, StationSpec
from labos.core.modules import Module
from labos.core.plans import PlanState
from labos.core.registry import Event
from labos.core.resources import Level
from labos.core.runs import RunCompleted, RunStarted, RunState, RunSubmitted
from labos.core.shares import Usage
from labos.core.state import LabState
from labos.planning.scheduler import Scheduler
from labos.runtime.ledger import Entry
from labos.telemetry.kernel import KernelMetrics
from tests.benchmarks.figures import Figure, Report, median, microseconds, milliseconds, times

CELLS, ACTIONS, STATIONS = 50, 4, 5
WORKFLOWS, USERS = 400, 2_000
MUST_SERIES, MUST_SCRAPE_S = 50_000, 0.05
SECOND = 1_000_000_000


def module(number: int) -> ModuleName:
    return ModuleName(f"cell{number % CELLS}/m{number}")


def factory(modules: int, queued: int) -> LabState:
    """A lab of so many modules, where so many runs wait."""
    state = LabState()
    state.lab.workcells = {f"cell{number}": "" for number in range(CELLS)}
    for number in range(modules):
        name = module(number)
        state.modules.by_name[name] = Module(ModuleSpec(name, f"driver{number % 20}"), status="IDLE")
        state.resources.levels[f"{name}:tips"] = Level(500.0, 960.0)
        for place in range(STATIONS):
            station = StationName(f"{name}.s{place}")
            state.bench.stations[station] = StationState(StationSpec(station, "nest", name))
    for number in range(CELLS):
        plan = Plan(f"w{number}", f"cell{number}", (PlanStep("s", module(number), "a0"),))
        state.runs.plans[f"p{number}"] = PlanState(plan, "", 1, "")
    for number in range(queued):
        run = RunId(f"Q{number}")
        name, user = f"w{number % WORKFLOWS}", f"u{number % USERS}"
        state.runs.queued[run] = RunState(
            run, f"p{number % CELLS}", name, user, ExperimentId(""), 0, number, 0, False
        )
    for number in range(USERS):
        state.shares.usage[f"u{number}"] = Usage(1e9, 0)
    return state


def story(modules: int, first: int, runs: int) -> Iterator[Event]:
    """So many runs from their submission to their end, each with one action, over all modules, actions,
    workflows and users."""
    for number in range(first, first + runs):
        run, action = RunId(f"R{number}"), ActionId(f"A{number}")
        where, name = module(number % modules), f"a{number // modules % ACTIONS}"
        plan, user = f"p{number % CELLS}", f"u{number % USERS}"
        yield RunSubmitted(run, plan, f"w{number % WORKFLOWS}", user, ExperimentId(""), 0, {}, {})
        yield RunStarted(run)
        yield ActionRequested(action, run, 0, where, 1, 1, "j", name, {}, ())
        yield ActionSucceeded(action, run, 0, where, 1)
        yield RunCompleted(run, 1)


def entry(event: Event, at: int) -> Entry:
    head = Envelope("lab", 1, "", "", 1, event.TYPE, 1, at, "labos", "", "", "")
    return Entry(Record(head, b"", b"", b""), event)


def measure(modules: int = 1_000, runs: int = 1_000_000, queued: int = 10_000, scrapes: int = 20) -> Report:
    state = factory(modules, queued)
    metrics, scheduler = KernelMetrics(lambda: state), Scheduler()
    happened = metrics.of_events
    happened.begin_with(state)
    counted, at, told = 0.0, 0, 0
    for first in range(0, runs, 1_000):
        entries = []
        for event in story(modules, first, min(1_000, runs - first)):
            at += SECOND
            entries.append(entry(event, at))
        began = time.perf_counter()
        happened.on_committed(entries)
        counted += time.perf_counter() - began
        told += len(entries)
    metrics.text()
    took: list[float] = []
    waited: list[float] = []
    for number in range(scrapes):  # a busy factory: a hundred runs between two scrapes
        for event in story(modules, runs + number * 100, 100):
            happened.on_committed([entry(event, at)])
        began, worked = time.perf_counter(), time.thread_time()
        metrics.of_state.update(state, scheduler, at)
        happened.update(at)
        text = metrics.text()
        took.append(time.thread_time() - worked)
        waited.append(time.perf_counter() - began)
    library = CollectorRegistry()
    library.register(metrics.registry)  # type: ignore[arg-type]
    worked = time.thread_time()
    generate_latest(library)
    alone = time.thread_time() - worked
    series = sum(not line.startswith("#") for line in text.splitlines())
    scrape = median(took)
    return Report(
        [
            Figure(
                f"series of {modules:,} modules after {runs:,} runs",
                f"{series:,}",
                must=f"≤ {MUST_SERIES:,}",
                ok=series <= MUST_SERIES,
            ),
            Figure(
                f"one scrape, {queued:,} runs waiting, of the kernel's processor",
                milliseconds(scrape),
                f"{milliseconds(alone)} (prometheus_client writes the same)",
                times(scrape / alone),
                must=f"≤ {MUST_SCRAPE_S * 1e3:.0f} ms",
                ok=scrape <= MUST_SCRAPE_S,
            ),
            Figure("counting one committed event", microseconds(counted / told)),
        ],
        [
            f"an answer has {len(text) / 1e6:.1f} MB; by the clock on the wall a scrape took "
            f"{milliseconds(median(waited))}, the slowest one {milliseconds(max(waited))}"
        ],
    )


def smoke() -> Report:
    return measure(20, 500, 50, 2)

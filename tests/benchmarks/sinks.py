"""Steps a second while events are carried out of the lab: a slow or dead sink slows nobody.

The limit is the same lab in the same run without a sink. The sinks are processes, as people start them: one
writes JSON lines, one has a broker of Kafka that refuses connections, one a broker that takes them and never
says a word.
"""

from __future__ import annotations

import asyncio
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

from labos.settings import free_port
from tests.benchmarks.figures import Figure, Report, median, scratch, spread, times
from tests.benchmarks.idle_lab import idle_lab
from tests.benchmarks.viewers import rate

MUST = 0.9
START_S = 60.0
SINKS = ("a file of JSON lines", "a broker that is dead", "a broker that says nothing")


@contextmanager
def exporter(folder: Path, to: str) -> Iterator[None]:
    """`labos export events --follow`, from when it has looked for its sink (of a broker it says that it is
    away) until the end of the block."""
    argv = [sys.executable, "-m", "labos", "export", "events", "--to", to, "--follow", "--home", str(folder)]
    with (folder / "exporter.log").open("ab") as log:
        process = subprocess.Popen(
            [*argv, "--database", f"sqlite:///{folder}/labos.db"], stdout=log, stderr=log
        )
    try:
        yield
        assert process.poll() is None, (folder / "exporter.log").read_text()
    finally:
        process.kill()
        process.wait()


def targets(folder: Path, stack: ExitStack) -> list[str]:
    """Where the sinks carry events to."""
    silent = stack.enter_context(socket.create_server(("127.0.0.1", 0)))
    return [
        str(folder / "events.jsonl"),
        f"kafka://127.0.0.1:{free_port()}/events",
        f"kafka://127.0.0.1:{silent.getsockname()[1]}/events",
    ]


async def measure_in(folder: Path, rounds: int, steps: int) -> Report:
    ratios: dict[str, list[float]] = {name: [] for name in SINKS}
    rates: dict[str, list[float]] = {name: [] for name in ("", *SINKS)}
    cpus: dict[str, list[float]] = {name: [] for name in ("", *SINKS)}
    with ExitStack() as stack:
        wanted = dict(zip(SINKS, targets(folder, stack), strict=True))
        async with idle_lab(folder, 1) as lab:
            lab.keep_plans(steps)
            await rate(lab, 2)
            for _ in range(rounds):
                for name, to in wanted.items():
                    alone, cpu = await rate(lab, steps)
                    rates[""].append(alone)
                    cpus[""].append(cpu)
                    with exporter(folder, to):
                        seen, cpu = await rate(lab, steps)
                    rates[name].append(seen)
                    cpus[name].append(cpu)
                    ratios[name].append(seen / alone)
    figures = [
        Figure(
            f"steps/s with a sink: {name}",
            f"{median(rates[name]):.0f}/s, {median(cpus[name]):.1f} ms of processor each",
            f"{median(rates['']):.0f}/s, {median(cpus['']):.1f} ms (none)",
            times(median(ratios[name])),
            f"≥ {MUST} ×",
            median(ratios[name]) >= MUST,
        )
        for name in SINKS
    ]
    return Report(figures, [f"ratios of {rounds} rounds, {name}: {spread(ratios[name])}" for name in SINKS])


def measure(rounds: int = 5, steps: int = 400) -> Report:
    with scratch("sinks") as folder:
        return asyncio.run(measure_in(folder, rounds, steps))


def smoke() -> Report:
    return measure(1, 5)

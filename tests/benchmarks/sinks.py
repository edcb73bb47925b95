"""Steps a second while events are carried out of the lab: a slow or dead sink slows nobody.

The limit is the same lab in the same run without a sink. The sinks are processes, as people start them: one
writes JSON lines, one has a broker of Kafka that refuses connections, one a broker that takes them and never
says a word. Without a sink is measured while its process is frozen, in short turns with it: so what else the
computer does meets both alike. The ratio is the middle one of all turns: a few in which the computer did
something else do not count.
"""

from __future__ import annotations

import asyncio
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from statistics import median

from labos.settings import free_port
from tests.benchmarks.figures import Figure, Report, scratch, spread, times
from tests.benchmarks.idle_lab import IdleLab, idle_lab
from tests.benchmarks.viewers import rate

MUST = 0.9
START_S = 60.0
SINKS = ("a file of JSON lines", "a broker that is dead", "a broker that says nothing")


@contextmanager
def exporter(folder: Path, to: str) -> Iterator[subprocess.Popen[bytes]]:
    """`labos export events --follow`, from when it has looked for its sink (of a broker it says that it is
    away) until the end of the block."""
    argv = [sys.executable, "-m", "labos", "export", "events", "--to", to, "--follow", "--home", str(folder)]
    said = folder / "exporter.log"
    with said.open("wb") as log:
        argv += ["--database", f"sqlite:///{folder}/labos.db"]
        process = subprocess.Popen(argv, stdout=log, stderr=log)
    try:
        until = time.monotonic() + START_S
        while not (said.stat().st_size if "://" in to else Path(to).exists()):
            assert process.poll() is None, said.read_text()
            assert time.monotonic() < until, to
            time.sleep(0.05)
        yield process
        assert process.poll() is None, said.read_text()
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
    figures: list[Figure] = []
    notes: list[str] = []
    with ExitStack() as stack:
        wanted = dict(zip(SINKS, targets(folder, stack), strict=True))
        async with idle_lab(folder, 1) as lab:
            lab.keep_plans(steps)
            await rate(lab, 2)
            for name, to in wanted.items():
                with exporter(folder, to) as process:
                    figure, note = await compare(lab, process, rounds, steps, name)
                figures.append(figure)
                notes.append(note)
    return Report(figures, notes)


async def compare(
    lab: IdleLab, process: subprocess.Popen[bytes], rounds: int, steps: int, name: str
) -> tuple[Figure, str]:
    """Turns with the sink and without, now the one first and now the other."""
    seconds = {True: 0.0, False: 0.0}
    cpu = {True: 0.0, False: 0.0}
    ratios: list[float] = []
    for turn in range(rounds):
        rates: dict[bool, float] = {}
        for beside in (True, False) if turn % 2 else (False, True):
            process.send_signal(signal.SIGCONT if beside else signal.SIGSTOP)
            rates[beside], each_ms = await rate(lab, steps)
            seconds[beside] += steps / rates[beside]
            cpu[beside] += each_ms / rounds
        ratios.append(rates[True] / rates[False])
    process.send_signal(signal.SIGCONT)
    ratio = median(ratios)
    every = rounds * steps
    figure = Figure(
        f"steps/s with a sink: {name}",
        f"{every / seconds[True]:.0f}/s, {cpu[True]:.2f} ms of processor each",
        f"{every / seconds[False]:.0f}/s, {cpu[False]:.2f} ms (none)",
        times(ratio),
        f"≥ {MUST} ×",
        ratio >= MUST,
    )
    return figure, f"ratios of {rounds} turns, {name}: {spread(ratios)}"


def measure(rounds: int = 40, steps: int = 60) -> Report:
    with scratch("sinks") as folder:
        return asyncio.run(measure_in(folder, rounds, steps))


def smoke() -> Report:
    return measure(2, 5)

"""From the start of ``labos up`` until the first step of an empty lab is in the log.

The whole RPL workcell: fourteen node processes start at the same time.
"""

from __future__ import annotations

import subprocess
import sys
import time
from pathlib import Path

from labos.spec import find_spec
from labos.store import open_store
from tests.benchmarks.figures import Figure, Report, median, scratch, spread
from tests.benchmarks.processes import LabProcess

MUST_S = 3.0
FIRST = "sciclops"
NEEDED = ("sciclops", "pf400")


def first_step(home: Path, *options: str) -> dict[str, float]:
    """Seconds since the start of the process at which each thing was in the log."""
    with LabProcess(home, *options) as lab:
        if options:
            for name in NEEDED:
                lab.start_node(name, name)
        with lab.client() as client:
            found = time.time_ns()
            run = lab.submit(client, find_spec("workflows", "cp_newplate"))
            client.wait(run, timeout_s=60.0)
        store = open_store(f"sqlite:///{home}/labos.db", read_only=True)
        try:
            records = list(store.read())
        finally:
            store.close()
        times = {"found by a client": (found - lab.began_ns) / 1e9}
        for record in records:
            name = record.head.type
            if name == "node.joined" and f'/{FIRST}"'.encode() in record.payload:
                name = f"{FIRST} joined"
            if name in ("node.joined", "action.requested") and name in times:
                if name == "node.joined":
                    times["last node joined"] = (record.head.recorded_at - lab.began_ns) / 1e9
                continue
            times.setdefault(name, (record.head.recorded_at - lab.began_ns) / 1e9)
        return times


def seconds_of(code: str) -> float:
    began = time.perf_counter()
    subprocess.run([sys.executable, "-c", code], check=True)
    return time.perf_counter() - began


NAMES = {
    "lab.created": "store open, lease taken (lab.created)",
    "workcell.applied": "bus, HTTP, workcell applied",
    "found by a client": "found by a client",
    f"{FIRST} joined": f"the node of the first step joined ({FIRST})",
    "run.submitted": "run submitted",
    "action.requested": "first step requested",
    "last node joined": "last node joined",
}


def measure(rounds: int = 3, *, alone: bool = True) -> Report:
    with scratch("start") as folder:
        whole = [first_step(folder / f"lab{number}") for number in range(rounds)]
        single = [
            first_step(folder / f"one{number}", "--no-nodes") for number in range(rounds if alone else 0)
        ]
    took = [times["action.requested"] for times in whole]
    figures = [
        Figure(
            "start to first step, empty lab, 14 nodes",
            f"{median(took):.2f} s",
            must=f"≤ {MUST_S:.0f} s",
            ok=median(took) <= MUST_S,
        )
    ]
    if single:
        one = median([times["action.requested"] for times in single])
        figures.append(
            Figure(
                "the same with the two nodes it needs",
                f"{one:.2f} s",
                must=f"≤ {MUST_S:.0f} s",
                ok=one <= MUST_S,
            )
        )
    bare = seconds_of("pass")
    kernel = seconds_of("import labos.bootstrap; labos.bootstrap.open_lab; import labos.cli.app")
    node = seconds_of("import labos.bootstrap; labos.bootstrap.run_node; import labos.bus, labos.cli.app")
    steps = "; ".join(
        f"{label} {median([times[name] for times in whole if name in times]):.2f}"
        for name, label in NAMES.items()
        if any(name in times for times in whole)
    )
    notes = [
        f"rounds (s): {spread(took)}; in the log after (s): {steps}",
        f"interpreter {bare:.2f} s, with the kernel's imports {kernel:.2f} s, with a node's {node:.2f} s",
    ]
    return Report(figures, notes)


def smoke() -> Report:
    return measure(1, alone=False)

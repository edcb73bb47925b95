"""``python -m tests.benchmarks [NAME…] [--events N]``: measures and prints one table."""

from __future__ import annotations

import argparse
import logging
import time
from functools import partial

import structlog

from tests.benchmarks import (
    action,
    audit,
    campaigns,
    decision,
    forecast,
    memory,
    replay,
    safety,
    scrape,
    sinks,
    size,
    start,
    throughput,
    trust,
    viewers,
    windows,
)
from tests.benchmarks.figures import Report, machine, table
from tests.benchmarks.league import score as league

BENCHMARKS = {
    "action": action,
    "throughput": throughput,
    "replay": replay,
    "decision": decision,
    "size": size,
    "memory": memory,
    "campaigns": campaigns,
    "start": start,
    "forecast": forecast,
    "safety": safety,
    "windows": windows,
    "viewers": viewers,
    "scrape": scrape,
    "sinks": sinks,
    "trust": trust,
    "audit": audit,
    "league": league,
}


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks", description=__doc__)
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"of {', '.join(BENCHMARKS)}; all if none")
    parser.add_argument("--events", type=int, default=1_000_000, help="length of the log of replay and audit")
    parser.add_argument("--quick", action="store_true", help="tiny sizes: does it run at all?")
    options = parser.parse_args()
    unknown = [name for name in options.names if name not in BENCHMARKS]
    if unknown:
        parser.error(f"there is no benchmark {unknown[0]!r}; there are {', '.join(BENCHMARKS)}")
    structlog.configure(wrapper_class=structlog.make_filtering_bound_logger(logging.CRITICAL))
    reports: list[Report] = []
    for name in options.names or BENCHMARKS:
        benchmark = BENCHMARKS[name]
        long = name in ("replay", "audit")
        measure = partial(benchmark.measure, options.events) if long else benchmark.measure
        began = time.perf_counter()
        report = benchmark.smoke() if options.quick else measure()
        reports.append(report)
        print(f"{name}, {time.perf_counter() - began:.0f} s")
        for note in report.notes:
            print(f"  {note}")
    print()
    print(table([figure for report in reports for figure in report.figures]))
    print(machine())


if __name__ == "__main__":
    main()

"""A measured figure, and the table of all of them."""

from __future__ import annotations

import os
import platform
import shutil
import statistics
import subprocess
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import msgspec

HEADINGS = ("what", "limit", "ours", "ratio", "must reach", "")


class Figure(msgspec.Struct, frozen=True):
    """One line of the table. ``ok`` is None where nothing has to be reached."""

    what: str
    ours: str
    limit: str = "–"
    ratio: str = "–"
    must: str = "–"
    ok: bool | None = None


class Report(msgspec.Struct):
    """What one benchmark found: figures for the table, and notes that explain them."""

    figures: list[Figure] = []
    notes: list[str] = []


def median(values: Sequence[float]) -> float:
    return statistics.median(values)


def percentile(values: Sequence[float], share: float) -> float:
    """The value below which this share of the values lies."""
    ordered = sorted(values)
    return ordered[min(len(ordered) - 1, int(share * len(ordered)))]


def times(ratio: float) -> str:
    return f"{ratio:.2f} ×"


def spread(values: Sequence[float]) -> str:
    """The rounds of a ratio, for the notes."""
    return ", ".join(f"{value:.2f}" for value in values)


def milliseconds(seconds: float) -> str:
    return f"{seconds * 1e3:.2f} ms"


def microseconds(seconds: float) -> str:
    return f"{seconds * 1e6:.1f} µs"


def table(figures: Sequence[Figure]) -> str:
    """All figures, one line each, in columns."""
    verdicts = {True: "ok", False: "over", None: ""}
    rows = [HEADINGS, *((f.what, f.limit, f.ours, f.ratio, f.must, verdicts[f.ok]) for f in figures)]
    widths = [max(len(row[column]) for row in rows) for column in range(len(HEADINGS))]
    lines = [" | ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)) for row in rows]
    lines.insert(1, "-|-".join("-" * width for width in widths))
    return "\n".join(f"| {line.replace('-|-', '-|-')} |" for line in lines)


def machine() -> str:
    """Where this was measured, in one line."""
    return (
        f"Python {platform.python_version()}, {platform.system()} {platform.machine()}, "
        f"{os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}, "
        f"scratch on {_filesystem(scratch_root())}"
    )


def scratch_root() -> Path:
    """Where databases and journals are put: LABOS_BENCHMARKS, else the system's temporary folder,
    else, if that is in memory, the home folder. A sync that reaches no disk measures nothing."""
    chosen = os.environ.get("LABOS_BENCHMARKS")
    if chosen:
        return Path(chosen)
    usual = Path(tempfile.gettempdir())
    return usual if _filesystem(usual) not in ("tmpfs", "ramfs") else Path.home()


@contextmanager
def scratch(name: str) -> Iterator[Path]:
    """A folder on a real disk, gone afterwards."""
    folder = Path(tempfile.mkdtemp(prefix=f"labos-{name}-", dir=scratch_root()))
    try:
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def _filesystem(path: Path) -> str:
    done = subprocess.run(["stat", "-f", "-c", "%T", str(path)], capture_output=True, text=True, check=False)
    return done.stdout.strip() or "an unknown file system"

"""Each benchmark runs, on tiny sizes: what it measures there means nothing."""

from __future__ import annotations

from types import ModuleType

import pytest

from tests.benchmarks.__main__ import BENCHMARKS
from tests.benchmarks.figures import Figure, table

SLOW = ("memory", "start")
"""They start whole labs, whatever the sizes."""


@pytest.mark.slow
@pytest.mark.parametrize(
    "benchmark",
    [
        pytest.param(module, id=name, marks=[pytest.mark.full] if name in SLOW else [])
        for name, module in BENCHMARKS.items()
    ],
)
def test_it_runs(benchmark: ModuleType) -> None:
    report = benchmark.smoke()
    assert report.figures
    assert all(figure.ours for figure in report.figures)


def test_the_table_has_a_line_for_each_figure() -> None:
    lines = table([Figure("one", "1 ms"), Figure("two", "2 ms", ratio="1.00 ×", ok=False)]).splitlines()
    assert len(lines) == 4
    assert len({len(line) for line in lines}) == 1
    assert "over" in lines[-1]

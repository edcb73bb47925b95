"""Seeds of random cases: a few with every change, the others with the long campaigns."""

from __future__ import annotations

import pytest

from labos.testing.faults import QUIET, STORMY


def few_and_many(few: int, many: int) -> pytest.MarkDecorator:
    """Gives a test the argument ``seeds``: those below ``few``; in long campaigns those up to ``many``."""
    rest = pytest.param(range(few, many), id="many", marks=pytest.mark.full)
    return pytest.mark.parametrize("seeds", [pytest.param(range(few), id="few"), rest])


quiet_and_stormy = pytest.mark.parametrize(
    "rates", [QUIET, pytest.param(STORMY, marks=pytest.mark.slow)], ids=["quiet", "stormy"]
)
"""Gives a test the argument ``rates``: nothing goes wrong, and as a slow test everything now and then."""

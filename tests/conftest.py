"""Options and quiet logs for all tests."""

from __future__ import annotations

import logging
import os
import sys

import pytest
import structlog

# Without bytecode each of the processes that the tests start compiles LabOS anew, and each run all the tests.
sys.dont_write_bytecode = False
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--seed", type=int, default=None, help="run one seed of the simulated lab")
    parser.addoption("--range", default=None, metavar="A:B", help="run seeds A to B - 1 of the proof")


def pytest_configure(config: pytest.Config) -> None:
    from hypothesis import settings  # which pytest compiles too, once, if it may keep that

    settings.register_profile("unhurried", deadline=None)
    settings.load_profile("unhurried")  # how long an example takes says more of the machine than of the code
    structlog.configure(wrapper_class=structlog.make_filtering_bound_logger(logging.CRITICAL))

"""Options and quiet logs for all tests."""

from __future__ import annotations

import contextlib
import importlib
import logging
import os
import signal
import sys
from pathlib import Path

import pytest
import structlog

HERE = Path(__file__).parent

# Without bytecode each of the processes that the tests start compiles LabOS anew, and each run all the tests.
sys.dont_write_bytecode = False
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)

# A shell that runs the tests in the background has Ctrl-C ignored, and so would all labs that they start.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--seed", type=int, default=None, help="run one seed of the simulated lab")
    parser.addoption("--range", default=None, metavar="A:B", help="run seeds A to B - 1 of the proof")


def pytest_configure(config: pytest.Config) -> None:
    from hypothesis import settings  # which pytest compiles too, once, if it may keep that

    settings.register_profile("unhurried", deadline=None)
    settings.load_profile("unhurried")  # how long an example takes says more of the machine than of the code
    structlog.configure(wrapper_class=structlog.make_filtering_bound_logger(logging.CRITICAL))


@pytest.hookimpl(trylast=True)
def pytest_sessionstart(session: pytest.Session) -> None:
    if [Path(arg).resolve() for arg in session.config.args] != [HERE]:
        return
    worker = getattr(session.config, "workerinput", None)
    reporter = session.config.pluginmanager.get_plugin("terminalreporter")
    if worker is not None:
        _import_share(int(worker["workerid"].removeprefix("gw")), worker["workercount"])
    elif reporter is not None and (count := session.config.getoption("numprocesses", None)):
        reporter.write_line(f"{count} processes collect the tests, for some 20 s; then comes a dot for each.")


def _import_share(number: int, of: int) -> None:
    """Import every so manieth file of tests, and leave its bytecode to the other processes: they collect in
    the same order, and each would compile every file."""
    files = sorted(path for path in HERE.rglob("test_*.py") if (path.parent / "__init__.py").exists())
    for path in files[number::of]:
        module = ".".join((HERE.name, *path.relative_to(HERE).with_suffix("").parts))
        with contextlib.suppress(Exception, pytest.skip.Exception):  # which their collection tells of
            importlib.import_module(module)

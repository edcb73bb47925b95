"""Log lines go to stderr, or to the file to which stderr goes, one line each."""

from __future__ import annotations

import contextlib
import logging
import os
import sys
from typing import TextIO

import structlog

LEVELS = ("debug", "info", "warning", "error", "critical")
ENVIRONMENT = "LABOS_LOG"


class _Lines:
    """Writes lines to a stream, by default stderr. A closed or full stream must not cause an error in the
    caller."""

    def __init__(self, stream: TextIO | None) -> None:
        self._stream = stream

    def msg(self, message: str) -> None:
        with contextlib.suppress(OSError, ValueError):
            print(message, file=self._stream or sys.stderr, flush=True)

    log = debug = info = warn = warning = error = critical = exception = fatal = msg


def configure_logs(default: str = "warning", stream: TextIO | None = None) -> None:
    """Set up structlog once for the process; LABOS_LOG overrides the ``default`` level."""
    name = os.environ.get(ENVIRONMENT, "").lower()
    level = getattr(logging, (name if name in LEVELS else default).upper())
    structlog.configure(
        processors=[
            structlog.contextvars.merge_contextvars,
            structlog.processors.add_log_level,
            structlog.processors.TimeStamper(fmt="iso", utc=True),
            structlog.processors.format_exc_info,
            structlog.processors.KeyValueRenderer(
                key_order=["timestamp", "level", "event"], drop_missing=True
            ),
        ],
        wrapper_class=structlog.make_filtering_bound_logger(level),
        logger_factory=lambda *_: _Lines(stream),
    )
    # Libraries with log lines of their own (uvicorn, alembic) report only errors and warnings.
    logging.basicConfig(level=max(level, logging.WARNING), stream=stream or sys.stderr)

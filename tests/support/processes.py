"""Processes that do not outlive the test that started them, however it ends."""

from __future__ import annotations

import subprocess
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any


@contextmanager
def run_process(argv: Sequence[str | Path], **options: Any) -> Iterator[subprocess.Popen[Any]]:
    """A process, killed at the end of the block if it still lives. ``options`` are those of ``Popen``, which
    by itself would wait for ever for a process that nobody ends because an assertion failed."""
    with subprocess.Popen(argv, **options) as process:
        try:
            yield process
        finally:
            process.kill()

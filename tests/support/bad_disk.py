"""A disk that fails under a process: a shim between it and the C library, made by the compiler found here."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

SOURCE = Path(__file__).with_suffix(".c")


class BadDisk:
    """Files of a process whose names contain ``of`` fail as ``fails`` says, until ``mend``; start the
    process with ``environment``."""

    def __init__(self, folder: Path, of: str) -> None:
        compiler = shutil.which("cc") or shutil.which("gcc")
        if not sys.platform.startswith("linux") or compiler is None:
            pytest.skip("a disk that fails is made by a C compiler, for Linux, and there is none here")
        self._told = folder / "bad-disk"
        shim = folder / "bad_disk.so"
        subprocess.run(
            [compiler, "-shared", "-fPIC", "-O1", "-Wall", "-Werror", "-o", str(shim), str(SOURCE), "-ldl"],
            check=True,
        )
        self.environment = {"LD_PRELOAD": str(shim), "BAD_DISK": str(self._told), "BAD_DISK_OF": of}

    def fails(self, error: int, calls: str) -> None:
        """With an errno, calls of these kinds: ``w`` writes, ``s`` syncs, ``o`` opens for writing."""
        fresh = self._told.with_suffix(".new")
        fresh.write_text(f"{error} {calls}")
        os.replace(fresh, self._told)

    def mend(self) -> None:
        self._told.unlink()

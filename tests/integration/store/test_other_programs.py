"""Another program that reads the database of a running kernel, and closes it, costs nothing."""

from __future__ import annotations

import sqlite3
import subprocess
import sys
from contextlib import closing
from pathlib import Path

from tests.integration.store.test_crash import ROOT, read_acknowledged

KERNEL = """
from pathlib import Path
from labos.store import open_store
from tests.integration.store.records import LAB, LEASE_S, batch
home = Path({home!r})
store = open_store(f"sqlite:///{{home / 'labos.db'}}", home=home)
store.head()  # it has read before it writes, as each kernel has
head = store.claim(LAB, "the writer", LEASE_S)
while True:
    head = store.append(head, batch(head, 3))
    print(head.position, flush=True)
"""


def test_what_a_kernel_appends_is_in_the_file_after_others_have_closed_it(tmp_path: Path) -> None:
    code = KERNEL.format(home=str(tmp_path))
    process = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True, cwd=ROOT)
    try:
        position = 0
        for _ in range(20):
            position = read_acknowledged(process, position + 3)
            with closing(sqlite3.connect(tmp_path / "labos.db")) as database:
                (found,) = database.execute("SELECT max(position) FROM event").fetchone()
            assert found >= position
    finally:
        process.kill()
        process.communicate()
